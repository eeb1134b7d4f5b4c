"""Settings: files, what the command line replaces, presets, models that may be fitted; one-line errors."""

import dataclasses
import importlib.util
import re
import tomllib
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.pipeline.models import candidates, layout_for, two_scale
from merlfit.fitting.settings.config import Config, ConfigError, known_keys, load, parse
from merlfit.model.apparatus import Apparatus
from merlfit.model.effects import KINDS, PRESETS
from merlfit.model.measured import Measured
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale
from typer.testing import CliRunner

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[effects]\nbodi = "auto"\n', "unknown key 'effects.bodi'; the nearest known one is 'effects.body'"),
        ("sede = 1\n", "'seed'"),
        ("[effects]\norder = 1000\n", "effects: order 1000 of"),
        ('[effects]\nbody = "wood"\n', "effects.body"),
        ("[fit\n", "is not TOML"),
        ('[fit]\nmax_steps = "40"\n', "fit.max_steps"),
        ("[effects]\norder = true\n", "effects.order"),
        (
            "[acquisition]\ngrazing_loss = 2\n",
            "grazing_loss: should be 'auto', 'off', 'free', 'derived' or a",
        ),
        ("seed = -1\n", "seed"),
        ('[effects]\nindex = "usual"\n', "effects.index"),
        ('[fit]\nweights = "squared"\n', "fit.weights"),
        ("[fit]\ntheta_max = 0.1\n", "fit.theta_max"),
        ("[fit]\nhighlight = 0.2\n", "unknown key 'fit.highlight'"),
        ("fit = 3\n", "fit: should be a section with keys of its own, not 3"),
        ("[priors]\nb = 3\n", "priors.b: should be a section with keys of its own, not 3"),
        ("[priors]\nb = { median = 1.0 }\n", "priors.b.factor: is missing"),
        ("[fit]\nstarts = 2.5\n", "fit.starts: should be an integer, not 2.5"),
        ("seed = {}\n", "seed: should be an integer, not a section"),
    ],
)
def test_bad_settings_are_one_line_errors(tmp_path, text, words):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load(path)
    assert words in str(error.value)
    assert "\n" not in str(error.value).replace(text, "")
    assert "Section" not in str(error.value)
    shown = CliRunner().invoke(cli.app, ["fit", "x.binary", "--config", str(path)])
    assert shown.exit_code == 2


def test_settings_may_begin_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbfseed = 7\r\n")
    assert load(path).seed == 7


def test_a_backend_that_is_not_installed_is_a_bad_setting(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"merlfit\[crosscheck\]"):
        parse({"fit": {"backend": "jaxopt"}}, "here")


def test_results_of_earlier_versions_name_the_solver_by_its_library():
    assert parse({"fit": {"backend": "optimistix"}}, "here") == Config()


def test_default_toml_is_the_defaults():
    text = (ROOT / "configs" / "default.toml").read_text()
    assert parse(tomllib.loads(text), "default.toml") == Config()
    data = tomllib.loads(re.sub(r"^# (?=\w+ = )", "", text, flags=re.M))  # with the keys that presets set
    assert parse(data, "default.toml") == Config()
    sections = ("input", "model", "effects", "acquisition", "apparatus", "priors", "fit", "posterior")
    assert {f"{s}.{k}" for s in sections for k in data[s]} | {"seed", "parameters", *sections} == set(known_keys())


def test_settings_of_effects_are_those_of_the_model():
    chosen = {"fresnel": "schlick", "masking": "none", "renormalised": False}
    found = parse({"effects": chosen, "acquisition": {"grazing_loss": 0.5}}, "here")
    assert two_scale(found, ("complex", "none")) == Measured(TwoScale(**chosen), 0.5)


def test_settings_of_the_acquisition_are_those_of_the_model():
    assert {model.grazing_loss for model in candidates(Config())} == {Measured.grazing_loss}
    derived = {"acquisition": {"grazing_loss": "derived"}, "apparatus": {"lamp_sigma_rad": 0.01}}
    lamp = two_scale(parse(derived, "here"), ("complex", "none"))
    assert lamp == Measured(TwoScale(), "derived", Apparatus(lamp_sigma_rad=0.01))


