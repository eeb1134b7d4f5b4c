"""Fits that are edited: what the new result has, what it no longer claims, and what every command says of it."""

import json

import merlfit
import numpy as np
import pytest
from merlfit.fitting.pipeline.editing import edited
from merlfit.fitting.results.storage import read_result, valid_result, write_result
from merlfit.fitting.settings.config import Config, ConfigError
from merlfit.fitting.show.parameter_table import as_latex
from merlfit.fitting.show.simulated import again
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.support.command import call
from tests.support.made_results import made


@pytest.fixture
def path(tmp_path):
    """A fit in a file."""
    result = made()
    write_result(tmp_path / "nickel.json", result.model_copy(update={"numbers_sha1": result.digest}))
    return tmp_path / "nickel.json"


def test_what_is_edited_has_its_values_and_nothing_that_was_found_of_others(path):
    fit = merlfit.load(path)
    found = fit.edited(beta=0.05, n_G=1.5, k=[2.0, 2.5, 3.0])
    assert found.parameters["beta"] == 0.05
    np.testing.assert_array_equal(found.parameters["n"], [1.0, 1.5, 1.0])
    np.testing.assert_array_equal(found.parameters["k"], [2.0, 2.5, 3.0])
    assert fit.parameters["beta"] == 0.1
    result = found.result
    assert (found.status, found.succeeded, found.cost) == ("EDITED", True, None)
    assert not any(x is not None for x in found.metrics.model_dump().values())
    assert (result.posterior, result.identifiability, result.accuracy) == (None, None, None)
    assert not result.derived
    assert not result.tis
    changed = {"beta", "n_G", "k_R", "k_G"}  # k_B was 3
    assert {q.name for q in result.parameters if q.laplace is None} == changed == {*result.edited_from.fitted}
    assert result.edited_from.result == str(path)
    assert result.edited_from.numbers_sha1 == fit.result.numbers_sha1
    assert "beta 0.1 -> 0.05, n_G 1 -> 1.5" in str(found).replace("\n", " ")
    assert r"$\beta$ & $0.05$ (edited) &" in as_latex([result])


def test_it_is_edited_again_from_the_same_fit_and_back(path):
    once = merlfit.load(path).edited(beta=0.05)
    again = once.edited(beta=0.1, b=2.0)
    assert again.result.edited_words == "edited from the fit nickel.json: b 3 -> 2"
    assert again.edited(b=3.0).result.edited_words.endswith("all values are those of the fit again")
    assert once.edited(beta=0.05).result is once.result


def test_what_makes_it_again_does(path):
    """To the last digit, also of a parameter that all channels have in common."""
    fit = merlfit.load(path)
    tied = [
        q.model_copy(update={"fitted": "tied", "value": 1.0}) if q.name in ("n_G", "n_B") else q
        for q in fit.result.parameters
    ]
    whole = fit.result.model_copy(update={"parameters": tied})
    write_result(path, whole.model_copy(update={"numbers_sha1": whole.digest}))
    found = merlfit.load(path).edited(n=1.2345678901, beta=0.05)
    made_again = eval(again(found.result), {"merlfit": merlfit})
    assert made_again.result.parameters == found.result.parameters


def test_cautions_of_the_fit_go_along(path):
    result = read_result(path)
    result.fit.cautions.append("n and k are those of no matter")
    once = edited(path, result, {"beta": 0.05})
    twice = edited(path, once, {"beta": 0.06})
    assert once.fit.cautions == twice.fit.cautions == ["of the fit: n and k are those of no matter"]


def test_values_that_are_those_of_the_fit_are_no_edit(path, tmp_path):
    fit = merlfit.load(path).edited(beta=0.1)
    assert (fit.path, fit.result.edited_from) == (path, None)
    assert call("export", path, "--to", "json", "--set", "beta=0.1", "-o", tmp_path / "out").exit_code == 0
    assert (tmp_path / "out" / "nickel.material.json").is_file()


def test_what_was_changed_by_hand_is_not_edited(path):
    path.write_text(path.read_text().replace('"value": 0.1', '"value": 0.11', 1))
    with pytest.raises(merlfit.ResultError, match="was changed by hand"):
        merlfit.load(path).edited(beta=0.05)


