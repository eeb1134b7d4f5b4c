"""Fits whose parameters another program takes as they are: Mitsuba, glTF, OpenPBR, optical design programs."""

import ast
import base64
import importlib.util
import json
import os
import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.commands.blender_files import INPUTS
from merlfit.fitting.commands.materialx_files import to_openpbr
from merlfit.fitting.commands.nearest_ggx import Angles, openpbr, principled
from merlfit.fitting.commands.scatter_formulas import FORMULAS
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.support import outputs
from merlfit.model.reflectance import setting
from merlfit.model.registry import models
from merlfit.scene.images import read_map
from typer.testing import CliRunner

from tests.support.compiled import evaluate, from_vectors
from tests.support.made_results import made

RGB = np.array([0.7, 0.3, 0.05])
DISNEY = {
    "baseColor": RGB, "metallic": 1.0, "specular": 0.6, "specularTint": 0.0, "roughness": 0.45, "sheen": 0.0,
    "sheenTint": 0.0, "clearcoat": 0.4, "clearcoatGloss": 0.0, "subsurface": 0.0,
}  # fmt: skip
OPENPBR = {
    "base_color": RGB, "specular_color": np.ones(3), "coat_color": np.array([0.9, 0.5, 0.8]), "coat_weight": 0.0,
    "specular_roughness": 0.5, "specular_ior": 1.5, "base_metalness": 0.0, "base_diffuse_roughness": 0.0,
    "coat_roughness": 0.3, "coat_ior": 1.6,
}  # fmt: skip
SCATTER = {
    "abg": {"A": RGB, "B": 0.01, "g": 1.7}, "harvey-shack": {"b0": RGB, "L": 0.05, "s": 1.9},
    "k-correlation": {"sigma": 0.03 * RGB, "B": 6.0, "s": 2.3},
}  # fmt: skip


def call(*words):
    return CliRunner().invoke(cli.app, [str(word) for word in words], env={"COLUMNS": "400"})


def written(folder, name, values, to):
    """What is printed when a made fit of a model is exported."""
    result = made("paint", model=models()[name]())
    parameters = []
    for q in result.parameters:
        value = np.ravel(values.get(q.parameter, q.value))
        value = float(value["RGB".index(q.channel or "R") % len(value)])
        interval = q.laplace.model_copy(update={"q05": 0.9 * value, "q50": value, "q95": 1.1 * value})
        parameters.append(q.model_copy(update={"value": value, "laplace": interval}))
    parameters[1] = parameters[1].model_copy(update={"laplace": None})
    write_result(folder / "paint.json", result.model_copy(update={"parameters": parameters}))
    found = call("export", folder / "paint.json", "--to", to, "-o", folder)
    assert found.exit_code == 0, found.output
    return found.output


def pairs():
    rng = np.random.default_rng(0)
    theta, phi = np.arccos(rng.uniform(0.2, 1, (2, 30))), rng.uniform(0, 2 * np.pi, (2, 30))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def drawn_by(mi, bsdf, i, o):
    at = mi.SurfaceInteraction3f()
    at.wi, at.n, at.sh_frame = mi.Vector3f(*i), [0, 0, 1], mi.Frame3f([0, 0, 1])
    return np.array(bsdf.eval(mi.BSDFContext(), at, mi.Vector3f(*o))) / o[2]


def test_disneys_metal_in_mitsubas_principled_is_ours(tmp_path):
    """Without a coat; of a coat a quarter is written, which is as bright along the normal."""
    mi = pytest.importorskip("mitsuba", reason="needs merlfit[mitsuba]")
    mi.set_variant("scalar_rgb")

    def of(values):
        written(tmp_path, "disney", values, "principled")
        text = (tmp_path / "paint.principled.xml").read_text()
        bsdf = re.search("<bsdf.*</bsdf>", text)
        assert bsdf
        assert "roughness 0.45 (0.405 .. 0.495)" in text
        assert "not decided by the data" in text
        return (
            mi.load_string(f'<scene version="3.0.0"><shape type="sphere">{bsdf[0]}</shape></scene>').shapes()[0].bsdf()
        )

    i, o = pairs()
    bare = DISNEY | {"clearcoat": 0.0}
    bsdf = of(bare)
    theirs = np.transpose([drawn_by(mi, bsdf, a, b) for a, b in zip(i, o, strict=True)])
    np.testing.assert_allclose(theirs, evaluate(models()["disney"](), bare, from_vectors(i, o)), rtol=1e-4)
    up = np.array([[0.0, 0.0, 1.0]])
    ours = np.asarray(evaluate(models()["disney"](), DISNEY, from_vectors(up, up)))[:, 0]
    np.testing.assert_allclose(drawn_by(mi, of(DISNEY), up[0], up[0]), ours, rtol=1e-4)