def preset(name, **changed):
    """The model with a preset's effects."""
    return TwoScale(**(dataclasses.asdict(PRESETS[name]) | changed))


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_those_of_the_model(name):
    if name == "reference":  # hours on MERL's grid
        with pytest.raises(ConfigError, match="fit with quadrature"):
            parse({"effects": {"preset": name}}, "here")
        return
    expected = preset(name, index="real", body="plastic")
    assert two_scale(parse({"effects": {"preset": name}}, "here"), ("real", "plastic")) == Measured(expected)
    assert candidates(load(preset=name, body="plastic")) == [Measured(expected)]
    beside = parse({"effects": {"preset": name, "masking": "none"}}, "here")
    assert two_scale(beside, ("real", "plastic")).material == dataclasses.replace(expected, masking="none")


def test_the_command_line_replaces_the_preset_and_leaves_the_keys_beside_it(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('seed = 3\n[effects]\npreset = "conserving"\nmasking = "none"\n[acquisition]\ngrazing_loss = 0.5\n')
    found = load(path, preset="preview", body="plastic", posterior=False)
    kind = {"index": "real", "body": "plastic"}
    assert candidates(found) == [Measured(preset("preview", **kind, masking="none"), 0.5)]
    assert found.seed == 3
    assert not found.posterior.enabled
    assert load(path, seed=5).seed == 5
    assert load(path).effects.split == "conserving"


def test_the_command_line_replaces_index_and_weights(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('[effects]\nindex = "real"\n[fit]\nweights = "log"\ntheta_max = 1.3\n')
    found = load(path, index="complex", weights="none")
    assert found.effects.index == "complex"
    assert (found.fit.weights, found.fit.theta_max, found.exponents[-1]) == ("none", 1.3, 0.0)
    assert load(path).exponents[-1] == "log"
    assert Config().exponents == (1.4,)


@pytest.mark.parametrize(
    ("given", "kinds"),
    [
        ({}, KINDS),
        ({"index": "complex"}, [("complex", "none"), ("complex", "lambert")]),
        ({"index": "real"}, [("real", "lambert"), ("real", "plastic"), ("real", "subsurface")]),
        ({"body": "none"}, [("complex", "none")]),
        ({"body": "lambert"}, [("real", "lambert"), ("complex", "lambert")]),
        ({"body": "plastic"}, [("real", "plastic")]),
        ({"index": "complex", "body": "lambert"}, [("complex", "lambert")]),
        ({"index": "real", "body": "none"}, [("real", "none")]),
    ],
    ids=str,
)
def test_kinds_are_those_that_agree_with_what_is_given(given, kinds):
    config = load(**given)
    assert [model.material.kind for model in candidates(config)] == list(kinds)
    for model in candidates(config):
        assert layout_for(config, model).model == model == two_scale(config, model.material.kind)


def test_models_are_candidates_the_fewest_parameters_first():
    assert candidates(load(model="ggx")) == [Measured(GGX())]
    assert load(model=["ggx"]).model.name == "ggx"
    found = candidates(load(model=["two-scale", "oren-nayar-qualitative", "ggx"]))
    assert [model.variant for model in found] == ["oren-nayar-qualitative", "ggx", *map(" ".join, KINDS)]
    assert found[0].grazing_loss == "off"  # it has nothing sharp


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"model": {"name": "gx"}}, "model: there is no 'gx'; the nearest is 'ggx'"),
        ({"model": {"name": "GGX"}}, "the nearest is 'ggx'"),
        ({"model": {"name": "phong"}}, r"there is no 'phong'; the nearest is 'blinn-phong' \(`merlfit models` lists"),
        ({"model": {"name": []}}, "should be one model, or several different ones"),
        ({"model": {"name": ["ggx", "ggx"]}}, "should be one model, or several different ones"),
        ({"model": {"name": 3}}, "model.name: should be a model's name, or a list of them, not 3"),
        (
            {"model": {"name": "ggx", "order": 3}},
            "model: ggx has no setting 'order': its settings are fresnel, masking",
        ),
        (
            {"model": {"order": 3}},
            r"'order' is none of its keys: .* belong in \[effects\]",
        ),
        ({"model": {"name": ["ggx", "two-scale"], "order": 3}}, "order is a setting of one model"),
        (
            {"model": {"name": "ggx"}, "effects": {"body": "lambert"}},
            "effects.body is a setting of the two-scale",
        ),
        (
            {"model": {"name": "oren-nayar-qualitative"}, "acquisition": {"grazing_loss": 0.5}},
            "of which the model has no",
        ),
        (
            {"acquisition": {"grazing_loss": 2}},
            "acquisition.grazing_loss: should be 'auto', 'off', 'free', 'derived'",
        ),
    ],
    ids=str,
)
def test_models_that_cannot_be_fitted_are_refused(data, words):
    with pytest.raises(ConfigError, match=words):
        parse(data, "here")


