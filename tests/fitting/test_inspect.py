"""`merlfit inspect`: where it finds the file of a fit, and what it says when it cannot draw."""

import shutil
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline import place as keeping
from merlfit.fitting.pipeline.place import Completeness
from merlfit.fitting.results.schema_posterior import sha1_of_draws
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.show.inspection import file_of
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.binary import DIMS, write

from tests.support.command import call
from tests.support.made_results import made, put_result


def test_inspect_finds_the_file_of_a_project_that_moved(tmp_path, monkeypatch):
    """The path in a result is relative to where the fit ran."""
    project = tmp_path / "project"
    (project / "data").mkdir(parents=True)
    write(project / "data" / "nickel.binary", np.ones((3, *DIMS)))
    put_result(project / "fits", path="data/nickel.binary")
    shutil.move(project, tmp_path / "moved")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    shown = call("inspect", tmp_path / "moved" / "fits" / "nickel.json", "-o", elsewhere, "--pictures", "errors")
    assert "is not the file that was fitted" in shown.stderr  # found, and refused: another SHA-1


def test_inspect_draws_a_fit_without_its_file_and_says_what_is_missing(tmp_path, compiled_quickly):
    put_result(tmp_path, path="nowhere/nickel.binary")
    shown = call("inspect", tmp_path / "nickel.json", "--pictures", "peak,errors")
    assert shown.exit_code == 0
    assert "the file is not shown: nowhere/nickel.binary" in shown.stderr
    assert "name the file with --file" in shown.stderr
    assert "not drawn: errors (they need the file)" in shown.stderr
    assert [p.name for p in tmp_path.glob("*.png")] == ["nickel.two-scale.peak.png"]
    named = call("inspect", tmp_path / "nickel.json", "--pictures", "peak", "--file", tmp_path / "gone.binary")
    assert named.exit_code == BAD_INPUT


def test_inspect_that_draws_nothing_says_so_and_fails(tmp_path):
    put_result(tmp_path, path="nowhere/nickel.binary")
    shown = call("inspect", tmp_path / "nickel.json", "--pictures", "errors")
    assert shown.exit_code == BAD_INPUT
    assert "nothing was drawn" in shown.stderr
    assert not list(tmp_path.glob("*.png"))


def test_inspect_refuses_pictures_and_formats_that_there_are_not(tmp_path):
    put_result(tmp_path)
    assert (
        "no such picture; there are spheres, lobes"
        in call("inspect", tmp_path / "nickel.json", "--pictures", "x").stderr
    )
    assert "should be png, pdf or svg" in call("inspect", tmp_path / "nickel.json", "--format", "bmp").stderr


def test_text_that_looks_like_markup_is_printed_as_it_is(tmp_path):
    result = made(material="[bold]x", path="[red]nowhere")
    result.parameters[0].meaning = "a [/] b"
    result.parameters[1].unit = r"\frac{"
    result.fit.message = "[/] ended"
    write_result(tmp_path / "x.json", result)
    shown = call("inspect", tmp_path / "x.json", "--pictures", "errors")
    assert shown.exit_code == BAD_INPUT  # there is no file to draw
    for text in ("[bold]x", "[red]nowhere", "a [/] b", r"\frac{", "[/] ended"):
        assert text in shown.stdout


def test_a_symbol_that_is_no_formula_is_drawn_by_its_name(tmp_path):
    result = put_result(tmp_path, posterior=True)
    result.parameters[0].symbol = r"\frac{"
    names = [q.name for q in result.parameters]
    draws = {"values": np.random.default_rng(0).normal(size=(200, len(names))), "weights": np.full(200, 5e-3)}
    np.savez(tmp_path / "nickel.chain.npz", names=names, **draws)
    result.posterior.draws_sha1 = sha1_of_draws(**draws)
    write_result(tmp_path / "nickel.json", result)
    shown = call("inspect", tmp_path / "nickel.json", "-o", tmp_path, "--pictures", "corner")
    assert shown.exit_code == 0
    assert (tmp_path / "nickel.two-scale.corner.png").exists()
    assert keeping.completeness(tmp_path / "nickel.json") == Completeness.INTERVALS


def test_the_file_of_a_fit_is_found_from_where_it_ran(tmp_path):
    """Its name is relative to a folder that is none of those above the result."""
    data = tmp_path / "data"
    data.mkdir()
    (data / "nickel.binary").write_bytes(b"measured")
    result = made()
    assert file_of(tmp_path / "fits" / "nickel.json", result) == Path("nickel.binary")
    result.run.folder = str(data)
    assert file_of(tmp_path / "fits" / "nickel.json", result) == data / "nickel.binary"


def test_a_path_of_other_people_is_no_error(tmp_path):
    named = made(path="x" * 5000)
    assert file_of(tmp_path / "nickel.json", named) == Path("x" * 5000)


def test_values_from_elsewhere_stand_beside_the_posterior(tmp_path):
    result = put_result(tmp_path, posterior=True)
    names, count = [q.name for q in result.parameters], 400
    k = names.index("beta")
    draws = {"values": np.ones((count, len(names))), "weights": np.full(count, 1 / count)}
    draws["values"][:, k] = np.linspace(0.1, 0.2, count)
    draws["values"][:, names.index("p")] = 10 * draws["values"][:, k] + 1e-3 * np.random.default_rng(0).normal(
        size=count
    )
    np.savez(tmp_path / "nickel.chain.npz", names=names, **draws)
    result.posterior.draws_sha1 = sha1_of_draws(**draws)
    result.parameters[k].quantiles = result.parameters[k].quantiles.model_copy(update={"q05": 0.105, "q95": 0.195})
    write_result(tmp_path / "nickel.json", result)
    shown = call("inspect", tmp_path / "nickel.json", "--beside", "beta=0.13", "--beside", "n=2,2,0.5")
    lines = [line.split() for line in shown.stdout.splitlines()]
    beta = next(line for line in lines if line[:1] == ["beta"])
    assert beta[1] == "0.13"
    assert " ".join(beta).endswith("inside, above 30.0% of the posterior")
    assert [line[1] for line in lines if line and line[0].startswith("n_")] == ["2", "2", "0.5"]
    assert "above 0.0% of the posterior" in next(" ".join(line) for line in lines if line[:1] == ["n_B"])
    assert not list(tmp_path.glob("*.png"))
    one_by_one = call("inspect", tmp_path / "nickel.json", "--beside", "beta=0.13", "--beside", "p=1.7").stdout
    assert "together are farther from the middle than 100.0% of the posterior" in " ".join(one_by_one.split())
    (tmp_path / "nickel.chain.npz").unlink()
    assert "inside" in call("inspect", tmp_path / "nickel.json", "--beside", "beta=0.13").stdout


def test_values_beside_a_fit_that_was_not_sampled_and_of_what_it_lacks(tmp_path):
    put_result(tmp_path)
    shown = call("inspect", tmp_path / "nickel.json", "--beside", "beta=0.5")
    assert "by the Laplace approximation" in shown.stdout
    refused = call("inspect", tmp_path / "nickel.json", "--beside", "alpha=0.5")
    assert refused.exit_code == BAD_INPUT
    assert "--beside alpha: should be a parameter of this fit: beta" in " ".join(refused.stderr.split())
