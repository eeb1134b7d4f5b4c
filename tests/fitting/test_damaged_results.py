"""Results that were edited or damaged: one clear line each, and nothing written where it should not be."""

import json
import math

import numpy as np
import pytest
from merlfit.fitting.pipeline.place import claimed
from merlfit.fitting.posterior import sampling
from merlfit.fitting.posterior.chain import ChainError, read_chain
from merlfit.fitting.results import schema
from merlfit.fitting.results.schema import Source
from merlfit.fitting.results.schema_posterior import sha1_of_draws
from merlfit.fitting.results.storage import ResultError, read_result, valid_result, write_result
from merlfit.fitting.settings.config import Config
from merlfit.fitting.show import subject
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.atomic import unfinished
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.support.command import call
from tests.support.made_results import made, made_draws, put_result


def edited(tmp_path, edit, **kind):
    """A file with a result that was changed by ``edit``."""
    path = tmp_path / "edited.json"
    write_result(path, made(**kind))
    data = json.loads(path.read_text())
    path.write_text(json.dumps(edit(data) or data))
    return path


def set_value(name, value, **others):
    def edit(data):
        (found,) = [q for q in data["parameters"] if q["name"] == name]
        found |= {"value": value, **others}

    return edit


def drop(data, name):
    data["parameters"] = [q for q in data["parameters"] if q["name"] != name]


EDITS = {
    "beta is 0": (set_value("beta", 0), r"parameters\.0: beta 0 is outside its bounds \[0\.001, 1\]"),
    "beta is -1": (set_value("beta", -1), "beta -1 is outside its bounds"),
    "beta is -1, and so is its bound": (set_value("beta", -1, lower=-2), "beta -1 is impossible, whatever its bounds"),
    "beta is 0, and so is its bound": (set_value("beta", 0, lower=0), "beta 0 is impossible, whatever its bounds"),
    "NaN": (set_value("beta", math.nan), "value: is not a finite number"),
    "1e999": (set_value("beta", math.inf), "value: is not a finite number"),
    "a missing parameter": (lambda d: drop(d, "beta"), "beta is missing"),
    "a missing channel": (lambda d: drop(d, "n_G"), "n_G is missing"),
    "another body": (lambda d: d["model"]["settings"].update(body="plastic", index="real"), "eta_R is missing"),
    "no such body": (lambda d: d["model"]["settings"].update(body="wood"), "body 'wood' is none of none, lambert"),
    "no such model": (lambda d: d["model"].update(name="gx"), "there is no 'gx'; the nearest is 'ggx'"),
    "no such setting": (lambda d: d["model"]["settings"].update(bodies="none"), "two-scale has no setting 'bodies'"),
    "a tier that was": (
        lambda d: d["model"]["settings"].update(diffraction="scaled"),
        "diffraction 'scaled' is none of off, lobe",
    ),
    "an order that is text": (lambda d: d["model"]["settings"].update(order="32"), "order '32' should be of type int"),
    "a lobe that is none": (
        lambda d: d["model"]["acquisition"]["exponents"].update(body=0.1),
        "should be those of",
    ),
    "complex under plastic": (
        lambda d: d["model"]["settings"].update(body="plastic"),
        "its index is real, not complex",
    ),
    "no wavelengths": (lambda d: d["model"].update(wavelengths_um=[]), "wavelengths_um has 0 entries, channels 3"),
    "four wavelengths": (lambda d: d["model"].update(wavelengths_um=[0.6] * 4), "wavelengths_um has 4 entries"),
    "negative wavelengths": (
        lambda d: d["model"].update(wavelengths_um=[-0.6] * 3),
        "-0.6 is not between 0.001",
    ),
    "exact": (lambda d: d["model"]["settings"].update(diffraction="exact"), "no fit uses it"),
    "no channels": (lambda d: d["model"].update(channels=[]), "channels should be different names, not none"),
    "empty sizes": (lambda d: d["posterior"].update(effective_size=[]), "effective_size has 0 entries, coordinates 13"),
    "no version": (lambda d: d.pop("schema_version") and None, "schema_version: is missing"),
    "newer": (lambda d: d.update(schema_version="9.0"), r"by a newer merlfit \(schema 9.0.*: update merlfit"),
    "older": (lambda d: d.update(schema_version="2.4"), r"by an older merlfit \(schema 2.4.*: fit the file again"),
    "newer minor": (lambda d: d.update(schema_version="2.999"), "by a newer merlfit"),
    "unknown version": (lambda d: d.update(schema_version="one"), "schema_version 'one' is not 2.5"),
    "an absolute name": (lambda d: d["source"].update(material="/tmp/abs"), "is not the name of a file"),
    "a name elsewhere": (lambda d: d["source"].update(material="../../evil"), "is not the name of a file"),
    "no name": (lambda d: d["source"].update(material=".."), "is not the name of a file"),
    "NUL": (lambda d: d["source"].update(material="a\0b"), "is not the name of a file"),
    "a chain elsewhere": (lambda d: d["posterior"].update(chain_file="/etc/passwd"), "is not the name of a file"),
    "an unknown field": (lambda d: d["fit"].update(colour=1), r"fit\.colour: is no field of a result"),
    "a list": (lambda d: [d], "should be an object"),
}


