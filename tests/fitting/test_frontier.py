"""Which settings are chosen for an accuracy or a time, and which calibration that goes by."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.cost import accuracy, calibration, frontier, measure
from merlfit.fitting.cost.frontier import Frontier, Percentiles, pareto
from merlfit.fitting.cost.measure import ROWS, CostError, _kept
from merlfit.fitting.cost.request import MARGIN, Request, needed, request, seconds_of
from merlfit.fitting.pipeline.models import two_scale
from merlfit.fitting.settings.choice import POINTS, REFERENCE, default_choice
from merlfit.fitting.settings.config import Config, ConfigError, load, parse
from typer.testing import CliRunner

from tests.support.frontiers import point

runner = CliRunner()


def test_the_front_is_what_nothing_beats():
    costs, errors = [1.0, 2.0, 3.0, 4.0, 2.0, 5.0], [0.5, 0.3, 0.4, 0.1, 0.2, 0.1]
    assert pareto(costs, errors) == [0, 4, 3]
    rng = np.random.default_rng(0)
    costs, errors = rng.uniform(size=(2, 60))
    kept = pareto(costs, errors)
    for i in range(60):
        beaten = np.any((costs <= costs[i]) & (errors <= errors[i]) & ((costs < costs[i]) | (errors < errors[i])))
        assert (i in kept) != beaten


def test_the_cheapest_that_is_accurate_enough_is_chosen(made):
    chosen = Request(accuracy=0.03).choose(made.points)
    assert chosen.choice == POINTS[2]  # 0.1, 0.05, 0.025
    cheaper = [*made.points, point(POINTS[7], 0.02, 0.5)]
    assert Request(accuracy=0.03).choose(cheaper).choice == POINTS[7]
    assert Request(accuracy=3e-5).choose(made.points).choice == REFERENCE  # kept to by half of its fits, not by 95 %
    with pytest.raises(ConfigError, match=r"most accurate settings \(quadrature 64.* within 2.4e-05 in half"):
        Request(accuracy=2e-5).choose(made.points)


def test_the_most_accurate_that_is_fast_enough_is_chosen(made):
    assert Request(seconds=2.0 * MARGIN).choose(made.points).choice == POINTS[1]
    assert Request(seconds=2.0 * MARGIN - 1e-6).choose(made.points).choice == POINTS[0]
    with pytest.raises(ConfigError, match=r"fastest settings \(lobe.* up to 1.8 s for each file, once compiled"):
        Request(seconds=1.0).choose(made.points)


ASKED = [Request(accuracy=x) for x in np.geomspace(1e-4, 0.5, 60)] + [
    Request(seconds=x) for x in np.linspace(3, 30, 60)
]


@pytest.mark.parametrize("asked", ASKED, ids=str)
def test_nothing_is_chosen_that_is_worse_and_slower_than_the_default(asked):
    """By the shipped calibration; who asks for nothing does not wait for an estimate."""
    points = frontier.shipped().points
    default = next(q for q in points if q.choice == default_choice())
    try:
        chosen = asked.choose(points)
    except ConfigError:
        return
    if chosen.promised.p95 > default.promised.p95:
        if asked.accuracy is not None:
            assert chosen.seconds.median + chosen.estimate_seconds.median < default.seconds.median
        else:
            assert needed(chosen) < needed(default, estimate=False)


def test_the_default_is_chosen_where_it_is_as_fast_and_more_accurate(made):
    default = point(default_choice(), 0.01, 1.5)
    slow, fast = point(POINTS[5], 0.02, 1.4), point(POINTS[4], 0.02, 0.9)
    assert Request(accuracy=0.05).choose([slow, default]).choice == default_choice()
    assert Request(accuracy=0.05).choose([fast, slow, default]).choice == POINTS[4]
    assert Request(seconds=1.5 * MARGIN).choose([slow, fast, default]).choice == default_choice()
    assert Request(seconds=1.4 * MARGIN).choose([slow, fast, default]).choice == POINTS[4]
    assert not Request(seconds=1.5 * MARGIN).has_time_to_estimate(default)


@pytest.mark.parametrize("accuracy", [0.1, 0.03, 1e-2, 3e-3, 1e-3, 3e-4])
def test_what_the_shipped_calibration_offers_is_more_accurate_than_the_default_or_faster(accuracy):
    points = frontier.shipped().points
    (default,) = [q for q in points if q.choice == default_choice()]
    chosen = Request(accuracy=accuracy).choose(points)
    faster = chosen.seconds.median + chosen.estimate_seconds.median < default.seconds.median
    assert chosen == default or faster or chosen.promised.p95 < default.promised.p95
    assert chosen.promised.p95 <= accuracy


def test_no_finer_settings_are_taken_for_an_accuracy_that_the_default_keeps_to_as_often():
    """Both keep to 1e-3 in half of the fits, and to nearly the same in 95 %."""
    half = {"median": 1e-3, "p95": 1.8e-3, "worst": 2e-3}
    default, finer = (
        point(choice, 1e-3, seconds).model_copy(update={"promised": Percentiles(**half)})
        for choice, seconds in ((default_choice(), 4.0), (REFERENCE, 8.0))
    )
    assert Request(accuracy=1e-3).choose([default, finer]).choice == default_choice()


@pytest.mark.parametrize(
    ("words", "said"),
    [((None, "1000h"), "--time 1000h"), ((None, " 4 s"), "--time 4 s"), ((1e-3, None), "--accuracy 0.001")],
)
def test_a_request_is_repeated_as_it_was_typed(words, said):
    assert str(request(*words)) == said


def test_a_tier_that_was_asked_for_is_not_replaced(made):
    fast = load(preset="fast")
    offered = accuracy.usable(made.points, fast)
    assert {q.choice.diffraction for q in offered} == {"quadrature"}
    assert len(accuracy.usable(made.points, Config())) == len(POINTS)
    settings = Request(accuracy=0.1).choose(offered).choice.settings(fast)
    assert settings.effects == fast.effects
    assert (settings.fit.grid, settings.fit.starts) == ("coarse", 1)
    replaced = POINTS[0].settings(load(preset="conserving"))
    assert two_scale(replaced, ("complex", "none")).material.diffraction == "lobe"
    assert two_scale(replaced, ("complex", "none")).material.split == "conserving"


def test_the_defaults_are_a_point():
    assert default_choice() in POINTS
    assert default_choice().settings(Config()) == Config()
    assert len(set(POINTS)) == len(POINTS)
    for choice in POINTS:
        parse(choice.settings(Config()).plain(), "here")


@pytest.mark.parametrize(
    ("text", "seconds"), [("2s", 2.0), ("500ms", 0.5), ("1.5min", 90.0), ("3", 3.0), (" .5 s", 0.5), ("1h", 3600.0)]
)
def test_times_are_read(text, seconds):
    assert seconds_of(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "s", "2x", "-1s", "0s", "1e3", "1 2s", "nan", "inf"])
def test_bad_times_are_refused(text):
    with pytest.raises(ValueError, match=r"should be a time such as 2s, 500ms or 1\.5min"):
        seconds_of(text)


@pytest.mark.parametrize("wrong", [0.0, -1e-3, 1.0, float("nan"), float("inf")])
def test_bad_accuracies_are_refused(wrong):
    with pytest.raises(ValueError, match="between 0 and 1"):
        request(wrong, None)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--accuracy", "1e-3", "--time", "2s"), "give one of them"),
        (("--accuracy", "2"), "between 0 and 1"),
        (("--time", "soon"), "should be a time such as 2s"),
        (("--accuracy", "1e-12"), "--accuracy 1e-12 is out of reach"),
        (("--time", "1ms"), "--time 1ms is out of reach"),
    ],
)
def test_impossible_requests_are_one_line_and_exit_2(monkeypatch, tmp_path, words, said):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path))
    shown = runner.invoke(cli.app, ["fit", "x.binary", "-o", str(tmp_path), *words])
    assert shown.exit_code == 2
    assert said in shown.stderr
    assert len(shown.stderr.strip().splitlines()) == 1


def test_settings_that_would_be_overruled_are_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path))
    for section, key, value in (("fit", "starts", 2), ("effects", "order", 64)):
        settings = parse({section: {key: value}}, "here")
        with pytest.raises(ConfigError, match=rf"{section}.{key} is chosen by --accuracy and --time"):
            accuracy.aim(Request(accuracy=0.5), settings)


def test_this_machines_calibration_goes_before_the_shipped_one(monkeypatch, tmp_path, made):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path / "cache"))
    assert frontier.load()[0] == frontier.shipped()
    assert "another machine" in frontier.load()[1]
    path = frontier.keep(made, tmp_path / "cache")
    assert frontier.load()[0] == made
    assert "this machine" in frontier.load()[1]
    others = {"points": made.points[1:], "versions": {"jax": "0"}, "machine": "640 cores", "objective": 1}
    for key, value in others.items():
        frontier.keep(made.model_copy(update={key: value}), tmp_path / "cache")
        assert frontier.load()[0] == frontier.shipped()
        assert "is of another machine or of other versions; " in frontier.load()[1]
        assert frontier.load()[1].endswith("`merlfit cost` calibrates this one")
    path.write_text("{}")
    assert frontier.load()[0] == frontier.shipped()
    assert "cannot be read" in frontier.load()[1]


def test_a_calibration_of_another_objective_is_a_rough_guide(monkeypatch, tmp_path, made):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path))
    for objective, said in ((frontier.OBJECTIVE, False), (frontier.OBJECTIVE - 1, True)):
        other = made.model_copy(update={"objective": objective})
        monkeypatch.setattr(frontier, "shipped", lambda other=other: other)
        assert ("rough guide" in frontier.load()[1]) == said


def test_what_is_no_calibration_is_not_waited_for_and_told(tmp_path, monkeypatch):
    """A pipe, lists in lists in lists."""
    monkeypatch.setattr(frontier, "cache_folder", lambda: tmp_path)
    assert "cannot be read" not in frontier.load()[1]
    os.mkfifo(tmp_path / frontier.FILE)
    assert "the calibration that was kept cannot be read" in frontier.load()[1]
    work = tmp_path / "work"
    work.mkdir()
    for text in ("[" * 100_000, "[1]", "\0"):
        (work / ROWS).write_text(text)
        with pytest.raises(CostError, match="is not of this command, or damaged"):
            _kept(work, {})
    (work / ROWS).unlink()
    os.mkfifo(work / ROWS)
    with pytest.raises(CostError, match="is not of this command, or damaged"):
        _kept(work, {})


def test_a_fit_that_came_to_nothing_is_kept_as_infinitely_wrong(made, tmp_path):
    stray = made.points[0].model_copy(update={"promised": Percentiles.of([0.1, np.inf])})
    kept = made.model_copy(update={"points": [stray, *made.points[1:]]})
    read = Frontier.model_validate_json(frontier.keep(kept, tmp_path).read_bytes())
    assert read == kept
    assert Request(accuracy=0.9).choose(read.points).choice == POINTS[1]


def test_the_shipped_calibration_has_all_points_and_says_what_it_is_of():
    found = frontier.shipped()
    assert [q.choice for q in found.points] == list(POINTS)
    assert "synthetic" in found.data
    assert len(found.materials) == len(calibration.names())
    assert found.points[-1].error.worst < 2e-3 < found.points[0].error.p95
    rows = json.loads((Path(__file__).parents[2] / "results" / "bench" / "cost" / measure.ROWS).read_text())
    measured = measure.assemble(rows, found.materials, found.data)
    assert found.points == measured.points  # what is shipped is what was measured
