"""Commands of scenes: what they write, say and refuse."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.commands import export as exports
from merlfit.fitting.commands import nearest_ggx as formats
from merlfit.fitting.commands import rgl_files, scenes
from merlfit.fitting.commands import sphere_sheets as spheres
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.fitting.results.schema import UNSAID
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.show.labelled import MARGIN, labelled
from merlfit.fitting.show.style import save
from merlfit.fitting.support import outputs
from merlfit.merl_io import rgl_writer
from merlfit.merl_io.bands import Bands
from merlfit.merl_io.binary import DIMS, read, write
from merlfit.merl_io.tensor import tensors
from merlfit.model.reflectance import evaluate
from merlfit.model.registry import models
from merlfit.scene import effects
from merlfit.scene.colour import displayed
from merlfit.scene.images import read_map
from PIL import Image

from tests.support.command import call
from tests.support.made_results import made

ROOT = Path(__file__).parents[2]
SMALL = """
samples = 4
[camera]
position = [0, 0, 6]
field_of_view_deg = 22
width = 16
height = 16
[[lamp]]
towards = [0.4, 0.5, 0.8]
[[sphere]]
material = "a"
[materials.a]
"""
GGX = 'model = "ggx"\nparameters = { alpha = 0.3, F0 = 0.5, albedo = [0.1, 0.2, 0.3] }\n'


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(effects, "PIXELS", 128)
    studio = spheres.STUDIO
    camera = studio.camera.model_copy(update={"width": 12, "height": 12})
    monkeypatch.setattr(spheres, "STUDIO", studio.model_copy(update={"camera": camera, "samples": 4}))


def scene(folder, material):
    path = folder / "scene.toml"
    path.write_text(SMALL + material)
    return path


@pytest.fixture
def result(tmp_path):
    path = tmp_path / "nickel.json"
    write_result(path, made())
    return path


def test_a_scene_is_planned_rendered_and_compared(tmp_path):
    found = call("render", scene(tmp_path, GGX), "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    report = json.loads((tmp_path / "out" / "render.json").read_text())
    assert report["within"] is True
    assert set(report["seconds"]) == {"plan", "all effects"}
    assert report["difference"]["99.9 % of pixels"] <= 1.0
    picture = read_map(tmp_path / "out" / "picture.exr")
    assert picture.shape == (16, 16, 3)
    assert np.asarray(Image.open(tmp_path / "out" / "picture.png")).max() > 100
    for name in ("all_effects.exr", "all_effects.png", "difference.exr", "difference.png"):
        assert (tmp_path / "out" / name).is_file()
    outputs.refuse_others(tmp_path / "out" / name for name in scenes.OUTPUTS)
    again = call("render", scene(tmp_path, GGX), "-o", tmp_path / "again", "--no-check")
    assert again.exit_code == 0
    np.testing.assert_array_equal(read_map(tmp_path / "again" / "picture.exr"), picture)
    assert not (tmp_path / "again" / "all_effects.exr").exists()


def test_effects_of_a_result_in_a_scene(tmp_path, result):
    found = call("effects", scene(tmp_path, f'result = "{result.name}"\nparameters = {{ sigma_s = 1e-6 }}\n'))
    assert found.exit_code == 0, found.output
    rows = [line for line in found.output.splitlines() if line.startswith("  diffraction ")]
    assert len(rows) == 1
    assert "dropped" in rows[0]


def test_a_result_is_a_sphere_and_a_grid_of_them(tmp_path, result):
    found = call("render", result, "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    assert np.asarray(Image.open(tmp_path / "out" / "nickel.png")).shape == (12, 12, 3)
    assert "the fit alone" in found.output
    found = call("render", result, "--vary", "sigma_s=0.5,1,2", "--vary", "b=0.5,2", "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    grid = np.asarray(Image.open(tmp_path / "out" / "nickel.sigma_s-b.png"))[-24:, -36:, :3]
    assert not np.array_equal(grid[:12, :12], grid[:12, 12:24])


def test_words_beside_pictures_change_none_of_their_pixels(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (2 * 37, 3 * 41, 3), np.uint8)
    save(labelled(pixels, "abc", "de", "across", "down"), tmp_path / "grid.png")
    saved = np.asarray(Image.open(tmp_path / "grid.png"))
    np.testing.assert_array_equal(saved[MARGIN:, MARGIN:, :3], pixels)
    assert np.unique(saved[:MARGIN]).size > 2


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ('model = "ggx"\nparameters = { alpha = 0.3, F0 = 0.5 }\n', "needs albedo"),
        (GGX.replace("alpha", "alfa"), "no parameter alfa"),
        (GGX.replace("0.3, F0", "-0.3, F0"), "alpha should be"),
        (GGX.replace("F0 = 0.5", "F0 = 7.0"), "F0 should be"),
        ('model = "two-scale"\nsettings = { body = "any" }\n', "body should be"),
        (GGX.replace('"ggx"', '"gggx"'), "nearest is 'ggx'"),
        ('measured = "none.binary"\n', "none.binary: no such file"),
        ('result = "none.json"\n', "none.json: no such file"),
    ],
)
def test_materials_that_cannot_be_used(tmp_path, material, said):
    found = call("effects", scene(tmp_path, material))
    assert found.exit_code == 2
    assert said in found.output
    assert "Traceback" not in found.output


@pytest.mark.parametrize(
    ("vary", "said"),
    [
        ("sigma_s", "--vary"),
        ("sigma_s=a", "--vary"),
        ("sigma_s=-1,2", "--vary"),
        ("sigma=1,2", "no parameter sigma; it has beta"),
        ("grazing_exponent=1,2", "without the apparatus; it has beta"),
    ],
)
def test_what_cannot_be_varied(tmp_path, result, vary, said):
    found = call("render", result, "--vary", vary, "-o", tmp_path)
    assert found.exit_code == 2
    assert said in " ".join(found.output.split())


def test_what_is_outside_the_bounds_of_fits_is_said(tmp_path, result):
    found = call("render", result, "--vary", "beta=1,1e4", "-o", tmp_path)
    assert found.exit_code == 0
    assert "beta: \u00d7 10000 makes it" in found.output
    assert "outside the bounds of fits (0.001 to 1)" in " ".join(found.output.split())


def test_a_long_title_is_on_several_lines(tmp_path):
    pixels = np.zeros((50, 300, 3), np.uint8)
    save(labelled(pixels, ["a"], across="many words " * 12), tmp_path / "grid.png")
    saved = np.asarray(Image.open(tmp_path / "grid.png"))
    assert saved.shape[1] == 300
    assert saved.shape[0] > 50 + MARGIN
    assert np.all(saved[:, :3, :3][:-50] == 255)  # nothing is cut at the edge


def test_an_exported_merl_file_takes_the_place_of_none(tmp_path, result, monkeypatch):
    monkeypatch.setattr("merlfit.fitting.commands.export.from_result", lambda *_: (np.ones((3, *DIMS)), ""))
    mine = tmp_path / "mine" / "nickel.binary"
    mine.parent.mkdir()
    mine.write_bytes(b"measured")
    found = call("export", result, "--to", "merl", "-o", mine.parent)
    assert found.exit_code == 2
    assert "may be a measurement; --force overwrites it" in " ".join(found.output.split())
    assert mine.read_bytes() == b"measured"
    assert call("export", result, "--to", "merl", "-o", mine.parent, "--force").exit_code == 0
    assert mine.stat().st_size > 10**6


@pytest.mark.parametrize("name", ["matte", "metal", "paint"])
def test_the_scenes_that_are_shipped_can_be_read(name):
    film, given = scenes.staged(ROOT / "configs" / "scenes" / f"{name}.toml")
    assert {each.name for each in given} == set(film.scene.materials)


@pytest.fixture
def small_tables(monkeypatch):
    """Of RGL's kind."""
    monkeypatch.setattr(rgl_writer, "NODES", 24)
    monkeypatch.setattr(rgl_writer, "THETA_I", np.radians([0, 20, 40, 60, 75, 85, 90]))