@pytest.mark.parametrize("name", EDITS)
def test_what_no_fit_writes_is_refused_in_one_line(name, tmp_path):
    edit, words = EDITS[name]
    path = edited(tmp_path, edit, posterior=True)
    with pytest.raises(ResultError, match=words) as error:
        read_result(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)
    assert "Value error" not in str(error.value)
    assert "Input" not in str(error.value)


@pytest.mark.parametrize("command", ["inspect", "sample", "synth"])
def test_every_command_refuses_an_edited_result_and_writes_nothing(command, tmp_path):
    path = edited(tmp_path, lambda d: d["source"].update(material="../../evil"))
    out = tmp_path / "a" / "b"
    out.mkdir(parents=True)
    options = {"inspect": ["-o", out], "sample": [], "synth": ["-o", out / "x.binary"]}[command]
    shown = call(command, path, *options)
    assert shown.exit_code == BAD_INPUT
    assert "is not the name of a file" in shown.stderr
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a", "b", "edited.json"]


@pytest.mark.parametrize("effects", [Measured(TwoScale("plastic")), TwoScale("none", "off"), TwoScale("lambert")])
def test_results_of_a_fit_come_back_as_they_were(effects, tmp_path):
    result = made(model=effects, posterior=True)
    write_result(tmp_path / "x.json", result)
    assert read_result(tmp_path / "x.json") == result


def test_a_byte_order_mark_is_passed_over(tmp_path):
    write_result(tmp_path / "x.json", made())
    (tmp_path / "bom.json").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "x.json").read_bytes())
    assert read_result(tmp_path / "bom.json") == made()


def test_a_value_at_its_bound_but_for_rounding_is_no_mistake(tmp_path):
    path = edited(tmp_path, set_value("beta", 1.0 + 2e-16))
    assert read_result(path).values()["beta"] == 1.0 + 2e-16


def test_a_name_that_is_no_utf8_can_be_written(tmp_path):
    """It would have cost the finished fit."""
    name = b"caf\xe9".decode("utf-8", "surrogateescape")
    result = made(material=name, path=f"/data/{name}.binary", posterior=False)
    target = tmp_path / f"{name}.json"
    write_result(target, result)
    assert read_result(target).source.material == "caf\N{REPLACEMENT CHARACTER}"
    assert Source.model_validate(result.source.model_dump()) == result.source


def chain(**changed):
    size = len(made().parameters)
    names = [q.name for q in made().parameters]
    return {"names": names, **made_draws(size), **changed}


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        (None, "no such file"),
        (b"", "is damaged, or no"),
        (b"PK\x03\x04 and more", "is damaged, or no"),
        (b"text", "is damaged, or no"),
        ({"names": ["beta"]}, "is damaged, or no"),
        (chain(names=["beta"]), "is the chain of another fit"),
        (chain(values=np.ones((5, 2))), "its draws are not 13 finite numbers each"),
        (chain(values=np.full((5, 13), np.nan)), "its draws are not 13 finite numbers each"),
        (chain(weights=np.full(4, 0.25)), "its draws are not 13 finite numbers each"),
    ],
)
def test_a_damaged_chain_is_one_line_in_plain_words(contents, words, tmp_path):
    path = tmp_path / "nickel.chain.npz"
    if isinstance(contents, bytes):
        path.write_bytes(contents)
    elif contents is not None:
        np.savez(path, **contents)
    with pytest.raises(subject.NoPicture, match=words) as error:
        subject.chain_file(made(posterior=True), tmp_path / "nickel.json")
    assert "pickle" not in str(error.value)
    if not isinstance(contents, dict):
        with pytest.raises(ChainError, match=words) as error:
            read_chain(path, np.zeros(13))
        assert "pickle" not in str(error.value)


def with_draws_of(result, draws):
    told = {"draws_sha1": sha1_of_draws(draws["values"], draws["weights"])}
    return result.model_copy(update={"posterior": result.posterior.model_copy(update=told)})


def test_draws_of_another_fit_of_the_same_model_are_refused(tmp_path):
    """They have the names and the shape of this one's."""
    np.savez(tmp_path / "nickel.chain.npz", **chain())
    result = with_draws_of(made(posterior=True), chain())
    assert subject.chain_file(result, tmp_path / "nickel.json")["weights"].tolist() == [0.2] * 5
    np.savez(tmp_path / "nickel.chain.npz", **chain(), chain_free=np.ones((9, 32, 13)))  # goes on, its draws stay
    assert subject.chain_file(result, tmp_path / "nickel.json")
    np.savez(tmp_path / "nickel.chain.npz", **chain(values=np.full((5, 13), 0.3)))
    with pytest.raises(subject.NoPicture, match="is the chain of another fit"):
        subject.chain_file(result, tmp_path / "nickel.json")


