"""What accuracy costs: the choice of settings, and the word of the estimate, which twenty held cases test."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import jax
import jsonschema
import numpy as np
import pytest
from merlfit.fitting import accuracy, calibration, cli, cost, frontier, run, synthesis, tiers
from merlfit.fitting.accuracy import Aim, carry_on, distance, estimate, reference_problem, remaining
from merlfit.fitting.choice import POINTS, REFERENCE, default_choice
from merlfit.fitting.config import Config, ConfigError, load
from merlfit.fitting.cost_plot import frontier_figure
from merlfit.fitting.cost_report import changes, front, gains, tables, write_markdown
from merlfit.fitting.export import Accuracy, Result, Tried, read_result, schema, versions
from merlfit.fitting.frontier import Frontier, Point, Spread, Tier, pareto
from merlfit.fitting.problem import energy, weighted_samples
from merlfit.fitting.report import accuracy_line
from merlfit.fitting.request import MARGIN, Request, Unreachable, request, seconds_of, usable
from merlfit.fitting.threads import machine
from merlfit.fitting.transforms import layout_of
from merlfit.merl_io.binary import Measurement
from merlfit.model import published
from merlfit.model.effects import Effects
from typer.testing import CliRunner

runner = CliRunner()
HELD = [f"drawn-{1000 + seed}" for seed in range(16)]  # every body four times
HELD += ["aluminium.smooth", "red-plastic.sgd", "brass.cook_torrance", "green-latex.abc_microfacet"]
WANTED = (1e-1, 1e-2, 3e-3, 1e-3)


def spread(value):
    return Spread(median=value / 2, p95=value, worst=2 * value)


def point(choice, error, seconds, astray=0.0):
    return Point(
        choice=choice, error=spread(error), promised=spread(error), astray=astray, failed=0.0, other_body=0.0,
        rmse=spread(0.1), parameters=None, seconds=spread(seconds), estimate_seconds=spread(0.5), megabytes=900.0,
    )  # fmt: skip


@pytest.fixture
def made():
    """A frontier of invented numbers: every point twice as accurate as the last and 1.5 times as dear."""
    points = [point(choice, 0.1 / 2**k, 1.5**k) for k, choice in enumerate(POINTS)]
    listed = [
        Tier(name=name, error=None if name == "exact" else spread(1e-3), value_ns=10.0, gradient_ns=30.0,
             compile_seconds=(1.0, 2.0), fit_value_ns=1.0, fit_gradient_ns=4.0)
        for name in tiers.TIERS
    ]  # fmt: skip
    return Frontier(
        data="invented materials", directions="invented", materials=["a"], machine=machine(), taken="2026-11-22",
        versions=versions(), tiers=listed, points=points,
    )  # fmt: skip


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
    with pytest.raises(Unreachable, match=r"most accurate settings \(quadrature 64.* within 2.4e-05 in half"):
        Request(accuracy=2e-5).choose(made.points)


def test_the_most_accurate_that_is_fast_enough_is_chosen(made):
    assert Request(seconds=2.0 * MARGIN).choose(made.points).choice == POINTS[1]
    assert Request(seconds=2.0 * MARGIN - 1e-6).choose(made.points).choice == POINTS[0]
    with pytest.raises(Unreachable, match=r"cheapest settings \(lobe.* up to 1.8 s a file, compiled"):
        Request(seconds=1.0).choose(made.points)


def test_a_tier_that_was_asked_for_is_not_replaced(made):
    fast = load(preset="fast")
    offered = usable(made.points, fast)
    assert {q.choice.diffraction for q in offered} == {"quadrature"}
    assert len(usable(made.points, Config())) == len(POINTS)
    settings = Request(accuracy=0.1).choose(offered).choice.settings(fast)
    assert settings.effects == fast.effects
    assert (settings.fit.grid, settings.fit.starts) == ("coarse", 1)
    replaced = POINTS[0].settings(load(preset="conserving"))
    assert replaced.effects_of("none").diffraction == "lobe"
    assert replaced.effects_of("none").split == "conserving"


def test_the_defaults_are_a_point():
    assert default_choice() in POINTS
    assert default_choice().settings(Config()) == Config()
    assert len(set(POINTS)) == len(POINTS)
    for choice in POINTS:
        Config.model_validate(choice.settings(Config()).model_dump())


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
        (("--time", "1ms"), "--time 0.001s is out of reach"),
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
        settings = Config.model_validate({section: {key: value}})
        with pytest.raises(ConfigError, match=rf"{section}.{key} is chosen by --accuracy and --time"):
            accuracy.aim(Request(accuracy=0.5), settings)


def test_this_machines_calibration_goes_before_the_shipped_one(monkeypatch, tmp_path, made):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path / "cache"))
    assert frontier.load()[0] == frontier.shipped()
    assert "another machine" in frontier.load()[1]
    path = frontier.keep(made, tmp_path / "cache")
    assert frontier.load()[0] == made
    assert "this machine" in frontier.load()[1]
    others = {"points": made.points[1:], "versions": {"jax": "0"}, "machine": "640 cores"}
    for key, value in others.items():
        frontier.keep(made.model_copy(update={key: value}), tmp_path / "cache")
        assert frontier.load()[0] == frontier.shipped()
        assert "of other versions; `merlfit cost` calibrates" in frontier.load()[1]
    path.write_text("{}")
    assert frontier.load()[0] == frontier.shipped()
    assert "cannot be read" in frontier.load()[1]


def test_a_fit_that_came_to_nothing_is_kept_as_infinitely_wrong(made, tmp_path):
    stray = made.points[0].model_copy(update={"promised": Spread.of([0.1, np.inf])})
    kept = made.model_copy(update={"points": [stray, *made.points[1:]]})
    read = Frontier.model_validate_json(frontier.keep(kept, tmp_path).read_bytes())
    assert read == kept
    assert Request(accuracy=0.9).choose(read.points).choice == POINTS[1]


def test_the_shipped_calibration_has_all_points_and_says_what_it_is_of():
    found = frontier.shipped()
    assert [q.choice for q in found.points] == list(POINTS)
    assert [t.name for t in found.tiers] == list(tiers.TIERS)
    assert "synthetic" in found.data
    assert len(found.materials) == len(calibration.names())
    assert found.points[-1].error.worst < 2e-3 < found.points[0].error.p95
    kept = Path(__file__).parents[2] / "results" / "bench" / "cost" / frontier.FILE
    assert found == Frontier.model_validate_json(kept.read_bytes())  # what is documented is what is shipped


def test_a_paragraph_says_what_each_step_gains(made):
    said = gains(made)
    assert said.count("2 times as accurate") == len(POINTS) - 1
    assert said.count("1.5 times the time") == len(POINTS) - 1
    assert "The defaults (quadrature 32, fine grid, 8 azimuths, float64, 4 starts) are within 0.0002" in said
    assert changes(POINTS[0], POINTS[1]) == "Quadrature instead of lobe"
    assert changes(POINTS[-2], POINTS[-1]) == "Order 64 instead of 32 and 16 azimuths instead of 8"
    dearer = [q if q.choice != default_choice() else point(q.choice, 1.0, 1e3) for q in made.points]
    worse = made.model_copy(update={"points": dearer})
    assert default_choice() not in [q.choice for q in front(worse)]
    alike = made.model_copy(update={"points": [point(q, 0.1 - 1e-3 * k, 1.5**k) for k, q in enumerate(POINTS)]})
    assert [q.choice for q in front(alike)] == [POINTS[0], POINTS[11]]  # what gains a hundredth is no step


def test_tables_and_plot_mark_the_defaults(made, tmp_path):
    write_markdown(made, tmp_path / "cost.md")
    lines = (tmp_path / "cost.md").read_text().splitlines()
    assert [line.count("|") for line in lines if "4 starts*" in line] == [14]
    assert [line.count("|") for line in lines if "quadrature 32*" in line] == [11]
    assert sum(map(len, (table.rows for table in tables(made)))) == len(POINTS) + len(tiers.TIERS)
    figure = frontier_figure(made)
    assert "invented materials" in figure.get_suptitle()
    for axis in figure.axes:
        assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
        assert any(line.get_marker() == "*" for line in axis.lines)
    drawn = [line for line in figure.axes[1].lines if len(line.get_xdata()) == len(POINTS)]
    assert len(drawn) == 1  # the front, on which all points are
    np.testing.assert_allclose(drawn[0].get_ydata(), [q.error.p95 for q in made.points])


def test_an_interrupted_measurement_goes_on_and_another_one_starts_anew(monkeypatch, tmp_path):
    asked, broken = [], [str(POINTS[1])]
    row = {
        "body": "none", "status": "CONVERGED", "cost": 0.1, "rmse": 0.1, "estimate": 1e-3, "seconds": 1.0,
        "estimate_seconds": 0.5, "other_body": False, "error": 1e-4, "parameters": 0.5, "megabytes": 900.0,
    }  # fmt: skip
    speed = {"value_ns": 1.0, "gradient_ns": 2.0, "compile_seconds": [1.0, 2.0]}

    def worker(work, section, names, file, repeats):
        asked.append((section, len(names)))
        for k, name in enumerate(names):
            if section in broken and k == 3:
                raise cost.CostError(section)
            errors = {name: spread(1e-3).model_dump() for name in tiers.TIERS if name != "exact"}
            yield {name: errors if section == cost.ERRORS else speed if section == cost.TIMES else row}

    monkeypatch.setattr(cost, "_worker", worker)
    (tmp_path / "work").mkdir()  # somebody's own
    with pytest.raises(cost.CostError):
        cost.measure(None, tmp_path, 1, lambda _: None)
    assert asked[-1] == (broken.pop(), 20)
    asked.clear()
    found = cost.measure(None, tmp_path, 1, lambda _: None)
    assert asked[0] == (str(POINTS[1]), 17)
    assert str(REFERENCE) not in dict(asked)
    assert [q.choice for q in found.points] == list(POINTS)
    asked.clear()
    cost.measure(None, tmp_path, 1, lambda _: None)
    assert asked == []  # until everything is written
    cost.tidy(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rows.json", "work"]
    kept = json.loads((tmp_path / "rows.json").read_text())
    assert set(kept[str(POINTS[0])]) == set(calibration.names())
    monkeypatch.setattr(cost, "read", lambda path: measurement(HELD[0])[0])
    one = cost.measure(Path("one.binary"), tmp_path, 1, lambda _: None)
    assert asked[0] == (str(REFERENCE), 1)
    assert one.data == "drawn-1000 alone, not a genuine MERL file"


def test_a_worker_that_fails_says_why(tmp_path):
    with pytest.raises(cost.CostError, match="no-such-material"):
        list(cost._worker(tmp_path, str(POINTS[0]), ["no-such-material.sgd"], None, 1))


def test_calibration_materials_exist():
    assert len(set(calibration.names())) == 20
    for material, source in calibration.PUBLISHED:
        assert material in published.materials(source)
    assert np.nanmin(calibration.drawn(1000)) > 0


def test_errors_beyond_their_estimate_are_counted_as_astray():
    row = {"rmse": 0.1, "estimate": 1e-3, "seconds": 1.0, "other_body": False, "error": 1e-4, "parameters": 0.5,
           "megabytes": 900.0, "estimate_seconds": 0.5, "status": "AT_BOUND"}  # fmt: skip
    astray = {**row, "error": 0.05, "other_body": True, "parameters": None, "status": "STEP_LIMIT"}
    once, twice = (cost._point(POINTS[0], [row] * (20 - k) + [astray] * k) for k in (1, 2))
    assert (once.astray, once.promised.p95, once.error.p95, once.error.worst) == (0.0, 1e-3, 1e-4, 0.05)
    assert (twice.astray, twice.promised.p95, twice.other_body, twice.failed) == (0.05, 0.05, 0.1, 0.1)


def test_what_was_asked_and_reached_is_in_the_result():
    found = Accuracy(
        asked=1e-3, asked_seconds=None, calibration="here", expected=5e-4, expected_seconds=2.0,
        tried=[Tried(settings=POINTS[3], estimated=4e-3), Tried(settings=POINTS[8], estimated=9e-4)],
        settings=POINTS[8], estimated=9e-4, met=True,
    )  # fmt: skip
    kept = Accuracy.model_validate_json(found.model_dump_json())
    assert kept == found
    assert "0.001 was asked for, which is met" in accuracy_line(found)
    assert "taken on to quadrature 32, fine" in accuracy_line(found)
    assert "NOT met" in accuracy_line(found.model_copy(update={"met": False}))
    part = {"$defs": schema()["$defs"], **schema()["$defs"]["Accuracy"]}
    jsonschema.validate(json.loads(found.model_dump_json()), part)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**json.loads(found.model_dump_json()), "estimated": "small"}, part)
    assert Result.model_fields["accuracy"].default is None


def measurement(name, **given):
    """A synthetic material as it would be read, its samples, and a configuration."""
    seed, _, source = name.removeprefix("drawn-").partition(".")
    values = synthesis.from_published(seed, source)[0] if source else calibration.drawn(int(seed))
    measured = Measurement(Path(name), values, np.isfinite(values).all(0), 0, 0, 0, "", "")
    return measured, weighted_samples(measured), load(posterior=False, **given)


@pytest.fixture(scope="module")
def one():
    """A material, its samples, and the best fit of it: from the parameters that it was made of."""
    measured, samples, config = measurement(HELD[0], body="none")
    effects, values = calibration.truth(1000)
    effects, solution = carry_on((effects, layout_of(effects).free(values)), REFERENCE.settings(config), samples)
    return samples, config, run.judge(effects, solution, measured, samples), reference_problem(samples)


def test_the_distance_is_that_of_all_bins(one):
    samples, _, fitted, problem = one
    effects, z = fitted.effects, fitted.solution.z
    cheap = Effects(effects.body, "lobe", acquisition="free")
    for a, b in (((effects, z), (effects, z + 0.1)), ((effects, z), (cheap, z))):
        here, there = (run.predict_samples(*model, samples) for model in (a, b))
        expected = np.sqrt(np.sum(samples.weight * (here - there) ** 2) / energy(samples))
        assert distance(a, b, problem) == pytest.approx(expected, rel=1e-3)
    assert distance((effects, z), (effects, z), problem) == 0.0


def test_the_step_that_remains_is_the_way_to_the_reference(one):
    _, config, fitted, problem = one
    effects, z = fitted.effects, fitted.solution.z
    assert effects.order == REFERENCE.order
    rng = np.random.default_rng(0)
    for size in (0.01, 0.1):
        moved = z + size * rng.normal(size=len(z))
        away = distance((effects, moved), (effects, z), problem)
        assert remaining((effects, moved), problem) == pytest.approx(away, rel=0.2)
        assert estimate((effects, moved), problem, config) == remaining((effects, moved), problem)
    cheap = Effects(effects.body, order=8, acquisition="free")
    both = estimate((cheap, z), problem, config)
    assert both == pytest.approx(distance((cheap, z), (effects, z), problem) + remaining((effects, z), problem))


@pytest.mark.slow
def test_a_fit_that_misses_is_taken_on(one):
    samples, config, fitted, _ = one
    measured, *_ = measurement(HELD[0])
    start = point(POINTS[1], 0.5, 1.0)
    rough = fit(measured, samples, POINTS[1].settings(config))
    asked = Aim(Request(accuracy=3e-4), start, config, "here")
    finished, told = asked.finish(rough, measured, samples)
    assert told.tried[0].settings == POINTS[1]
    assert told.tried[0].estimated > 3e-4 >= told.estimated
    assert told.met
    assert [q.settings.starts for q in told.tried] == [1] * len(told.tried)
    assert len(told.tried) > 1
    assert told.settings == told.tried[-1].settings
    assert finished.solution.cost < rough.solution.cost
    assert len(finished.candidates) == len(rough.candidates) == 1
    beyond = Aim(Request(accuracy=1e-9), start, config, "here").finish(fitted, measured, samples)[1]
    assert not beyond.met
    assert beyond.tried[-1].settings.order == REFERENCE.order
    alone = Aim(Request(seconds=9.0), start, config, "here").finish(rough, measured, samples)[1]
    assert alone.met is None
    assert len(alone.tried) == 1
    loose = Aim(Request(accuracy=0.9), point(POINTS[1], 0.5, 1.0, astray=0.4), config, "here")
    assert loose.finish(rough, measured, samples)[1].estimated == 0.4


def test_what_is_not_finite_is_infinitely_far(one):
    _, config, fitted, problem = one
    effects, z = fitted.effects, fitted.solution.z
    nowhere = np.full_like(z, np.nan)
    assert remaining((effects, nowhere), problem) == np.inf
    assert distance((effects, nowhere), (effects, z), problem) == np.inf
    assert estimate((effects, nowhere), problem, config) == np.inf


def test_carrying_on_never_ends_worse(one, monkeypatch):
    """A finer tier that breaks down leaves the fit where it was."""
    samples, config, fitted, _ = one
    measured, *_ = measurement(HELD[0])
    lost = replace(fitted.solution, z=np.full_like(fitted.solution.z, np.nan))
    monkeypatch.setattr(accuracy, "carry_on", lambda *_: (fitted.effects, lost))
    finished, told = Aim(Request(accuracy=1e-9), point(POINTS[1], 0.5, 1.0), config, "here").finish(
        fitted, measured, samples
    )
    assert finished is fitted
    assert told.settings == POINTS[1]
    assert not told.met
    assert [t.estimated is None for t in told.tried] == [False] + [True] * (len(told.tried) - 1)


def test_the_way_on_is_never_coarser():
    for start in POINTS:
        way = [start, *Aim(Request(accuracy=1e-3), point(start, 0.1, 1.0), Config(), "").finer]
        assert all(b.refines(a) for a, b in itertools.pairwise(way))
        assert {q.starts for q in way} == {start.starts}
        assert way[-1] == start.continued(REFERENCE)
    assert not POINTS[1].refines(REFERENCE)


def test_what_was_not_calibrated_is_not_promised():
    for config, known in ((load(body="plastic", seed=3), True), (load(preset="conserving"), False)):
        asked = Aim(Request(accuracy=0.1), point(POINTS[2], 0.05, 1.0), config, "here")
        assert asked.calibrated == known
        assert ("expected within 0.05" in asked.told) == known
    microfacet = Aim(Request(accuracy=0.1), point(POINTS[2], 0.05, 1.0), load(preset="microfacet"), "here")
    assert "--accuracy 0.1: off, coarse grid" in microfacet.told


def held_case(name, wanted):
    """(achieved, promised, whether met) of one synthetic material with an accuracy asked for."""
    measured, samples, config = measurement(name)
    asked = Request(accuracy=wanted)
    aim = Aim(asked, asked.choose(frontier.shipped().points), config, "shipped")
    finished, told = aim.finish(fit(measured, samples, aim.settings), measured, samples)
    best = fit(measured, samples, REFERENCE.settings(config))
    effects, solution = carry_on((best.effects, best.solution.z), REFERENCE.settings(config), samples)
    here, there = (
        run.predict_samples(*model, samples)
        for model in ((finished.effects, finished.solution.z), (effects, solution.z))
    )
    achieved = np.sqrt(np.sum(samples.weight * (here - there) ** 2) / energy(samples))
    return float(achieved), told.estimated, told.met


def fit(measured, samples, config):
    return run.fit(measured, samples, config, lambda _: None, run._Clock())


@pytest.mark.slow
def test_the_estimate_keeps_its_word_on_twenty_held_cases():
    assert len(set(HELD)) == 20
    assert not set(HELD) & set(calibration.names())
    wanted = [WANTED[(k + k // 4) % len(WANTED)] for k in range(len(HELD))]
    cases = [held_case(*case) for case in zip(HELD, wanted, strict=True)]
    achieved, promised, met = np.array(cases).T
    table = "\n".join(f"{name} {w} {case}" for name, w, case in zip(HELD, wanted, cases, strict=True))
    assert np.sum(achieved <= promised) >= 19, table
    assert np.sum((achieved <= wanted) | (met == 0)) >= 19, table
    assert np.sum(met) >= 19, table
    assert np.sum(achieved <= promised / 100) < 19, table  # an estimate a hundred times too large says nothing


@pytest.fixture
def file(tmp_path):
    return calibration.make("drawn-1000", tmp_path / "files")


@pytest.mark.parametrize("words", [("--accuracy", "0.2"), ("--time", "100s")])
def test_a_fit_that_was_asked_for_something_says_what_it_did(monkeypatch, tmp_path, file, words):
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path / "cache"))
    points = [point(choice, 0.1 / 2**k, 1.5**k) for k, choice in enumerate(POINTS[1:4])]
    monkeypatch.setattr(
        accuracy, "load", lambda: (frontier.shipped().model_copy(update={"points": points}), "invented")
    )
    options = ["-o", str(tmp_path), "--body", "none", "--no-posterior", *words]
    shown = runner.invoke(cli.app, ["fit", str(file), *options])
    assert shown.exit_code == 0, shown.output
    told = read_result(tmp_path / "drawn-1000.json").accuracy
    assert told is not None
    chosen = POINTS[1] if words[0] == "--accuracy" else POINTS[3]
    assert [t.settings for t in told.tried] == [chosen]
    assert told.settings == chosen
    asked = (0.2, None, True) if chosen == POINTS[1] else (None, 100.0, None)
    assert (told.asked, told.asked_seconds, told.met) == asked
    assert told.estimated < 0.2
    assert f"{words[0]} {words[1]}: {chosen}; expected within" in shown.output
    assert "of the reference fit, as estimated" in shown.output


@pytest.mark.slow
def test_a_file_is_measured_from_beginning_to_end(monkeypatch, tmp_path, file):
    """With two cheap points, the second as reference, and three tiers of few directions, all in this process."""
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path / "cache"))
    for module in (cost, frontier):
        monkeypatch.setattr(module, "POINTS", (POINTS[1], POINTS[3]))
    for module in (cost, calibration, accuracy):
        monkeypatch.setattr(module, "REFERENCE", POINTS[3])
    monkeypatch.setattr(tiers, "TIERS", {name: tiers.TIERS[name] for name in ("off", "quadrature 8", "exact")})
    for name, few in {"SETS": 3, "DIRECTIONS": 4, "LISTED": 64, "LISTED_EXACT": 2, "REPEATS": 1}.items():
        monkeypatch.setattr(tiers, name, few)

    def worker(*job):
        yield from (json.loads(json.dumps(row)) for row in cost.work_on(*job))

    monkeypatch.setattr(cost, "_worker", worker)
    out = tmp_path / "cost"
    try:
        shown = runner.invoke(cli.app, ["cost", str(file), "-o", str(out)])
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
    assert shown.exit_code == 0, shown.output
    assert sorted(p.name for p in out.iterdir()) == ["cost.md", "cost.png", "frontier.json", "rows.json"]
    assert not (tmp_path / "cache" / frontier.FILE).exists()  # of one file: no fit goes by it
    found = Frontier.model_validate_json((out / "frontier.json").read_bytes())
    assert found.data == "drawn-1000.binary alone, not a genuine MERL file"
    assert found.points[0].error.worst > found.points[1].error.worst
    assert all(q.promised.worst >= q.error.worst and q.seconds.worst > q.estimate_seconds.worst for q in found.points)
    off, quadrature, exact = found.tiers
    assert off.error.median > quadrature.error.median
    assert exact.error is None
    assert exact.gradient_ns > exact.value_ns > quadrature.value_ns > off.value_ns
    assert all(q.fit_gradient_ns > q.fit_value_ns > 0 for q in (off, quadrature))