def test_it_is_saved_beside_the_fit_and_read_again(path):
    fit = merlfit.load(path)
    saved = fit.edited(beta=0.05).save(path.parent)
    assert saved == path.with_name("nickel.edited.json")
    found = merlfit.load(saved)
    assert found.result == fit.edited(beta=0.05).result.model_copy(update={"run": found.result.run})
    assert merlfit.load(path).result == fit.result
    with pytest.warns(UserWarning, match=r"nickel\.edited\.2"):
        fit.edited(beta=0.06).save(path.parent)
    saved.write_text(saved.read_text().replace("0.05", "0.055", 1))
    assert read_result(saved).changed_by_hand


def test_a_loss_that_is_derived_from_widths_is_that_of_the_new_ones(path, monkeypatch):
    monkeypatch.setattr(Measured, "exponent", lambda self, lobe, values, wavelengths_um: values["beta"] / 2)
    result = made(model=Measured(TwoScale("none"), "derived"))
    found = edited(path, result, {"beta": 0.3}).model.acquisition.exponents
    assert found == {"specular": 0.15, "diffracted": 0.15}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"betta": 0.1}, r"there is no parameter 'betta'; the nearest is 'beta' \(there are beta, p, b, c,"),
        ({"beta": 5.0}, "beta: 5 is outside its bounds, 0.001 to 1"),
        ({"beta": np.nan}, "beta: nan is outside its bounds"),
        ({"beta_R": 0.1}, "beta_R: all channels share beta: set beta"),
        ({"beta": [0.1, 0.2]}, "beta: should be one number, not 2"),
        ({"n": [1.0, 2.0]}, "n: should be one number, or 3, one for each channel, not 2"),
        ({"n": 1.5, "n_R": 1.2}, "n_R: is set twice, by itself and by n"),
        ({"beta": "wide"}, "beta: should be a number, not 'wide'"),
    ],
)
def test_what_cannot_be_is_one_line(values, said, path):
    with pytest.raises(ConfigError, match=said):
        merlfit.load(path).edited(**values)


def test_what_is_one_for_all_channels_stays_one(path):
    result = made()
    tied = [
        q.model_copy(update={"fitted": "tied"}) if q.name in ("n_R", "n_B") else q for q in result.parameters
    ]  # fmt: skip
    result = result.model_copy(update={"parameters": tied})
    with pytest.raises(ConfigError, match="n_G: the fit has one n for all channels: set n"):
        edited(path, result, {"n_G": 1.2})
    np.testing.assert_array_equal(edited(path, result, {"n": 1.2}).values()["n"], [1.2] * 3)


def test_every_command_says_that_it_is_no_fit(path):
    saved = merlfit.load(path).edited(beta=0.05).save(path.parent)
    sampled = call("sample", saved)
    assert sampled.exit_code == BAD_INPUT
    assert "was edited from the fit nickel.json: beta 0.1 -> 0.05; it has no posterior" in sampled.stderr
    shown = call("inspect", saved, "--pictures", "none")
    assert "nothing was fitted to these values: they have no errors and no posterior" in " ".join(shown.stdout.split())
    assert "RMSE" not in shown.stdout
    assert "1 EDITED" in call("table", path.parent).stdout
    assert valid_result(saved, "0" * 40, Config()) is None


def test_options_set_values_and_name_files_of_their_own(path):
    out = path.parent / "out"
    shown = call("export", path, "--to", "json", "--set", "beta=0.05", "--set", "n=1,2,3", "-o", out)
    assert shown.exit_code == 0
    found = json.loads((out / "nickel.edited.material.json").read_text())
    assert found["parameters"]["beta"]["value"] == 0.05
    assert [found["parameters"][f"n_{c}"]["value"] for c in "RGB"] == [1, 2, 3]
    assert found["rmse_per_sr"] is None
    assert found["edited_from"]["fitted"] == {"beta": 0.1, "n_G": 1.0, "n_B": 1.0}
    assert not (out / "nickel.material.json").exists()
    assert (
        "--set beta: is given twice"
        in call("export", path, "--to", "json", "--set", "beta=1", "--set", "beta=2").stderr
    )
    for words in (("synth", "nickel", "-o", out / "x.binary"), ("render", "scene.toml")):
        assert "for the RESULT.json of a fit" in call(*words, "--set", "beta=0.05").stderr
