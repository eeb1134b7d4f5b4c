"""The command line as a user meets it: exit codes, one-line errors, files that appear."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import jsonschema
import numpy as np
import pytest
import typer.main
from merlfit.fitting.commands import cli
from merlfit.fitting.fit.levenberg_marquardt import Status
from merlfit.fitting.posterior import chain as sampler
from merlfit.fitting.posterior import importance
from merlfit.fitting.results import schema
from merlfit.fitting.results import storage as export
from merlfit.fitting.show import prediction
from merlfit.fitting.support.terminal import FAILED_FIT
from merlfit.merl_io.atomic import write_atomically
from merlfit.merl_io.binary import read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import TwoScale
from typer.testing import CliRunner

from tests import result_schema
from tests.support.compiled import two_scale

ROOT = Path(__file__).parents[1]
runner = CliRunner()
QUICK = '[effects]\nbody = "none"\ndiffraction = "lobe"\n[fit]\nstarts = 1\ngrid = "coarse"\n'


def call(*words):
    return runner.invoke(cli.app, [str(w) for w in words])


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A published material synthesised, fitted with a short chain, all through the command line."""
    folder = tmp_path_factory.mktemp("cli")
    file = folder / "blue-metallic-paint.binary"
    assert call("synth", "blue-metallic-paint", "--source", "abc-microfacet", "-o", file).exit_code == 0
    settings = folder / "short.toml"
    settings.write_text(f"{QUICK}[posterior]\nmax_steps = 20\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampler, "RETRAININGS", 0)  # which tests/fitting/test_posterior.py looks at
        patch.setattr(importance, "MOST_DRAWS", 60)  # a thirtieth of a second each
        patch.setattr(importance, "DRAWS", 40)
        done = call("fit", file, "-o", folder / "out", "--config", settings, "--seed", "3")
    assert done.exit_code in (0, FAILED_FIT), done.output
    return folder, file


def test_a_bad_file_does_not_stop_the_others(fitted, tmp_path):
    """Fitted by processes of the pool, without a chain: these know nothing of what is patched here.

    GGX, of which a new process has fewer programs to read.
    """
    settings = tmp_path / "quick.toml"
    settings.write_text('[model]\nname = "ggx"\n[fit]\nstarts = 1\ngrid = "coarse"\n')
    words = ("-o", tmp_path / "out", "--config", settings, "--no-posterior")
    done = call("fit", fitted[1], tmp_path / "missing.binary", *words)
    assert done.exit_code == 2
    assert "missing.binary: no such file" in done.stderr
    assert (tmp_path / "out" / "blue-metallic-paint.json").is_file()


def test_result_obeys_the_shipped_schema(fitted):
    folder = fitted[0]
    data = json.loads((folder / "out" / "blue-metallic-paint.json").read_text())
    schema = json.loads((ROOT / "fitting" / "results" / "result.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(data, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**data, "parameters": [{"name": "beta"}]}, schema)
    assert data["seed"] == 3
    assert data["source"]["sha1"] == read(fitted[1]).sha1
    assert [q["name"] for q in data["parameters"]][:2] == ["beta", "p"]
    assert all(q["lower"] <= q["value"] <= q["upper"] for q in data["parameters"])
    assert all(q["laplace"] is None for q in data["parameters"] if q["at_bound"] != "no")
    known = [q for q in data["parameters"] if q["laplace"]]
    assert {"beta", "p"} <= {q["name"] for q in known}
    for q in known:
        assert q["lower"] <= q["laplace"]["q05"] < q["value"] == q["laplace"]["q50"] < q["laplace"]["q95"] <= q["upper"]
    assert all(math.isfinite(x) for x in data["seconds"].values())


def test_a_chain_too_short_says_so_and_gives_no_intervals(fitted):
    result = export.read_result(fitted[0] / "out" / "blue-metallic-paint.json")
    assert result.posterior is not None
    assert not result.posterior.sufficient
    said = r"\d+ steps are \d+ autocorrelation times, 50 are needed; continue the chain with `merlfit sample`"
    assert re.fullmatch(said, result.posterior.message)
    assert result.derived
    assert all(q.quantiles is None for q in [*result.parameters, *result.derived, *result.tis])
    assert [(q.theta_i_deg, q.channel) for q in result.tis] == [(theta, c) for theta in (0, 30, 60) for c in "RGB"]
    assert all(q.laplace and q.laplace.q05 < q.value < q.laplace.q95 for q in result.tis)
    size, p = len(result.parameters), result.posterior
    assert len(p.coordinates) == len(p.r_hat) == len(p.effective_size) == len(p.contraction) == size
    with np.load(fitted[0] / "out" / p.chain_file, allow_pickle=False) as chain:
        assert chain["chain_free"].shape == (p.steps, p.walkers, size) == (p.steps, 32, size)
        assert chain["log_prob"].shape == (p.steps, 32)
        assert chain["draws_free"].shape == chain["values"].shape == (p.draws, size)
        assert chain["weights"].shape == chain["log_ratio"].shape == (p.draws,)
        assert chain["weights"].sum() == pytest.approx(1)
        assert tuple(chain["names"]) == tuple(q.name for q in result.parameters)
        assert tuple(chain["coordinates"]) == tuple(p.coordinates)
        for q in result.derived:
            assert len(chain[f"derived_{q.quantity}"]) == p.draws


def test_inspect_prints_and_draws(fitted):
    folder = fitted[0]
    words = ("-o", folder / "pictures", "--pictures", "lobes")  # of all pictures: tests/fitting/test_pictures.py
    shown = call("inspect", folder / "out" / "blue-metallic-paint.json", *words)
    assert shown.exit_code == 0
    for word in ("beta", "sigma_s", "50 are needed", "conductor", "derived quantities", "total integrated scatter"):
        assert word in shown.stdout
    assert (folder / "pictures" / "blue-metallic-paint.two-scale.lobes.png").stat().st_size > 20_000


def test_sampling_goes_on_with_the_chain_beside_a_fit(fitted, tmp_path, monkeypatch):
    folder = fitted[0]
    for name in ("blue-metallic-paint.json", "blue-metallic-paint.chain.npz"):
        shutil.copy(folder / "out" / name, tmp_path)
    path, chain = tmp_path / "blue-metallic-paint.json", tmp_path / "blue-metallic-paint.chain.npz"
    before = export.read_result(path)
    monkeypatch.setattr(importance, "MOST_DRAWS", 60)
    monkeypatch.setattr(importance, "DRAWS", 40)
    shown = call("sample", path, "--max-steps", "20")
    assert shown.exit_code == FAILED_FIT
    assert "50 are needed" in shown.stdout
    after = export.read_result(path)
    assert after.posterior.steps == before.posterior.steps + 20
    assert after.fit == before.fit
    assert after.seconds["posterior"] > before.seconds["posterior"]
    with np.load(chain) as longer, np.load(folder / "out" / chain.name) as shorter:
        np.testing.assert_array_equal(longer["chain_free"][: before.posterior.steps], shorter["chain_free"])
        spoiled = {**shorter, "fit_free": shorter["fit_free"] + 0.1}
    shutil.copy(folder / "out" / path.name, path)  # as if it had been killed between its chain and its result
    call("sample", path, "--max-steps", "20")
    assert export.read_result(path).posterior == after.posterior
    np.savez(chain, **spoiled)
    refused = call("sample", path, "--max-steps", "20")
    assert refused.exit_code == 2
    assert "is the chain of another fit; delete it" in refused.stderr
    other = tmp_path / "other.binary"
    write(other, np.ones((3, 90, 90, 180)))
    assert "not the file that was fitted" in call("sample", path, "--file", other).stderr


def test_a_fit_becomes_a_merl_file_again(fitted):
    folder = fitted[0]
    target = folder / "again.binary"
    assert call("synth", folder / "out" / "blue-metallic-paint.json", "-o", target).exit_code == 0
    result, again, grid = (
        export.read_result(folder / "out" / "blue-metallic-paint.json"),
        read(target).values,
        merl_grid(),
    )
    h, d, p = np.random.default_rng(0).integers(0, [[70], [70], [180]], (3, 50))
    g = Geometry.from_half_difference(grid.theta_h[h], grid.theta_d[d], grid.phi_d[p])
    expected = np.asarray(two_scale(result.values(), g, TwoScale("none", "lobe")))
    above = grid.above[h, d, p]
    assert above.sum() > 30
    np.testing.assert_allclose(again[:, h, d, p][:, above], expected[:, above], rtol=1e-2)
    assert np.median(np.abs(again[:, h, d, p][:, above] / expected[:, above] - 1)) < 1e-4


def test_a_long_chain_is_drawn_and_a_chain_of_another_fit_is_not(fitted):
    folder = fitted[0]
    result = export.read_result(folder / "out" / "blue-metallic-paint.json")
    result.posterior.sufficient = True
    path = folder / "out" / "long.json"
    export.write_result(path, result)
    words = ("-o", folder / "pictures", "--pictures", "corner")
    shown = call("inspect", path, *words)
    assert shown.exit_code == 0
    assert (folder / "pictures" / "blue-metallic-paint.two-scale.corner.png").stat().st_size > 50_000
    with np.load(folder / "out" / result.posterior.chain_file) as chain:
        np.savez(
            folder / "out" / "other.npz",
            names=chain["names"][:-1],
            values=chain["values"][:, :-1],
            weights=chain["weights"],
        )
    result.posterior.chain_file = "other.npz"
    export.write_result(path, result)
    assert "chain of another fit" in call("inspect", path, *words).stderr


def test_inspecting_with_another_file_is_bad_input(fitted):
    folder = fitted[0]
    other = folder / "other.binary"
    write(other, np.ones((3, 90, 90, 180)))
    words = ("--file", other, "-o", folder / "pictures", "--pictures", "peak")
    shown = call("inspect", folder / "out" / "blue-metallic-paint.json", *words)
    assert shown.exit_code == 2
    assert "not the file that was fitted" in shown.stderr


def test_check_prints_a_table_and_refuses_bad_files(tmp_path):
    good = tmp_path / "good.binary"
    write(good, np.ones((3, 90, 90, 180)))
    shown = call("check", good)
    assert shown.exit_code == 0
    assert "100.0%" in shown.stdout
    assert call("check", good, tmp_path).exit_code == 2


def test_materials_are_listed_with_what_the_tables_lack():
    shown = call("materials")
    assert shown.exit_code == 0
    assert shown.stdout.startswith("100 materials: alum-bronze,")
    assert "he: Ngan" in shown.stdout
    assert "lacks" in shown.stdout
    assert "Bagher, Soler" in shown.stdout
    (he,) = [line for line in shown.stdout.splitlines() if line.startswith("he:")]
    assert "diffuse alone: black-obsidian, green-plastic, maroon-plastic, red-specular-plastic" in he
    assert "index printed as 1.00" in he
    assert shown.stdout.count("diffuse alone") == 1


def test_a_source_for_a_fit_is_refused(tmp_path):
    shown = call("synth", "some.json", "--source", "sgd", "-o", tmp_path / "x.binary")
    assert shown.exit_code == 2
    assert "--source" in shown.stderr


def test_unknown_material_and_source_name_the_nearest(tmp_path):
    for words, near in ((("nikel",), "'nickel'"), (("nickel", "--source", "smoth"), "'smooth'")):
        shown = call("synth", *words, "-o", tmp_path / "x.binary")
        assert shown.exit_code == 2
        assert near in shown.stderr


def test_statuses_in_the_schema_are_those_of_the_fit():
    assert set(get_args(schema.Fit.model_fields["status"].annotation)) == {"EDITED", *(s.name for s in Status)}


def test_shipped_schema_is_the_models(tmp_path):
    assert json.loads((ROOT / "fitting" / "results" / "result.schema.json").read_text()) == result_schema.schema()


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"schema_version": "9.0"}', "\x00"])
def test_bad_results_are_one_line_errors(tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_text(text)
    shown = call("inspect", path)
    assert shown.exit_code == 2
    assert "bad.json" in shown.stderr
    assert "Traceback" not in shown.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("inspect", "a.binary"), "a.binary: is a measured file, not a result: fit it first, merlfit fit"),
        (("render", "a.binary"), "a.binary: is a measured file, not a result: fit it first, merlfit fit"),
        (
            ("effects", "a.json"),
            "a.json: is no scene (SCENE.toml: docs/scenes.md); of a result there is `merlfit render",
        ),
    ],
)
def test_the_wrong_kind_of_file_is_answered_with_the_right_command(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.binary", "a.json"):
        (tmp_path / name).write_bytes(b"\0" * 100)
    shown = call(*words)
    assert shown.exit_code == 2
    assert said in " ".join(shown.stderr.split())


def test_pages_are_not_fits():
    assert "Pages to make at once" in call("report", "--help").stdout
    assert "dask" not in call("report", "--help").stdout


def test_writing_is_atomic(tmp_path):
    def fail(file):
        file.write(b"half")
        raise RuntimeError

    target = tmp_path / "x.json"
    target.write_text("old")
    with pytest.raises(RuntimeError):
        write_atomically(target, fail)
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    assert target.read_text() == "old"


def test_every_command_has_help_with_an_example():
    for command in typer.main.get_command(cli.app).commands:
        shown = call(command, "--help")
        assert shown.exit_code == 0
        assert f"merlfit {command}" in shown.stdout.replace("\n", " ")


def test_lobe_picture_reads_the_bins_it_should():
    i, o = prediction.plane_of_incidence(0.5, np.array([0.5, -0.2, 1.2]))
    h, d, p = prediction.half_difference(i, o)
    np.testing.assert_allclose(h, [0.0, 0.35, 0.35], atol=1e-12)
    np.testing.assert_allclose(d, [0.5, 0.15, 0.85], atol=1e-12)
    g = merl_grid()
    for theta_h, theta_d, phi, light in zip(h[1:], d[1:], p[1:], i[1:], strict=True):
        expected = np.cos(theta_h) * np.cos(theta_d) - np.sin(theta_h) * np.sin(theta_d) * np.cos(phi)
        assert expected == pytest.approx(light[2])
    assert g.phi_d[0] < 0.01


def test_a_device_that_is_not_there_is_one_line():
    command = [sys.executable, "-m", "merlfit", "models"]
    ended = subprocess.run(command, env={**os.environ, "JAX_PLATFORMS": "tpu"}, capture_output=True, text=True)
    assert ended.returncode != 0
    assert ended.stderr == "merlfit: JAX_PLATFORMS=tpu: JAX finds no such device here; unset it, or set it to cpu\n"