def test_a_result_that_was_killed_after_its_chain_had_been_moved_gets_both(tmp_path):
    put_result(tmp_path, posterior=True, chain="replaced already")
    left = unfinished(tmp_path)
    left.mkdir()
    result = with_draws_of(made(posterior=True), chain())
    write_result(left / "nickel.json", result)
    np.savez(tmp_path / "nickel.chain.npz", **chain())
    with claimed(tmp_path):
        pass
    assert read_result(tmp_path / "nickel.json") == result
    assert subject.chain_file(result, tmp_path / "nickel.json")


def test_numbers_that_were_changed_by_hand_are_told(tmp_path):
    result = made()
    write_result(tmp_path / "nickel.json", result.model_copy(update={"numbers_sha1": result.digest}))
    assert not read_result(tmp_path / "nickel.json").changed_by_hand
    text = (tmp_path / "nickel.json").read_text()
    (tmp_path / "nickel.json").write_text(text.replace(f'"value": {result.parameters[0].value}', '"value": 0.123', 1))
    for _ in range(2):
        found = read_result(tmp_path / "nickel.json")
        assert found.changed_by_hand
        assert found.fit.cautions == [schema.BY_HAND]
        write_result(tmp_path / "nickel.json", found)
    shown = call("export", tmp_path / "nickel.json", "--to", "json", "-o", tmp_path)
    assert shown.exit_code == 0
    assert json.loads((tmp_path / "nickel.material.json").read_text())["rmse_per_sr"] is None
    assert valid_result(tmp_path / "nickel.json", "0" * 40, Config()) is None


@pytest.mark.parametrize(("old", "new"), [('"masking": "smith"', '"masking": "none"'), ("0.645", "0.65")])
def test_settings_and_wavelengths_that_were_changed_by_hand_are_told(old, new, tmp_path):
    result, path = made(), tmp_path / "nickel.json"
    write_result(path, result.model_copy(update={"numbers_sha1": result.digest}))
    model, rest = path.read_text().split('"parameters"', 1)
    assert old in model
    assert not read_result(path).changed_by_hand
    path.write_text(f'{model.replace(old, new, 1)}"parameters"{rest}')
    assert read_result(path).changed_by_hand


def test_the_chain_of_a_name_that_is_no_utf8_is_found(tmp_path):
    """The JSON cannot say its name."""
    name = b"caf\xe9".decode("utf-8", "surrogateescape")
    result = made(material=name, posterior=True)
    write_result(tmp_path / f"{name}.json", result)
    np.savez(tmp_path / f"{name}.chain.npz", **chain())
    found = read_result(tmp_path / f"{name}.json")
    assert not (tmp_path / found.posterior.chain_file).exists()
    np.testing.assert_array_equal(subject.chain_file(found, tmp_path / f"{name}.json")["weights"], np.full(5, 0.2))


def test_a_chain_with_a_flipped_bit_is_damaged(tmp_path):
    path = tmp_path / "nickel.chain.npz"
    np.savez_compressed(path, **chain(values=np.random.default_rng(0).normal(size=(500, 13)), weights=np.full(500, 1)))
    spoiled = bytearray(path.read_bytes())
    spoiled[len(spoiled) // 2 :: 500] = b"\xff" * len(spoiled[len(spoiled) // 2 :: 500])
    path.write_bytes(spoiled)
    with pytest.raises(subject.NoPicture, match="is damaged"):
        subject.chain_file(made(posterior=True), tmp_path / "nickel.json")


def test_sampling_a_finished_posterior_whose_chain_is_gone_is_refused(tmp_path):
    """It would have begun anew, and replaced the intervals by those of a chain that may be too short."""
    write_result(tmp_path / "nickel.json", made(posterior=True))
    shown = call("sample", tmp_path / "nickel.json")
    assert shown.exit_code == BAD_INPUT
    assert "its chain nickel.chain.npz is not beside it: put it back, or fit again" in shown.stderr
    assert read_result(tmp_path / "nickel.json") == made(posterior=True)


def test_settings_of_another_version_in_a_result_are_one_line(tmp_path):
    path = edited(tmp_path, lambda d: d["config"].update(colour=1))
    shown = call("sample", path)
    assert shown.exit_code == BAD_INPUT
    assert "unknown key 'colour'" in shown.stderr
    assert shown.exception is None or isinstance(shown.exception, SystemExit)


def test_damaged_draws_are_said_in_a_line(tmp_path):
    path = tmp_path / "x.chain.npz"
    np.savez(path, draws_free=np.arange(999.0))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)
    with pytest.raises(ChainError, match=r"x\.chain\.npz: its draws are damaged; delete it"):
        sampling._drawn(path)
