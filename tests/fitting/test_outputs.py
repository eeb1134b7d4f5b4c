"""What commands may write over: their own earlier outputs, and nothing of anybody else."""

import csv
import json

import merlfit
import numpy as np
import pytest
from merlfit.fitting.commands.cost import OUTPUTS
from merlfit.fitting.cost.frontier import keep
from merlfit.fitting.cost.report import write_markdown
from merlfit.fitting.results.schema_run import Run
from merlfit.fitting.results.storage import versions, write_result
from merlfit.fitting.show import style
from merlfit.fitting.show.results_table import HEADS
from merlfit.fitting.show.site import FIRST, _page_names
from merlfit.fitting.support.outputs import MARKS, is_ours, refuse_others
from merlfit.fitting.support.tables import as_csv
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.atomic import WriteError
from merlfit.scene import images

from tests.support.command import call
from tests.support.frontiers import invented
from tests.support.made_results import made, put_result

TABLE = "theta_i_deg,theta_o_deg,phi_o_deg,R\n10,20,180,0.2\n"
WRITERS = {  # commands with a folder D of results and measurements, and what of D they would write over
    ("table", "D"): ["table.csv"],
    ("table", "D", "-o", "D/paint.csv"): ["paint.csv"],
    ("metrics", "D/nickel.json", "--against", "D/paint.csv", "-o", "D"): [
        "metrics.csv", "by_incidence.csv", "by_incidence.png"
    ],
    ("compare", "D/paint.csv", "-o", "D"): ["comparison.csv", "comparison.md", "comparison.html", "comparison.png"],
    ("report", "D", "-o", "D"): ["index.html", "compare.html", "table.csv", "assets", "materials", "pictures"],
    ("inspect", "D/nickel.json", "-o", "D", "--pictures", "lobes"): ["nickel.two-scale.lobes.png"],
    ("render", "D/scene.toml", "-o", "D"): ["picture.exr", "picture.png", "difference.exr", "render.json"],
    ("render", "D/nickel.json", "-o", "D"): ["nickel.png"],
    ("render", "D/nickel.json", "-o", "D", "--vary", "beta=1,2"): ["nickel.beta.png"],
    ("export", "D/nickel.json", "--to", "json", "-o", "D"): ["nickel.material.json"],
    ("export", "D/nickel.json", "--to", "mitsuba", "-o", "D"): ["nickel.mitsuba.npz", "nickel.xml"],
    ("export", "D/nickel.json", "--to", "rgl", "-o", "D"): ["nickel_rgb.bsdf", "nickel_spec.bsdf", "nickel.rgl.pbrt"],
    ("export", "D/nickel.json", "--to", "principled", "-o", "D"): ["nickel.principled.xml"],
    ("export", "D/nickel.json", "--to", "gltf", "-o", "D"): ["nickel.gltf"],
    ("export", "D/nickel.json", "--to", "openpbr", "-o", "D"): ["nickel.mtlx"],
    ("export", "D/nickel.json", "--to", "blender", "-o", "D"): ["nickel.blender.py"],
    ("export", "D/nickel.json", "--to", "zemax", "-o", "D"): [f"nickel.{c}.zemax.bsdf" for c in "RGB"],
    ("export", "D/nickel.json", "--to", "abg", "-o", "D"): ["nickel.abg.json"],
    ("cost", "-o", "D"): ["frontier.json", "cost.md", "cost.png", "rows.json"],
}  # fmt: skip


@pytest.mark.parametrize(("words", "name"), [(words, name) for words, names in WRITERS.items() for name in names])
def test_no_command_writes_over_a_file_of_somebody_else(words, name, tmp_path):
    put_result(tmp_path)
    (tmp_path / "paint.csv").write_text(TABLE)
    if name in ("assets", "materials", "pictures"):
        (tmp_path / name).mkdir()
    else:
        (tmp_path / name).write_text(TABLE)
    shown = call(*(word.replace("D", str(tmp_path), 1) if word[0] == "D" else word for word in words))
    assert shown.exit_code == BAD_INPUT
    line = shown.stderr.splitlines()[-1]
    assert line.startswith(f"merlfit: {tmp_path / name}: is there already, and no earlier output of this command: ")
    assert (tmp_path / name).is_dir() or (tmp_path / name).read_text() == TABLE


