"""Several models on one file: rows, tables, the paragraph that says which one is enough, errors against a file."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.commands import cli, metrics
from merlfit.fitting.commands import compare as comparisons
from merlfit.fitting.fit.error_metrics import Errors, by_incidence, errors
from merlfit.fitting.fit.published_errors import assess_published
from merlfit.fitting.fit.selection import ALIKE, SEEN, bic, least
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.comparison import FIT, Row, compare_file, config_of
from merlfit.fitting.pipeline.synthesis import from_published
from merlfit.fitting.results.storage import ResultError, versions, write_result
from merlfit.fitting.settings.config import ConfigError, load, parse
from merlfit.fitting.show import comparison_table as comparison
from merlfit.fitting.support import outputs
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.atomic import WriteError
from merlfit.merl_io.binary import DIMS, read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.model.registry import models
from typer.testing import CliRunner

from tests.support.command import call
from tests.support.made_results import made

GOOD = Errors(0.01, 0.02, 0.01, 0.01, 1.0, 0.5)


def row(model="ggx", material="nickel", origin=FIT, numbers=8, bic=-10.0, **errors):
    """One model on one material."""
    found, values = replace(GOOD, **errors), {"alpha": 0.1}
    return Row(material, False, model, model, origin, 1.4, "CONVERGED", numbers, found, 0.01, bic, 2.0, values)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A MERL file of published parameters: the published row explains it, but for the floating point of the file."""
    path = tmp_path_factory.mktemp("made") / "nickel.binary"
    write(path, from_published("nickel", "smooth")[0])
    return path


def test_published_parameters_of_the_material_itself_have_no_error(file):
    measurement = read(file)
    samples = weighted_samples(measurement)
    own, cost = assess_published("smooth", measurement, samples)
    assert own.rmse < 1e-12
    assert cost < 1e-20
    other, _ = assess_published("sgd", measurement, samples)
    assert other.rmse > 1e-3


@pytest.mark.slow
def test_a_file_is_compared_and_gone_on_with(file, tmp_path, monkeypatch):
    """GGX and Smooth fit a file of Smooth: the latter exactly; a second run fits nothing again."""
    call = lambda *words: CliRunner().invoke(cli.app, [str(w) for w in words], env={"COLUMNS": "140"})  # noqa: E731
    shown = call("compare", file, "--models", "ggx,smooth", "-o", tmp_path)
    assert shown.exit_code == 0, shown.output
    assert "the least model that explains it is smooth" in " ".join(shown.output.split())
    assert {"comparison.csv", "comparison.md", "comparison.html", "comparison.png"} <= {
        p.name for p in tmp_path.iterdir()
    }
    lines = {
        line["model"] + line["origin"]: line
        for line in csv.DictReader((tmp_path / "comparison.csv").read_text().splitlines())
    }
    assert float(lines["smoothfit"]["rmse"]) < 1e-4 < float(lines["ggxfit"]["rmse"])
    assert float(lines["smoothfit"]["bic"]) < float(lines["ggxfit"]["bic"])
    assert json.loads(lines["smoothsmooth"]["values"])["B"] > 0
    assert lines["smoothsmooth"]["bic"] == "nan"

    def fails(*_):
        raise AssertionError("fitted again")

    monkeypatch.setattr(comparisons, "fit_file", fails)
    again = call("compare", file, "--models", "ggx,smooth", "-o", tmp_path)
    assert again.exit_code == 0, again.output
    assert (
        "smooth" in call("metrics", tmp_path / "smooth" / "nickel.json", "--against", file, "-o", tmp_path / "m").output
    )
    curve = list(csv.reader((tmp_path / "m" / "by_incidence.csv").read_text().splitlines()))
    assert len(curve) == 15
    assert (tmp_path / "m" / "by_incidence.png").stat().st_size > 5000


def test_tables_of_an_earlier_comparison_are_known(tmp_path):
    fit, around = Path("fits/nickel.json"), np.array([0.1, 0.2])
    found = metrics.Assessed(fit, row(), Path("measured/nickel.binary"), "made (stated, not checked)", around, around)
    comparison.write_tables([row(), row("=smooth")], tmp_path, comparison.NAME, "1 materials, 2 models", "made up")
    metrics.write_metrics([found], tmp_path)
    outputs.refuse_others(comparison.compared_in(tmp_path))
    outputs.refuse_others(metrics.metrics_in(tmp_path))
    assert "metals,nickel,'=smooth,'=smooth," in (tmp_path / "comparison.csv").read_text()


def test_metrics_say_what_the_file_is(tmp_path):
    fit, around = Path("fits/nickel.json"), np.array([0.1, 0.2])
    found = metrics.Assessed(fit, row(), Path("measured/nickel.binary"), "made (stated, not checked)", around, around)
    assert [path.name for path in metrics.write_metrics([found], tmp_path)][2:] == ["by_incidence.png"]
    (line,) = csv.DictReader((tmp_path / "metrics.csv").read_text().splitlines())
    assert (line["against"], line["data"]) == ("measured/nickel.binary", "made (stated, not checked)")


