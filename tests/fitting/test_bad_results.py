"""One bad result among several: it is told in a line, and the others have their rows and pages."""

import csv
import json
import os

import numpy as np
import pytest
from merlfit.fitting.pipeline.draws import NoPicture, chain_file
from merlfit.fitting.results.manifest import NAME, lines
from merlfit.fitting.results.storage import ResultError, read_result, write_result
from merlfit.fitting.settings.config import ConfigError, load
from merlfit.fitting.show import site
from merlfit.fitting.support.terminal import BAD_INPUT, FAILED_FIT
from merlfit.scene.description import SceneError
from merlfit.scene.description import load as load_scene
from merlfit.scene.images import read_map

from tests.support.command import call
from tests.support.made_results import made

LATIN = b"caf\xe9".decode("utf-8", "surrogateescape")
LONG = "x" * 250


def put(folder, name, edit=None, **kind):
    """A result of scattered directions, whose page needs no picture."""
    result = made(name.encode(errors="replace").decode(), **kind)
    result.source.format = "table"
    path = folder / f"{name}.json"
    write_result(path, result)
    if edit:
        data = json.loads(path.read_text())
        edit(data)
        path.write_text(json.dumps(data))
    return path


ODD = {
    "a version of many digits": (lambda d: d.update(schema_version="9" * 4301), "schema_version '9{40}' is not"),
    "no total": (lambda d: d.update(seconds={}), "seconds.total: is missing"),
    "a limit that is text": (lambda d: d["config"]["fit"].update(theta_max="x"), "theta_max: should be an angle"),
    "a limit that is none": (lambda d: d["config"]["fit"].update(theta_max=np.nan), "theta_max: should be an angle"),
    "a limit too far": (lambda d: d["config"]["fit"].update(theta_max=1e300), "theta_max: should be an angle"),
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_results_are_refused(kind, tmp_path):
    edit, words = ODD[kind]
    with pytest.raises(ResultError, match=words):
        read_result(put(tmp_path, "odd", edit))


@pytest.fixture
def run(tmp_path):
    """A good result among odd ones, a manifest that is a folder, and names of all kinds."""
    folder = tmp_path / "fits"
    folder.mkdir()
    (folder / NAME).mkdir()
    put(folder, "good")
    put(folder, "version", ODD["a version of many digits"][0])
    put(folder, "settings", lambda d: d.update(config={}))
    for name in (LONG, LATIN, "m\u00fcsli"):
        put(folder, name)
    return folder


def test_a_table_has_all_other_rows(run):
    shown = call("table", run)
    assert shown.exit_code == BAD_INPUT
    assert len(shown.stderr.splitlines()) == 1
    assert "version.json: is not a merlfit result: " in shown.stderr
    with open(run / "table.csv", newline="", encoding="utf-8") as file:
        rows = {row["material"]: row["status"] for row in csv.DictReader(file)}
    assert rows == dict.fromkeys(["good", "settings", LONG, "caf?", "m\u00fcsli"], "CONVERGED") | {
        "version": "unreadable"
    }


def test_a_report_has_all_other_pages(run, monkeypatch):
    whole = site._page_of

    def fails(job, result):
        if job.name == "good":
            raise ZeroDivisionError("of\nwhatever kind")
        return whole(job, result)

    monkeypatch.setattr(site, "_page_of", fails)
    shown = call("report", run, "-j", 1)
    assert shown.exit_code == BAD_INPUT
    assert "good.json: failed unexpectedly: ZeroDivisionError: of whatever kind" in shown.stderr
    pages = run / "report" / "materials"
    assert {p.stem for p in pages.iterdir()} == {"good", "settings", LONG[:200], "caf?", "m\u00fcsli"}
    assert "ZeroDivisionError" in (pages / "good.html").read_text()
    (run / "version.json").unlink()
    assert call("report", run, "-j", 1).exit_code == FAILED_FIT


def test_links_of_a_name_that_is_no_utf8_lead_to_it(tmp_path):
    put(tmp_path, LATIN)
    assert call("report", tmp_path, "-j", 1).exit_code == 0
    assert "caf%E9.json" in (tmp_path / "report" / "materials" / "caf?.html").read_text()


def test_errors_of_all_other_results(tmp_path):
    table = tmp_path / "samples.csv"
    table.write_text("theta_i_deg,theta_o_deg,phi_deg,R,G,B\n30,30,180,1,1,1\n10,20,0,.1,.1,.1\n")
    good, odd = put(tmp_path, "good"), put(tmp_path, "odd", ODD["no total"][0])
    shown = call("metrics", odd, good, "--against", table, "-o", tmp_path / "out")
    assert shown.exit_code == BAD_INPUT
    assert "seconds.total: is missing" in shown.stderr
    assert sorted(os.listdir(tmp_path / "out")) == ["by_incidence.csv", "by_incidence.png", "metrics.csv"]
    shown = call("metrics", good, good, "--against", tmp_path / "none.csv")
    assert shown.exit_code == BAD_INPUT
    assert len(shown.stderr.splitlines()) == 1


def draws_at(path):
    result = made(posterior=True)
    result.posterior.chain_file = path.name
    return chain_file(result, path.with_name("nickel.json"))


@pytest.mark.parametrize("kind", ["pipe", "zeros"])
@pytest.mark.parametrize(
    ("read", "refusal", "ending"),
    [
        (read_result, ResultError, "json"), (load, ConfigError, "toml"), (load_scene, SceneError, "toml"),
        (read_map, SceneError, "npy"), (read_map, SceneError, "exr"), (draws_at, NoPicture, "npz"),
    ],
)  # fmt: skip
def test_what_is_no_regular_file_is_refused_at_once(read, refusal, ending, kind, tmp_path):
    path = tmp_path / f"endless.{ending}"
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    with pytest.raises(refusal, match=r"endless\.\w+: is not a regular file$"):
        read(path)


@pytest.mark.parametrize("kind", ["pipe", "zeros"])
def test_a_manifest_that_is_no_regular_file_says_nothing(kind, tmp_path):
    os.mkfifo(tmp_path / NAME) if kind == "pipe" else (tmp_path / NAME).symlink_to("/dev/zero")
    assert list(lines(tmp_path)) == []


def test_draws_that_unpack_to_more_than_their_file_may_hold_take_no_memory(tmp_path):
    size = len(made().parameters)
    path = tmp_path / "zeros.npz"
    np.savez_compressed(path, names=["x"], values=np.zeros((2**20, size)), weights=np.zeros(2**20))
    with pytest.raises(NoPicture, match="cannot be read"):
        draws_at(path)


def test_a_map_that_says_to_be_larger_than_its_file_takes_no_memory(tmp_path):
    path = tmp_path / "large.npy"
    with open(path, "wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": (2**20, 2**20, 3)}
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(SceneError, match=r"large\.npy: "):
        read_map(path)