@pytest.mark.parametrize("text", [TABLE, '{"theta_i_deg": 10}'])
def test_a_fit_does_not_take_the_place_of_what_is_no_result(text, tmp_path):
    (tmp_path / "paint.json").write_text(text)
    (tmp_path / "paint.csv").write_text(TABLE)
    shown = call("fit", tmp_path / "paint.csv", "-o", tmp_path)
    assert shown.exit_code != 0
    assert f"{tmp_path / 'paint.json'}: is there already, and no result of merlfit" in shown.stderr
    assert (tmp_path / "paint.json").read_text() == text


def test_a_command_writes_over_what_an_earlier_one_wrote_and_over_all_when_it_is_told(tmp_path):
    put_result(tmp_path)
    for _ in range(2):
        assert call("table", tmp_path).exit_code == 0
        assert call("export", tmp_path / "nickel.json", "--to", "json", "-o", tmp_path).exit_code == 0
    (tmp_path / "table.csv").write_text(TABLE)
    assert call("table", tmp_path).exit_code == BAD_INPUT
    assert call("table", tmp_path, "--force").exit_code == 0
    assert (tmp_path / "table.csv").read_text().startswith("material,status,")


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_pictures_say_whose_they_are(kind, tmp_path):
    figure = style.new(2)
    figure.subplots().plot([1, 2])
    style.save(figure, tmp_path / f"a.{kind}")
    assert is_ours(tmp_path / f"a.{kind}")


def test_pictures_of_scenes_and_pages_that_are_begun_say_whose_they_are(tmp_path):
    images.write_exr(tmp_path / "a.exr", np.ones((200, 200, 3)))
    images.write_png(tmp_path / "a.png", np.random.default_rng(0).random((200, 200, 3)))
    (tmp_path / "index.html").write_text(FIRST)
    (tmp_path / "empty").touch()
    assert all(is_ours(path) for path in tmp_path.iterdir())
    assert not is_ours(tmp_path)


FOREIGN = [
    TABLE.encode(), b"merlfit", b"# merlfit\n\nData: RMSE\n", b'{"theta_i_deg": 10, "merlfit": 1}',
    b'{"asset": {"version": "2.0", "generator": "Blender"}, "extras": "after merlfit"}',
    b"<!doctype html><title>notes</title><p>how I use merlfit", b"<?xml version='1.0'?><p>notes on merlfit</p>",
    b"PK\3\4" + bytes(26) + b"brdf.npy of merlfit", b"\x89PNG\r\n\x1a\n" + bytes(30) + b"iTXtTitle\0a fit of merlfit",
    b"%PDF-1.4\nmerlfit", b"v/1\1comments\0string\0\7\0\0\0merlfit", b"material,reflectance\n", b"group,value\n",
    b'{"schema_version": "1.0", "theta_i_deg": 10, "source": {"made by": "merlfit"}}',
    b'{"seconds": 3, "frames": []}', b'{"event": "file", "at": "merlfit"}\n',
]  # fmt: skip


@pytest.mark.parametrize("ending", MARKS)
def test_what_only_speaks_of_merlfit_is_taken_for_no_output(ending, tmp_path):
    path = tmp_path / f"a{ending}"
    for text in FOREIGN:
        path.write_bytes(text)
        assert not is_ours(path), text


def test_what_no_command_writes_is_no_output_and_a_table_may_have_any_name(tmp_path):
    path = tmp_path / "paint.csv"
    path.write_text("material,status,model,variant,genuine_merl,merlfit")
    assert not is_ours(path)
    assert is_ours(path, "table.csv")
    assert ",".join(HEADS).startswith(path.read_text().removesuffix("merlfit"))