def test_rows_of_a_file_have_one_count_and_the_published_sets_beside_them(file, tmp_path):
    results = {"ggx": made(), "smooth": made()}
    for name, cost, count in (("ggx", 0.02, 50.0), ("smooth", 0.01, 20.0)):
        fit = results[name].fit.model_copy(update={"cost": cost, "effective_bins": count})
        results[name] = results[name].model_copy(update={"fit": fit})
    fit = lambda measurement, out, config: results[config.model.name]  # noqa: E731
    rows, found = compare_file(file, ["ggx", "smooth"], load(posterior=False), tmp_path, fit=fit)
    assert found == results
    assert [r.origin for r in rows] == [
        FIT,
        FIT,
        "sgd",
        "smooth",
        "abc-microfacet",
        "cook-torrance",
        "cook-torrance-ngan",
        "he",
    ]
    assert all(len(r.values) == r.numbers > 0 for r in rows), "parameters, of published sets too"
    size = len(results["ggx"].parameters)
    np.testing.assert_allclose([r.bic for r in rows[:2]], [bic(0.02, size, 20.0), bic(0.01, size, 20.0)])


def test_a_result_of_other_data_or_settings_is_not_kept(file, tmp_path):
    """Nor one of other versions; one of the same is."""
    measurement, config, fitted = read(file), load(posterior=False), []
    own = config_of(config, "ggx")
    same = made(sha1=measurement.sha1).model_copy(update={"config": own.plain(), "versions": versions()})

    def fit(measurement, out, config):
        fitted.append(config.model.name)
        return same

    (tmp_path / "ggx").mkdir()
    other = {"source": same.source.model_copy(update={"sha1": "0" * 40}), "config": {}, "versions": {"merlfit": "0"}}
    for changed, again in (({}, []), *(({key: x}, ["ggx"]) for key, x in other.items())):
        write_result(tmp_path / "ggx" / "nickel.json", same.model_copy(update=changed))
        fitted.clear()
        compare_file(file, ["ggx"], config, tmp_path, with_published=False, fit=fit)
        assert fitted == again, changed


def test_settings_of_one_model_do_not_reach_the_others():
    config = parse({"effects": {"body": "plastic"}, "acquisition": {"grazing_loss": 0.2}}, "test")
    assert config_of(config, "two-scale").effects.body == "plastic"
    assert config_of(config, "ggx").effects == load().effects
    assert config_of(config, "oren-nayar-qualitative").acquisition == load().acquisition
    for name in models():
        assert parse(config_of(config, name).plain(), "again") == config_of(config, name)
    with pytest.raises(ConfigError, match=r"model\.gamma is a setting of one model"):
        config_of(parse({"model": {"name": "gtr", "gamma": "2"}}, "test"), "ggx")
    with pytest.raises(ConfigError, match="adaptive"):
        config_of(load(weights="adaptive"), "ggx")


def test_bic_is_the_textbooks():
    assert bic(0.02, 8, 100.0) == pytest.approx(100 * np.log(0.02) + 8 * np.log(100))


@pytest.mark.parametrize(("rows", "chosen"), [
    ([row(numbers=16), row("a", numbers=8)], 1),  # as good, with fewer numbers
    ([row(numbers=16), row("a", numbers=8, picture=0.5 + 1.1 * SEEN)], 0),  # seen to be worse
    ([row(numbers=16, bic=-20.0), row("a", numbers=8, bic=-20.0 + 1.1 * ALIKE)], 0),  # strong evidence against it
    ([row(numbers=16), row("a", numbers=8, highlight=0.4)], 0),  # a lost highlight
    ([row(numbers=16, highlight=0.4), row("a", numbers=8, highlight=0.3)], 1),  # which none keeps
    ([row(numbers=16, picture=2.0), row("a", numbers=8, highlight=0.3)], 0),
])  # fmt: skip
def test_the_least_model_that_explains_a_material(rows, chosen):
    figures = zip(*((r.bic, r.errors.picture, r.errors.highlight, r.numbers) for r in rows), strict=True)
    assert least(*figures) == chosen
    said = comparison.verdict(rows)
    assert f"the least model that explains it is {rows[chosen].model}" in said


def test_a_model_that_does_not_look_like_the_file_explains_nothing():
    """Of several the best is named, and by how much the default is beaten."""
    said = comparison.verdict([row(picture=3.7), row("b", picture=5.0)])
    assert "none of these models explains it; the best is ggx" in said
    assert "it is not explained by ggx" in comparison.verdict([row(lamp=0.4, environment=5.8)])
    assert "the least model that explains it is ggx" in comparison.verdict([row(lamp=0.4, environment=1.8)])
    default = row("two-scale", numbers=16, bic=110.0, picture=0.9)
    said = comparison.verdict([default, row(), row("b", numbers=9, bic=-12.0)])
    assert "The default model, two-scale, has a BIC 120 higher." in said