@pytest.mark.parametrize("body", ["plastic", "subsurface"])
def test_a_clear_interface_with_a_complex_index_is_refused(body):
    with pytest.raises(ConfigError, match=f"effects: body '{body}' .*: its index is real"):
        load(index="complex", body=body)


def test_presets_that_only_switch_things_off_are_not_refused():
    assert parse({"effects": {"preset": "preview", "diffraction": "off"}}, "here").effects.fresnel == "schlick"


def test_what_a_model_cannot_use_is_left_out_of_it():
    """A preset's colour without diffraction; the loss of a model without lobes beside one with lobes."""
    dark = parse({"effects": {"preset": "preview", "diffraction": "off"}}, "here")
    assert two_scale(dark, ("complex", "none")) == Measured(TwoScale(diffraction="off", fresnel="schlick"))
    acquisition = {"acquisition": {"grazing_loss": "derived"}, "apparatus": {"lamp_sigma_rad": 0.01}}
    both = parse({"model": {"name": ["ggx", "oren-nayar-qualitative"]}, **acquisition}, "here")
    assert {model.material.name: model.grazing_loss for model in candidates(both)} == {
        "ggx": "derived", "oren-nayar-qualitative": "off",
    }  # fmt: skip


def test_the_reference_is_refused_in_fits():
    with pytest.raises(ConfigError, match="fit with quadrature"):
        parse({"effects": {"diffraction": "exact"}}, "here")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"effects": {"order": 48, "diffraction": "lobe"}}, "order has an effect only where .* is quadrature"),
        ({"effects": {"preset": "microfacet", "colour": "fresnel"}}, "colour has an effect only where"),
        ({"effects": {"diffraction": "off", "renormalised": False}}, "renormalised has an effect only where"),
        ({"apparatus": {"lamp_sigma_rad": 0.01}}, "grazing_loss is derived"),
    ],
)
def test_keys_that_would_have_no_effect_are_refused(data, words):
    with pytest.raises(ConfigError, match=words) as error:
        parse(data, "here")
    assert "Value error" not in str(error.value)


def test_lists_in_lists_without_end_are_refused(tmp_path):
    path = tmp_path / "deep.toml"
    path.write_text(f"seed = {'[' * 5000}{']' * 5000}")
    with pytest.raises(ConfigError, match=r"deep\.toml: its lists or tables lie in each other too deeply"):
        load(path)


def test_numbers_of_numpy_are_numbers():
    data = {
        "fit": {"starts": np.int64(4), "theta_max": np.float32(1.25)},
        "effects": {"renormalised": np.bool_(False)},
        "parameters": {"eta": {"fixed": np.array([1.5, 1.6, 1.7])}, "kappa": {"fixed": (np.float64(0.0),) * 3}},
    }
    config = load(data)
    assert (config.fit.starts, config.fit.theta_max, config.effects.renormalised) == (4, 1.25, False)
    assert config.parameters["eta"].fixed == (1.5, 1.6, 1.7)
    with pytest.raises(ConfigError, match=r"^settings: fit\.starts: should be an integer, not 4\.5$"):
        load({"fit": {"starts": np.float64(4.5)}})


@pytest.mark.parametrize(
    "value", [Path("x"), date(2026, 1, 1), 1j, np.complex128(1), np.array([None, Path("x")]), np.longdouble(4), {4}]
)
def test_values_of_other_types_are_refused(value):
    with pytest.raises(ConfigError, match=r"^settings: fit\.starts: should be a number, .* not "):
        load({"fit": {"starts": value}})


def test_a_date_is_no_setting(tmp_path):
    path = tmp_path / "dated.toml"
    path.write_text("[fit]\nweights = 2026-01-01\n")
    with pytest.raises(ConfigError, match=r"dated\.toml: fit\.weights: should be a number, a text, "):
        load(path)


def test_mappings_without_end_and_numbers_without_end_are_refused():
    circular = {}
    circular["fit"] = circular
    with pytest.raises(ConfigError, match="lie in each other too deeply"):
        load(circular)
    with pytest.raises(ConfigError, match=r"^settings: .*integer"):
        load({"seed": 10**5000})