def test_the_message_says_what_is_true_of_outputs_of_older_versions(tmp_path):
    (tmp_path / "a.png").write_text("of 2.0, without a mark")
    with pytest.raises(WriteError, match=r"overwrite it \(--force\), as what an older merlfit wrote without its mark"):
        refuse_others([tmp_path / "a.png"])
    refuse_others([tmp_path / "a.png"], force=True)


def test_a_result_of_a_long_command_is_known(tmp_path):
    """Names of a thousand files stand before all else that a result says."""
    result = made()
    command = ["merlfit", "fit", *(f"measured/material-{k}.binary" for k in range(1000))]
    write_result(tmp_path / "nickel.json", result.model_copy(update={"run": Run(finished="", command=command)}))
    assert is_ours(tmp_path / "nickel.json")


def test_a_manifest_of_somebody_else_is_left_alone_and_nothing_is_fitted(tmp_path):
    (tmp_path / "manifest.jsonl").write_text(text := '{"file": "nickel.binary", "seen": true}\n')
    shown = call("fit", tmp_path / "nickel.binary", "-o", tmp_path)
    assert shown.exit_code == BAD_INPUT
    assert f"{tmp_path / 'manifest.jsonl'}: is there already, and no manifest of merlfit: move it" in shown.stderr
    assert (tmp_path / "manifest.jsonl").read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.jsonl"]


def test_an_earlier_calibration_is_known(tmp_path):
    frontier = invented()
    keep(frontier, tmp_path)
    write_markdown(frontier, tmp_path / "cost.md")
    style.save(style.new(2), tmp_path / "cost.png")
    (tmp_path / "rows.json").write_text(json.dumps({"made of": {"versions": versions()}}))
    refuse_others(tmp_path / name for name in OUTPUTS)
    assert {path.name for path in tmp_path.iterdir()} == set(OUTPUTS)


def test_no_cell_of_a_spreadsheet_is_a_formula():
    """In a name, a path or a channel, which whoever made the file chose."""
    rows = [
        {"name": "=cmd|' /C calc'!A1", "@x": -1.5, "n": None, "t": "\ta"},
        {"name": "+1", "@x": 3, "n": True, "t": "-"},
    ]
    found = list(csv.reader(as_csv(["name", "@x", "n", "t"], rows).splitlines()))
    assert found == [
        ["name", "'@x", "n", "t"], ["'=cmd|' /C calc'!A1", "-1.5", "", "'\ta"], ["'+1", "3", "True", "'-"]
    ]  # fmt: skip


def test_results_of_alike_names_have_a_page_each():
    rows = [{"result": name, "status": "CONVERGED"} for name in ("a--b.json", "a/b.json", "a--b.2.json", "c.json")]
    assert _page_names(rows) == ["a--b", "a--b.2", "a--b.2.2", "c"]


def test_numbers_are_read_without_a_picture(tmp_path):
    put_result(tmp_path)
    shown = call("inspect", tmp_path / "nickel.json", "--pictures", "none")
    assert shown.exit_code == 0
    assert "grazing_exponent" in shown.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["nickel.json"]


def test_setting_a_value_of_a_fit_is_refused_and_a_copy_may_be_changed(tmp_path):
    put_result(tmp_path)
    fit = merlfit.load(tmp_path / "nickel.json")
    with pytest.raises(TypeError, match=r'change a copy of them: \{\*\*fit.parameters, "beta": 0.2\}'):
        fit.parameters["beta"] = 0.2
    changed = {**fit.parameters, "beta": 0.2}
    assert changed["beta"] == 0.2 != fit.parameters["beta"]
    json.dumps({name: np.asarray(x).tolist() for name, x in fit.parameters.items()})


def test_a_folder_of_work_that_is_not_of_cost_stays(tmp_path):
    (tmp_path / ".merlfit-cost").mkdir()
    (tmp_path / ".merlfit-cost" / "mine").touch()
    shown = call("cost", "-o", tmp_path)
    assert shown.exit_code != 0
    assert "is not of this command, or damaged" in shown.stderr
    assert (tmp_path / ".merlfit-cost" / "mine").exists()