def test_what_speaks_for_another_model_is_said():
    low = row("b", numbers=20, bic=-20.0, picture=4.0)
    assert "but its picture is off by 4" in comparison.verdict([row(numbers=16), low])
    assert "it loses the highlight" in comparison.verdict([row(numbers=16), row("b", bic=-30.0, highlight=0.2)])
    assert "no strong evidence" in comparison.verdict([row(), row("b", numbers=9, bic=-12.0)])
    nearer = row("b", numbers=7, bic=-14.0, picture=0.3, highlight=0.3)  # and has fewer numbers, and the lower BIC
    said = comparison.verdict([row(picture=0.5), nearer])
    assert said.count("but it loses the highlight, which is 0.3 times the file's") == 2
    assert "noticeable" not in said
    assert "no strong evidence" not in said
    assert "try `merlfit fit --weights adaptive`" in comparison.verdict([row(highlight=0.3)])


def test_without_pictures_none_is_nearest():
    """Scattered directions make no picture: nothing is said of one, and no model has the nearest."""
    none = float("nan")
    said = comparison.verdict([row(numbers=16, picture=none), row("b", numbers=9, bic=-12.0, picture=none)])
    assert "spheres" not in said
    assert "picture" not in said
    assert "try `merlfit fit --weights none`" in comparison.verdict([row(picture=none, highlight=0.3)])
    rows = [row("a", "x", picture=none), row("b", "x", picture=none), row("a", "y"), row("b", "y", picture=0.1)]
    assert comparison.winners(rows, "picture") == {"y": ("b", pytest.approx(5.0))}


def test_channels_that_are_not_the_files_are_named(tmp_path):
    write(tmp_path / "x.binary", np.ones((3, *DIMS)))
    result = made()
    result.model.channels.append("X")
    with pytest.raises(ResultError, match=r"x\.json: has 4 channels, and .*x\.binary 3"):
        metrics.assessed_result(tmp_path / "x.json", result, tmp_path / "x.binary")


def test_tables_that_cannot_be_written_are_said_in_a_line(tmp_path, monkeypatch):
    def refuse(*_):
        raise WriteError("comparison.csv: cannot be written (No space left on device)")

    monkeypatch.setattr(comparisons, "write_tables", refuse)
    monkeypatch.setattr(comparisons, "compare_file", lambda *_: ([row()], {}))
    shown = call("compare", tmp_path / "x.binary", "--models", "ggx", "-o", tmp_path)
    assert shown.exit_code == BAD_INPUT
    assert shown.stderr == "merlfit: comparison.csv: cannot be written (No space left on device)\n"


def test_tables_say_who_wins_where_and_by_how_much(tmp_path):
    rows = [
        row("ggx", "nickel"), row("sgd", "nickel", rmse=0.03), row("ggx", "red-fabric", rmse=0.02, smape=0.01),
        row("sgd", "red-fabric", smape=0.02), row("sgd", "nickel", origin="sgd", rmse=0.5, smape=0.5, picture=9.0),
    ]  # fmt: skip
    assert comparison.winners(rows, "rmse") == {
        "nickel": ("ggx", pytest.approx(3.0)),
        "red-fabric": ("sgd", pytest.approx(2.0)),
    }
    written = comparison.write_tables(rows, tmp_path, "all", "Two materials", "made up")
    text, page = written[1].read_text(), written[2].read_text()
    assert "Data: made up." in text
    assert "| ggx | 1 (3) |" in text
    assert "| model | fabrics (1) | metals (1) |" in text
    assert "| sgd (published) | 1 |" in text
    assert "| nickel | **0.01** | 0.03 | 0.5 |" in text, "who wins on each material"
    assert "N log J" in text
    assert page.count("<table>") == text.count("\n|---")
    assert "<h2>Who wins where</h2>" in page
    lines = list(csv.DictReader(written[0].read_text().splitlines()))
    assert [line["group"] for line in lines] == ["metals", "metals", "fabrics", "fabrics", "metals"]


def test_names_are_counted_by_the_body_that_was_found(tmp_path):
    bodies = {"nickel": "complex none", "brass": "complex none", "red-plastic": "real plastic"}
    rows = [replace(row("two-scale", material), variant=body) for material, body in bodies.items()]
    text = comparison.write_tables(rows, tmp_path, "all", "Three", "made up")[1].read_text()
    assert "| kind | complex none | real plastic |" in text
    assert "| metals | 2 | 0 |" in text
    assert "| plastics | 0 | 1 |" in text