def test_disneys_parameters_in_gltf_are_those_of_the_fit(tmp_path):
    said = written(tmp_path, "disney", DISNEY | {"clearcoat": 0.0, "roughness": 0.3}, "gltf")
    (material,) = json.loads((tmp_path / "paint.gltf").read_text())["materials"]
    surface, told = material["pbrMetallicRoughness"], material["extras"]["merlfit"]
    assert surface == {"baseColorFactor": [*RGB, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.3}
    assert told["intervals"]["roughness"] == pytest.approx([0.27, 0.33])
    assert told["intervals"]["specular"] is None
    assert told["error"]["cielab"] < 0.01, "a metal is the same in both"
    assert set(told["left_out"]) == {"specularTint", "sheen", "sheenTint", "clearcoat", "clearcoatGloss", "subsurface"}
    assert "the fitted parameters of Disney's model themselves" in " ".join(said.split())


def test_a_gltf_file_is_a_sphere_seen_from_outside(tmp_path):
    """As Khronos' validator, which needs Node.js, wants it: `tests/exported.py` asks that one."""
    written(tmp_path, "disney", DISNEY, "gltf")
    asset = json.loads((tmp_path / "paint.gltf").read_text())
    data = base64.b64decode(asset["buffers"][0]["uri"].split(",")[1])
    assert len(data) == asset["buffers"][0]["byteLength"]
    views = [data[v["byteOffset"] : v["byteOffset"] + v["byteLength"]] for v in asset["bufferViews"]]
    points, corners = np.frombuffer(views[0], "<f4").reshape(-1, 3), np.frombuffer(views[1], "<u2").reshape(-1, 3)
    assert [a["count"] for a in asset["accessors"]] == [len(points), len(points), corners.size]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, rtol=1e-6)
    a, b, c = np.moveaxis(points[corners].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    assert np.all(np.sum(normal * (a + b + c), 1) > 0)
    assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(4 * np.pi, rel=3e-3)


def test_names_in_materialx_have_its_letters(tmp_path):
    text = to_openpbr("café-1", {"base_metalness": 1.0}, "a fit", "one number", tmp_path).read_text()
    assert 'name="m_caf__1"' in text


def test_openpbrs_parameters_in_materialx_are_those_of_the_fit(tmp_path):
    """And its formula is, without a coat, that by which the nearest of other models is found."""
    written(tmp_path, "openpbr", OPENPBR, "openpbr")
    import MaterialX as mx

    document = mx.createDocument()
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    mx.readFromXmlFile(document, str(tmp_path / "paint.mtlx"))
    document.setDataLibrary(library)
    assert document.validate() == (True, "")
    (material,) = document.getMaterialNodes()
    (shader,) = mx.getShaderNodes(material)
    assert shader.getNodeDef().getName() == "ND_open_pbr_surface_surfaceshader"
    tree = ElementTree.parse(tmp_path / "paint.mtlx")
    surface = tree.getroot().find("open_pbr_surface")
    assert surface is not None
    inputs = {each.attrib["name"]: np.array(each.attrib["value"].split(", "), float) for each in surface}
    assert set(inputs) == {*OPENPBR, "base_weight", "specular_weight", "coat_darkening"}
    for name, value in OPENPBR.items():
        np.testing.assert_allclose(inputs[name], value, rtol=1e-6)

    i, o = pairs()
    for metal in (0.0, 1.0):
        geometry = from_vectors(i, o)
        found = evaluate(models()["openpbr"](), OPENPBR | {"base_metalness": metal}, geometry)
        at = setting(geometry).geometry
        angles = Angles(*map(np.asarray, (at.cos_i, at.cos_o, np.cos(at.theta_h), at.cos_d)))
        slope, rest = openpbr(angles, 0.5, None if metal else 1.5)
        np.testing.assert_allclose(found, RGB[:, None] * slope + rest, rtol=4e-3)


@pytest.mark.parametrize("coat", [0.0, 1.0])
def test_openpbrs_parameters_in_blender_are_those_of_the_fit(tmp_path, coat):
    """Without a coat; below one the base is darker and rougher, and its index that beside the coat's."""
    written(tmp_path, "openpbr", OPENPBR | {"coat_weight": coat}, "blender")
    outputs.refuse_others([tmp_path / "paint.blender.py"])
    tree = ast.parse((tmp_path / "paint.blender.py").read_text())
    (given,) = (
        ast.literal_eval(x.value) for x in tree.body if isinstance(x, ast.Assign) and x.targets[0].id == "INPUTS"
    )
    assert set(given) == set(INPUTS.values())
    if coat:
        assert np.all(np.array(given["Base Color"][:3]) < 0.8 * RGB)
        assert given["Roughness"] > OPENPBR["specular_roughness"]
        assert given["IOR"] == pytest.approx(1.6 / 1.5, rel=1e-5)
        return
    for name, value in OPENPBR.items():
        np.testing.assert_allclose(np.ravel(given[INPUTS[name]])[: np.size(value)], np.ravel(value), rtol=1e-5)


def test_blender_draws_a_metal_as_openpbrs_formula_has_it(tmp_path):
    """In a Python of its own that has `bpy`: this one, or the one that BLENDER_PYTHON names."""
    python = os.environ.get("BLENDER_PYTHON") or (sys.executable if importlib.util.find_spec("bpy") else None)
    if python is None:
        pytest.skip("needs Blender as a module: pip install bpy, or its Python in BLENDER_PYTHON")
    written(tmp_path, "openpbr", OPENPBR | {"base_metalness": 1.0, "specular_roughness": 0.4}, "blender")
    subprocess.run([python, "paint.blender.py", "sphere.exr"], cwd=tmp_path, check=True, capture_output=True)
    picture = read_map(tmp_path / "sphere.exr")
    # along the normal: the lamp at 48 degrees, and the room, of which a metal reflects nearly its colour
    towards = np.array([0.45, 0.55, 0.7]) / np.linalg.norm([0.45, 0.55, 0.7])
    i, o = towards[None], np.array([[0.0, 0.0, 1.0]])
    at = setting(from_vectors(i, o)).geometry
    slope, rest = openpbr(Angles(*map(np.asarray, (at.cos_i, at.cos_o, np.cos(at.theta_h), at.cos_d))), 0.4, None)
    lamp = 2 * towards[2] * (RGB * slope + rest)
    seen = picture[124:132, 124:132].mean((0, 1))
    np.testing.assert_allclose(seen, lamp + 0.3 * RGB, rtol=0.05)
    np.testing.assert_allclose(picture[:8, :8].mean((0, 1)), 0.3, rtol=1e-3)


@pytest.mark.parametrize("to", ["gltf", "openpbr", "blender", "principled"])
def test_parameters_of_another_model_are_not_taken_as_they_are(tmp_path, to, monkeypatch):
    from merlfit.fitting.commands import export

    asked = []
    found = {"base_color": [0.1] * 3, "metallic": 0.0, "roughness": 0.2, "ior": 1.5, "error": {"cielab": 1.0}}
    monkeypatch.setattr(export, "nearest_of", lambda path, result, to: asked.append(to) or found)
    said = written(tmp_path, "disney" if to in ("openpbr", "blender") else "openpbr", {}, to)
    assert asked == [to]
    assert "differ from the fit by a mean CIELAB distance of 1.00" in " ".join(said.split())


@pytest.mark.parametrize("ior", [None, 1.3, 2.2])
def test_what_is_nearest_in_mitsubas_principled_is_found_by_its_own_formula(ior):
    mi = pytest.importorskip("mitsuba", reason="needs merlfit[mitsuba]")
    mi.set_variant("scalar_rgb")
    found = {"base_color": RGB.tolist(), "metallic": float(ior is None), "roughness": 0.35, "eta": ior or 1.5}
    given = {key: {"type": "rgb", "value": x} if key == "base_color" else x for key, x in found.items()}
    bsdf = mi.load_dict({"type": "principled", **given})
    i, o = pairs()
    theirs = np.transpose([drawn_by(mi, bsdf, a, b) for a, b in zip(i, o, strict=True)])
    at = setting(from_vectors(i, o)).geometry
    slope, rest = principled(Angles(*map(np.asarray, (at.cos_i, at.cos_o, np.cos(at.theta_h), at.cos_d))), 0.35, ior)
    np.testing.assert_allclose(theirs, RGB[:, None] * slope + rest, rtol=1e-4)


@pytest.mark.parametrize("name", SCATTER)
def test_scatter_of_a_fit_by_its_own_formula_is_the_fit(tmp_path, name):
    to = "abg" if name == "abg" else "k-correlation"
    written(tmp_path, name, SCATTER[name], to)
    told = json.loads((tmp_path / f"paint.{to}.json").read_text())
    own = [row for row in told["rows"] if FORMULAS[to][row["model"]].model == name]
    assert len(own) == 9
    assert {row["model"] for row in told["rows"] if row["fitted"]} == {row["model"] for row in own}
    names = {"b0": "b0", "sigma_um": "sigma", "B_um": "B", "L": "L", "s": "s", "A": "A", "B": "B", "g": "g"}
    for row in own:
        assert row["error"]["log_rms"] < 1e-9
        assert row["tis"] == pytest.approx(row["tis_of_fit"], rel=0.02)
        for key, value in row["parameters"].items():
            expected = -1.9 if key == "S" else np.ravel(SCATTER[name][names[key]])
            expected = expected if key == "S" else expected["RGB".index(row["channel"]) % len(expected)]
            assert value == pytest.approx(expected, rel=1e-9)
