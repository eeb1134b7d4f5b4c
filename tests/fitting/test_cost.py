"""What accuracy costs: measured, interrupted, told in tables, a paragraph and a plot."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.cost import accuracy, calibration, frontier, measure
from merlfit.fitting.cost.frontier import Frontier
from merlfit.fitting.cost.report import front, frontier_figure, gains, table, write_markdown
from merlfit.fitting.settings.choice import POINTS, REFERENCE, default_choice
from merlfit.model import published
from typer.testing import CliRunner

from tests.support.frontiers import point

runner = CliRunner()


def test_a_paragraph_says_what_each_step_gains(made):
    said = gains(made)
    assert said.count("2 times as accurate") == len(POINTS) - 1
    assert said.count("1.5 times the time") == len(POINTS) - 1
    default = default_choice()
    assert f"The defaults ({default}) are within {0.1 / 2 ** POINTS.index(default):.2g}" in said
    assert f"Then {POINTS[1]}: 2 times as accurate (0.05)" in said
    dearer = [q if q.choice != default_choice() else point(q.choice, 1.0, 1e3) for q in made.points]
    worse = made.model_copy(update={"points": dearer})
    assert default_choice() not in [q.choice for q in front(worse)]
    alike = made.model_copy(update={"points": [point(q, 0.1 - 1e-3 * k, 1.5**k) for k, q in enumerate(POINTS)]})
    assert [q.choice for q in front(alike)] == [POINTS[0], POINTS[11]]  # what gains a hundredth is no step


def test_table_and_plot_mark_the_defaults(made, tmp_path):
    write_markdown(made, tmp_path / "cost.md")
    lines = (tmp_path / "cost.md").read_text().splitlines()
    assert [line.count("|") for line in lines if f"{default_choice().starts} starts*" in line] == [14]
    assert len(table(made).rows) == len(POINTS)
    figure = frontier_figure(made)
    (axis,) = figure.axes
    assert "invented materials" in figure.get_suptitle()
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
    said = [text.get_text() for text in axis.get_legend().get_texts()]
    assert said[:-1] == [f"{choice}{' (default)' * (choice == default_choice())}" for choice in POINTS]
    marks = [line for line in axis.lines if line.get_marker() not in ("None", "")]
    hollow, full = marks[::2], marks[1::2]
    assert [q.get_ydata()[0] for q in full] == [q.error.median for q in made.points]
    assert [q.get_ydata()[0] for q in hollow] == [q.error.p95 for q in made.points]
    assert {q.get_markerfacecolor() for q in hollow} == {"white"} != {q.get_markerfacecolor() for q in full}
    assert [q.get_marker() == "*" for q in full] == [choice == default_choice() for choice in POINTS]
    assert len({(q.get_color(), q.get_marker()) for q in full}) == len(POINTS)
    np.testing.assert_allclose(axis.lines[-1].get_ydata(), [q.error.p95 for q in made.points])  # all are on the front


@pytest.mark.parametrize("growth", [1.01, 1.5, 3.0])
def test_axes_are_marked_with_plain_numbers(made, growth):
    points = [point(q, 2.0 * growth**-k, growth**k) for k, q in enumerate(POINTS)]
    figure = frontier_figure(made.model_copy(update={"points": points}))
    figure.draw_without_rendering()
    (axis,) = figure.axes
    for side in (axis.xaxis, axis.yaxis):
        said = [label.get_text() for label in side.get_ticklabels(which="both")]
        assert any(said)
        assert not [text for text in said if "times" in text]


def test_nothing_in_the_picture_lies_on_anything_else(made):
    """Of the shipped calibration, and of points that coincide, which are told by their marks."""
    same = made.model_copy(update={"points": [point(q, 0.1, 1.0 + 1e-3 * k) for k, q in enumerate(POINTS)]})
    for measured in (frontier.shipped(), same):
        figure = frontier_figure(measured)
        figure.draw_without_rendering()
        (axis,) = figure.axes
        legend = axis.get_legend()
        assert legend.get_window_extent().x0 > axis.get_window_extent().x1
        assert figure.bbox.padded(1).containsx(legend.get_window_extent().x1)
        for texts in (legend.get_texts(), axis.get_xticklabels(), axis.get_yticklabels()):
            boxes = [text.get_window_extent() for text in texts if text.get_text()]
            assert not [(i, j) for j, b in enumerate(boxes) for i, a in enumerate(boxes[:j]) if a.overlaps(b)]


def test_an_interrupted_measurement_goes_on_and_another_one_starts_anew(monkeypatch, tmp_path):
    asked, broken = [], [str(POINTS[1])]
    row = {
        "body": "none", "status": "CONVERGED", "cost": 0.1, "rmse": 0.1, "estimate": 1e-3, "seconds": 1.0,
        "estimate_seconds": 0.5, "other_body": False, "error": 1e-4, "parameters": 0.5, "megabytes": 900.0,
    }  # fmt: skip

    def worker(job):
        _, section, names, *_ = job
        asked.append((section, len(names)))
        for k, name in enumerate(names):
            if section in broken and k == 3:
                raise measure.CostError(section)
            yield name, row

    monkeypatch.setattr(measure, "_worker", worker)
    (tmp_path / "work").mkdir()  # somebody's own
    with pytest.raises(measure.CostError):
        measure.measure(None, tmp_path, 1, lambda _: None)
    assert asked[-1] == (broken.pop(), 20)
    asked.clear()
    found = measure.measure(None, tmp_path, 1, lambda _: None)
    assert asked[0] == (str(POINTS[1]), 17)
    assert str(REFERENCE) not in dict(asked)
    assert [q.choice for q in found.points] == list(POINTS)
    asked.clear()
    measure.measure(None, tmp_path, 1, lambda _: None)
    assert asked == []  # until everything is written
    measure.tidy(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rows.json", "work"]
    kept = json.loads((tmp_path / "rows.json").read_text())
    assert set(kept[str(POINTS[0])]) == set(calibration.names())
    monkeypatch.setattr(measure, "read", lambda path: SimpleNamespace(path=path, name="one", sha1="1", genuine=None))
    one = measure.measure(Path("one.binary"), tmp_path, 1, lambda _: None)
    assert asked[0] == (str(REFERENCE), 1)
    assert one.data == "one.binary alone, not a genuine MERL file"


def test_a_worker_that_fails_says_why(tmp_path):
    with pytest.raises(measure.CostError, match="no-such-material"):
        list(measure._worker((tmp_path, str(POINTS[0]), ["no-such-material.sgd"], None, 1)))


def test_calibration_materials_exist():
    assert len(set(calibration.names())) == 20
    for material, source in calibration.PUBLISHED:
        assert material in published.materials(source)


def test_errors_beyond_their_estimate_are_counted_as_other_minima():
    row = {"rmse": 0.1, "estimate": 1e-3, "seconds": 1.0, "other_body": False, "error": 1e-4, "parameters": 0.5,
           "megabytes": 900.0, "estimate_seconds": 0.5, "status": "AT_BOUND"}  # fmt: skip
    other_minimum = {**row, "error": 0.05, "other_body": True, "parameters": None, "status": "UNEXPLAINED"}
    once, twice = (measure._point(POINTS[0], [row] * (20 - k) + [other_minimum] * k) for k in (1, 2))
    assert (once.other_minimum, once.promised.p95, once.error.p95, once.error.worst) == (0.0, 1e-3, 1e-4, 0.05)
    assert (twice.other_minimum, twice.promised.p95, twice.other_body, twice.failed) == (0.05, 0.05, 0.1, 0.1)


@pytest.mark.slow
def test_a_file_is_measured_from_beginning_to_end(monkeypatch, tmp_path, own_cache, file):
    """With two cheap points, the second as reference, all in this process."""
    for module in (measure, frontier):
        monkeypatch.setattr(module, "POINTS", (POINTS[1], POINTS[3]))
    for module in (measure, calibration, accuracy):
        monkeypatch.setattr(module, "REFERENCE", POINTS[3])
    monkeypatch.setattr(measure, "_worker", measure.work_on)
    out = tmp_path / "cost"
    shown = runner.invoke(cli.app, ["cost", str(file), "-o", str(out)])
    assert shown.exit_code == 0, shown.output
    assert sorted(p.name for p in out.iterdir()) == ["cost.md", "cost.png", "frontier.json", "rows.json"]
    assert not (own_cache / frontier.FILE).exists()  # of one file: no fit goes by it
    found = Frontier.model_validate_json((out / "frontier.json").read_bytes())
    assert found.data == "drawn-1000.binary alone, not a genuine MERL file"
    assert found.points[0].error.worst > found.points[1].error.worst
    assert all(q.promised.worst >= q.error.worst and q.seconds.worst > q.estimate_seconds.worst for q in found.points)