@pytest.mark.parametrize(("material", "group"), [
    ("gold-metallic-paint2", "metallic paints"), ("aluminium", "metals"), ("white-paint", "paints"),
    ("pickled-oak-260", "woods"), ("specular-violet-phenolic", "plastics"), ("mystery", "others"),
])  # fmt: skip
def test_materials_are_grouped_by_name(material, group):
    assert comparison.group_of(material) == group


def test_the_curve_over_incidence_adds_up_to_the_rmse():
    grid, rng = merl_grid(), np.random.default_rng(0)
    measured = rng.uniform(0, 1, (3, *grid.above.shape))
    predicted = measured + 0.1 * rng.standard_normal(measured.shape)
    whole = errors(measured, predicted, grid.above, grid).rmse
    middles, curve = by_incidence(measured, predicted, grid.above, grid)
    assert len(middles) == 14
    assert middles[0] == pytest.approx(0.05)
    assert np.mean(curve**2) == pytest.approx(whole**2, rel=1e-9)
    assert np.ptp(curve) > 0.2 * whole  # cos^2 theta_i
    only = np.where(np.arccos(np.clip(grid.cos_i, -1, 1)) < 0.1, predicted, measured)
    assert np.all(by_incidence(measured, only, grid.above, grid)[1][1:] == 0)


@pytest.mark.parametrize(("words", "said"), [
    (["compare", "FILE", "--models", "ggz"], "there is no 'ggz'; the nearest is 'ggx'"),
    (["compare", "FILE", "--models", "ggx,ggx"], "should be different names, with commas between"),
    (["which", "nowhere.binary", "--models", "ggx"], "nowhere.binary"),
    (["metrics", "nowhere.json", "--against", "FILE"], "nowhere.json: no such file"),
])  # fmt: skip
def test_bad_input_is_told(words, said, file, tmp_path, monkeypatch):
    monkeypatch.setattr(comparisons, "use_persistent_cache", lambda: None)
    more = ["-o", tmp_path] if words[0] != "metrics" else []
    shown = CliRunner().invoke(cli.app, [str(file) if w == "FILE" else str(w) for w in (*words, *more)])
    assert shown.exit_code == 2
    assert said in " ".join(shown.output.split())


def test_which_says_what_tables_leave_and_writes_them(file, tmp_path, monkeypatch):
    monkeypatch.setattr(comparisons, "use_persistent_cache", lambda: None)
    monkeypatch.setattr(comparisons, "compare_file", lambda *_: ([row()], None))
    target = tmp_path / "table.binary"

    def which(path=file, *more):
        words = ["which", path, "--models", "ggx", "-o", tmp_path, "--table", target, *more]
        shown = CliRunner().invoke(cli.app, [*map(str, words)])
        return shown.exit_code, " ".join(shown.output.split())

    code, said = which()
    assert code == 0
    assert "Tables of theta_h and theta_d and of theta_i and theta_o" in said
    assert said.endswith(f"{target}: the tables, as a MERL file".split("/")[-1])
    measured, drawn = read(file), read(target)
    known = measured.valid & drawn.valid & (merl_grid().theta_d < 1.2)[:, None]
    assert known.sum() > 0.5 * measured.valid.sum()
    far = np.abs(np.log(np.maximum(drawn.values, 1e-9) / np.maximum(measured.values, 1e-9)))[:, known]
    assert np.median(far) < 0.05
    dark = drawn.valid & ~measured.valid
    assert not dark.any()
    code, said = which()
    assert (code, "may be a measurement; --force overwrites it" in said) == (2, True)
    assert which(file, "--force")[0] == 0
    black = tmp_path / "black.binary"
    write(black, np.zeros((3, *DIMS)))
    code, said = which(black, "--force")
    assert (code, "no light in a channel" in said) == (2, True)


def test_a_failed_fit_has_no_errors(file, tmp_path):
    path = tmp_path / "failed.json"
    write_result(path, made().model_copy(update={"model": None, "parameters": []}))
    shown = CliRunner().invoke(cli.app, ["metrics", str(path), "--against", str(file)])
    assert shown.exit_code == 2
    assert "it has no material" in " ".join(shown.output.split())


def test_of_many_models_a_chart_names_the_nearest():
    rows = [
        row(name, material, rmse=0.01 * (1 + k), smape=0.3 / (1 + k))
        for k, name in enumerate(["ggx", "two-scale", *(f"model {k}" for k in range(10))])
        for material in ("nickel", "chrome")
    ]
    figure = comparison.sorted_errors(rows, "some models")
    named = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert {"two-scale", "ggx", "model 9"} < set(named), "the nearest by either error"
    assert named[-1] == "4 others"
    assert len(named) == comparison.COLOURS + 1
    assert len(figure.axes[1].lines) == 12