def tensor(path, name, dimensions):
    return tensors(path, path.read_bytes()).array(name, "float32", dimensions)


@pytest.mark.parametrize("to", ["mitsuba", "json", "merl", "rgl"])
def test_exports(tmp_path, result, to, small_tables):
    found = call("export", result, "--to", to, "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    out = tmp_path / "out"
    outputs.refuse_others(out / f"nickel.{ending}" for ending in exports.ENDINGS.get(to, ()))
    if to == "mitsuba":
        scene_file = (out / "nickel.xml").read_text()
        assert 'value="nickel.mitsuba.npz"' in scene_file  # beside it, wherever both are moved
        assert UNSAID in scene_file
        with np.load(out / "nickel.mitsuba.npz") as arrays:
            assert np.all(np.isfinite(arrays["brdf"]))
    elif to == "rgl":
        outputs.refuse_others(rgl_files.targets_of("nickel", out))
        assert "differ by a mean CIELAB distance of 0." in found.output
        assert len(tensor(out / "nickel_spec.bsdf", "wavelengths", 1)) == 21
        assert '"nickel_spec.bsdf"' in (out / "nickel.rgl.pbrt").read_text()
        assert 'value="nickel_rgb.bsdf"' in (out / "nickel.rgl.xml").read_text()
    elif to == "json":
        written = json.loads((out / "nickel.material.json").read_text())
        assert written["model"] == "two-scale"
        assert (written["data"], written["source_sha1"]) == (UNSAID, "0" * 40)
        assert {"beta", "n_R"} <= written["parameters"].keys()
        assert not any(name.startswith("grazing") for name in written["parameters"])
    else:
        assert read(out / "nickel.binary").valid.any()


def spectral(*names):
    """GGX facets of copper at 450, 532 and 633 nm, channels in the order of the names."""
    bands = Bands(names, tuple(float(name[:-2]) / 1000 for name in names))
    result = made(model=models()["ggx"]())
    at = {"450nm": 0.55, "532nm": 0.6, "633nm": 0.93}
    by = dict(zip("RGB", names, strict=True))
    for q in result.parameters:
        q.channel = by.get(q.channel)
        q.name = f"{q.parameter}_{q.channel}" if q.channel else q.parameter
        q.value = {"alpha": 0.2, "albedo": 1e-4}.get(q.parameter, at.get(q.channel))
    model = result.model.model_copy(update={"channels": list(names), "wavelengths_um": list(bands.wavelengths_um)})
    return result.model_copy(update={"model": model})


COPPER = np.array([0.953, 0.645, 0.538])  # of reflectance 0.55, 0.6 and 0.93


RISING, MIXED = ("450nm", "532nm", "633nm"), ("633nm", "450nm", "532nm")


@pytest.mark.parametrize(
    ("to", "names"),
    [("mitsuba", RISING), ("merl", MIXED), ("gltf", RISING), ("json", MIXED), ("render", RISING), ("rgl", MIXED)],
)
def test_wavelengths_have_the_colour_that_is_seen_whatever_their_order(tmp_path, names, to, small_tables):
    """Copper is red in everything that makes a colour of it."""
    path = tmp_path / "copper.json"
    write_result(path, spectral(*names))
    words = ("render", path) if to == "render" else ("export", path, "--to", to)
    found = call(*words, "-o", tmp_path)
    assert found.exit_code == 0, found.output
    if to == "json":
        assert json.loads((tmp_path / "copper.material.json").read_text())["channels"] == list(names)
        return
    if to == "mitsuba":
        with np.load(tmp_path / "copper.mitsuba.npz") as arrays:
            colour = np.exp(arrays["brdf"][100, 5, 0, :3])
        assert "CIE 1931 observer" in (tmp_path / "copper.xml").read_text()
    elif to == "rgl":
        colour = tensor(tmp_path / "copper_rgb.bsdf", "rgb", 5)[0, 0, :, 12, 2]
        assert list(tensor(tmp_path / "copper_spec.bsdf", "wavelengths", 1)) == [450, 532, 633]
        seen = tensor(tmp_path / "copper_spec.bsdf", "spectra", 5)[0, 0, :, 12, 2]
        np.testing.assert_allclose(seen / seen[2], np.array([0.55, 0.6, 0.93]) / 0.93, rtol=0.02)
    elif to == "merl":
        colour = read(tmp_path / "copper.binary").values[:, 20, 5, 0]
    elif to == "gltf":
        (material,) = json.loads((tmp_path / "copper.gltf").read_text())["materials"]
        colour = np.array(material["pbrMetallicRoughness"]["baseColorFactor"][:3])
    else:
        colour = np.asarray(Image.open(tmp_path / "copper.png"))[4:8, 4:8, :3].astype(float).mean((0, 1))
        assert colour[0] > 1.1 * colour[1] > 1.1 * colour[2]
        return
    np.testing.assert_allclose(colour / colour[0], COPPER / COPPER[0], rtol=0.02)


def ggx(**given):
    return tabulate(lambda g: evaluate(models()["ggx"](), given, g))


GOLD = {"alpha": 0.2, "F0": np.array([0.9, 0.7, 0.4]), "albedo": np.full(3, 1e-4)}


@pytest.mark.parametrize("to", ["gltf", "openpbr"])
def test_a_fit_is_exported_as_the_nearest_material_of_a_format(tmp_path, result, to, monkeypatch):
    """A metal of GGX facets is itself; of a fit with a conductor's index a metal is made whatever is nearer."""
    asked = []

    def nearest(values, to, metal):
        asked.append(metal)
        return formats.nearest(values, to, metal=True)

    monkeypatch.setattr(exports, "nearest", nearest)
    monkeypatch.setattr(exports, "from_result", lambda *_: (ggx(**GOLD), "GGX"))
    found = call("export", result, "--to", to, "-o", tmp_path)
    assert found.exit_code == 0, found.output
    outputs.refuse_others(tmp_path / f"nickel.{ending}" for ending in exports.ENDINGS[to])
    assert asked == [True]  # the result is two-scale, complex over none
    if to == "openpbr":
        text = (tmp_path / "nickel.mtlx").read_text()
        assert 'name="base_metalness" type="float" value="1"' in text
        assert "drawn by the formulas of OpenPBR differ from the fit by a mean CIELAB distance of 0.0" in text
        return
    (material,) = json.loads((tmp_path / "nickel.gltf").read_text())["materials"]
    surface = material["pbrMetallicRoughness"]
    assert surface["metallicFactor"] == 1
    np.testing.assert_allclose(surface["baseColorFactor"], [*GOLD["F0"], 1], rtol=5e-3)
    assert surface["roughnessFactor"] == pytest.approx(np.sqrt(0.2), rel=5e-3)
    assert material["extras"]["merlfit"]["error"]["cielab"] < 0.1


def test_a_measured_file_is_exported_to_mitsuba(tmp_path):
    write(tmp_path / "gold.binary", ggx(**GOLD))
    found = call("export", tmp_path / "gold.binary", "--to", "mitsuba", "-o", tmp_path / "measured")
    assert found.exit_code == 0, found.output


@pytest.mark.parametrize(("words", "said"), [(("--to", "blend"), "none of mitsuba"), (("--to", "json"), "fit it for")])
def test_what_cannot_be_exported(tmp_path, words, said):
    found = call("export", tmp_path / "x.binary", *words)
    assert found.exit_code == 2
    assert said in found.output


def test_a_fit_beside_its_file(tmp_path, monkeypatch):
    """Measured and fitted are alike where the file is of the fit itself, and the distance between them is black."""
    from merlfit.fitting.pipeline.synthesis import tabulate
    from merlfit.merl_io.binary import read, write
    from merlfit.model.reflectance import evaluate

    whole = made()
    model, values = whole.model.measured, whole.values()
    write(tmp_path / "nickel.binary", tabulate(lambda g: evaluate(model, values, g, whole.model.wavelengths_um)))
    sha1 = read(tmp_path / "nickel.binary").sha1
    write_result(tmp_path / "nickel.json", made(path=str(tmp_path / "nickel.binary"), sha1=sha1))
    found = call("render", tmp_path / "nickel.json", "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    picture = np.asarray(Image.open(tmp_path / "out" / "nickel.png"))[-12:, :, :3]
    assert picture.shape == (12, 36, 3)
    inside = np.s_[3:9, 3:9]
    measured, fitted, away = (picture[:, k : k + 12][inside].astype(int) for k in (0, 12, 24))
    assert measured.max() > 40
    assert np.abs(measured - fitted).mean() < 4
    assert away.mean() < 40


def test_a_picture_that_misses_the_tolerance_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(effects, "allowed", lambda tolerance: 1e9)  # a plan that drops everything
    found = call("render", scene(tmp_path, GGX), "-o", tmp_path / "out")
    assert found.exit_code == 1
    assert "--all-effects" in found.output
    found = call("render", scene(tmp_path, GGX), "-o", tmp_path / "out", "--all-effects", "--seed", "3")
    assert found.exit_code == 0, found.output


@pytest.mark.parametrize("words", [("--seed", 2**70), ("--samples", 10**9)])
def test_numbers_out_of_range(tmp_path, words):
    found = call("render", scene(tmp_path, GGX), "-o", tmp_path / "out", *words)
    assert found.exit_code == 2
    assert words[0] in found.output


def test_a_camera_that_sees_nothing(tmp_path):
    path = scene(tmp_path, GGX)
    path.write_text(path.read_text().replace("position = [0, 0, 6]", "position = [0, 0, 6]\nlook_at = [0, 0, 12]"))
    found = call("effects", path)
    assert found.exit_code == 2
    assert "no pixel sees a" in found.output


def test_a_result_is_drawn_under_a_map_and_its_noise_is_said(tmp_path, result):
    np.save(tmp_path / "map.npy", np.ones((4, 8, 3)))
    words = "render", result, "--set", "beta=0.3", "--environment", tmp_path / "map.npy", "--size", 16
    found = call(*words, "--exposure", 1, "-o", tmp_path / "out")
    assert found.exit_code == 0, found.output
    assert re.search(r"; noise 0\.\d+ \(CIELAB, mean over the sphere\) by 256 samples a pixel\n", found.output)
    radiance = read_map(tmp_path / "out" / "nickel.edited.exr")
    shown = np.asarray(Image.open(tmp_path / "out" / "nickel.edited.png"))
    assert radiance.shape == shown.shape == (16, 16, 3)
    np.testing.assert_allclose(shown, displayed(2 * radiance), atol=1)  # one stop
    found = call("render", result, "--environment", tmp_path / "none.exr", "-o", tmp_path)
    assert found.exit_code == 2
    assert "none.exr: no such file" in found.output
