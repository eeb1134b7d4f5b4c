"""The BSDF inside Mitsuba: its own chi-square test, its values, and a sphere beside ours."""

import os
import sys
from contextlib import suppress

import numpy as np
import pytest
from merlfit.model.registry import models
from merlfit.model.sampling import visible as ours
from merlfit.scene.colour import REFLECTANCE_NM, reflectances
from merlfit.scene.description import Scene
from merlfit.scene.render import Film, pictures, stage
from merlfit.scene.surface import drawn, surface
from merlfit.scene.tables import write_tables

plugin = pytest.importorskip("merlfit.scene.mitsuba", reason="needs merlfit[mitsuba]", exc_type=ImportError)
mi, dr = plugin.mi, plugin.dr
GGX = {"alpha": 0.25, "F0": np.array([0.9, 0.6, 0.3]), "albedo": np.array([0.1, 0.2, 0.3])}
VARIANTS = ("scalar_rgb", "llvm_ad_rgb")


@pytest.fixture(scope="module")
def made():
    return surface(models()["ggx"](), GGX)


@pytest.fixture(scope="module")
def file(made, tmp_path_factory):
    path = tmp_path_factory.mktemp("tables") / "ggx.npz"
    write_tables(path, made)
    return path


@pytest.fixture(params=VARIANTS)
def variant(request):
    if request.param.startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("needs LLVM: Debian's libllvm19")
    mi.set_variant(request.param)
    plugin.register()
    return request.param


def test_constants_are_those_of_the_sampler():
    for name in ("CELLS", "LINEAR", "STEEPEST", "GRAZING", "INCIDENCES", "NEWTON", "LONGEST"):
        assert getattr(plugin, name) == getattr(ours, name), name


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["none.xml", "--variant", "scalar_rgb"], "none.xml: cannot be read as a scene"),
        (
            ["none.xml", "--variant", "scalar_rbg"],
            "variant 'scalar_rbg' is none of Mitsuba's; scenes are rendered by scalar_rgb",
        ),
    ],
)
def test_what_cannot_be_rendered_is_named(asked, said, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["mitsuba", *asked])
    with pytest.raises(SystemExit) as ended:
        plugin.main()
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "error: " in last
    assert said in last


SMALL = """<scene version="3.0.0"><integrator type="path"/><emitter type="constant"/><sensor type="perspective">
<film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film></sensor></scene>"""


@pytest.mark.parametrize("words", [
    ["a\33[2Jb.xml"], ["a.xml", "\33]52;c;aaaa\7"], ["a.xml", "--variant", "\33[31m"],
    ["there.xml", "--variant", "scalar_rgb", "-o", "no\33[2J/a.exr"],
    ["there.xml", "--variant", "scalar_rgb", "-o", "a\33[2J\u202eb.exr"],
    ["there.xml", "--variant", "scalar_rgb", "-o", "a.\33[2J"],
])  # fmt: skip
def test_no_name_steers_the_terminal_and_what_cannot_be_written_is_named(words, tmp_path, monkeypatch, capfd):
    (tmp_path / "there.xml").write_text(SMALL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["mitsuba", *words, "--samples", "1"])
    with suppress(SystemExit):
        plugin.main()
    told = capfd.readouterr()
    assert not any(x in told.out + told.err for x in "\33\7\u202e")
    last = (told.out or told.err).splitlines()[-1]
    assert "error: " in last or last.startswith("wrote a\N{SYMBOL FOR ESCAPE}[2J")


def test_values_are_those_of_the_model(variant, file):
    from tests.support.compiled import evaluate, from_vectors

    bsdf = mi.load_dict({"type": "merlfit", "filename": str(file)})
    rng = np.random.default_rng(0)
    worst = []
    for _ in range(40):
        pair = rng.normal(size=(2, 3))
        pair[:, 2] = np.abs(pair[:, 2]) + 0.2
        i, o = pair / np.linalg.norm(pair, axis=1, keepdims=True)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f([float(x) for x in i])
        found = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f([float(x) for x in o]))).ravel() / o[2]
        expected = np.asarray(evaluate(models()["ggx"](), GGX, from_vectors(i, o)))
        worst.append(np.max(np.abs(found - expected) / expected))
    assert np.median(worst) < 2e-3
    assert max(worst) < 3e-2


def test_tables_are_found_beside_their_scene(file, tmp_path, monkeypatch):
    mi.set_variant("scalar_rgb")
    plugin.register()
    (tmp_path / "moved.npz").write_bytes(file.read_bytes())
    bsdf = '<bsdf type="merlfit"><string name="filename" value="moved.npz"/></bsdf>'
    (tmp_path / "a.xml").write_text(f'<scene version="3.0.0"><shape type="sphere">{bsdf}</shape></scene>')
    monkeypatch.chdir("/")
    assert str(tmp_path / "moved.npz") in str(mi.load_file(str(tmp_path / "a.xml")))


@pytest.mark.parametrize(
    ("variant", "words"),
    [("scalar_spectral_polarized", "has one channel, or polarised light"), ("metal", "is none of Mitsuba's")],
)
def test_a_variant_that_renders_nothing_is_one_line_that_names_those_that_do(variant, words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["mitsuba", "a.xml", "--variant", variant])
    with pytest.raises(SystemExit):
        plugin.main()
    said = capsys.readouterr().err.splitlines()[-1]
    assert words in said
    assert "scalar_rgb" in said


def test_without_llvm_the_default_variant_is_refused_in_one_line(monkeypatch, capsys):
    """Of another version than 19 it would end the program with sixty lines."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(sys, "argv", ["mitsuba", "a.xml"])
    with pytest.raises(SystemExit):
        plugin.main()
    assert "libllvm19 is not here" in capsys.readouterr().err.splitlines()[-1]


def test_the_scalar_variant_says_how_far_it_is(capsys):
    mi.set_variant("scalar_rgb")
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path"}, "sensor": {"type": "perspective", "film": film},
        "light": {"type": "constant", "radiance": 0.3},
    })  # fmt: skip
    np.testing.assert_allclose(np.array(plugin.rendered(scene, 10))[..., :3], 0.3, rtol=1e-6)
    said = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in said] == ["4 of 10 samples", "8 of 10 samples", "10 of 10 samples"]


@pytest.mark.parametrize("variant", ["scalar_spectral", "llvm_ad_spectral"])
def test_spectral_variants_draw_spectra_of_these_colours(variant, file):
    """At a node of the spectra of red, green and blue, and between two of them."""
    if variant.startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("needs LLVM: Debian's libllvm19")
    from tests.support.compiled import evaluate, from_vectors

    mi.set_variant(variant)
    plugin.register()
    bsdf = mi.load_dict({"type": "merlfit", "filename": str(file)})
    i, o = np.array([[0.3, 0.1, 0.9], [-0.2, 0.0, 0.9]]) / [[np.sqrt(0.91)], [np.sqrt(0.85)]]
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi, nm = mi.Vector3f([float(x) for x in i]), np.array([460.0, 550.0, 600.0, 700.0])
    si.wavelengths = [float(x) for x in nm]
    found = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f([float(x) for x in o]))).ravel() / o[2]
    colour = np.asarray(evaluate(models()["ggx"](), GGX, from_vectors(i, o))).ravel()
    expected = colour @ np.stack([np.interp(nm, REFLECTANCE_NM, each) for each in reflectances()])
    np.testing.assert_allclose(found, expected, rtol=1e-2)


@pytest.mark.parametrize("angle", [5, 50, 80])
def test_mitsubas_own_chi_square(file, angle):
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("needs LLVM: Debian's libllvm19")
    mi.set_variant("llvm_ad_rgb")
    plugin.register()
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    wi = [float(np.sin(np.radians(angle))), 0.0, float(np.cos(np.radians(angle)))]
    draw, density = BSDFAdapter("merlfit", f'<string name="filename" value="{file}"/>', wi=wi)
    test = ChiSquareTest(
        domain=SphericalDomain(), sample_func=draw, pdf_func=density, sample_dim=3, sample_count=400_000, ires=16
    )
    assert test.run(), test.messages
    assert sys.modules["mitsuba"] is mi


def test_a_sphere_is_that_of_our_renderer(variant, file, made):
    size, spp = 12, 1024
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path"},
        "sensor": {
            "type": "perspective", "fov": 22, "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 6], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter", "sample_count": spp},
        },
        "light": {"type": "constant", "radiance": 0.3},
        "lamp": {"type": "directional", "direction": [-0.45, -0.55, -0.7], "irradiance": 2.0},
        "sphere": {"type": "sphere", "bsdf": {"type": "merlfit", "filename": str(file)}},
    })  # fmt: skip
    theirs = np.array(mi.render(scene, spp=spp, seed=1))[..., :3]
    description = Scene.model_validate({
        "camera": {"position": (0, 0, 6), "field_of_view_deg": 22, "width": size, "height": size},
        "environment": {"kind": "constant", "strength": 0.3},
        "lamp": [{"towards": (0.45, 0.55, 0.7), "irradiance": 2.0, "radius_deg": 0}],
        "sphere": [{"material": "a"}], "materials": {"a": {"model": "ggx"}}, "samples": spp,
    })  # fmt: skip
    (found,) = pictures(Film(description, stage(description)), [drawn(made)])
    inside = np.s_[3:9, 3:9]  # the whole disc of the sphere but its rim, where a pixel is partly background
    off = np.abs(found[inside] / theirs[inside] - 1)  # both by chance; most where a pixel has half of the highlight
    assert np.quantile(off, 0.9) < 0.03
    assert off.max() < 0.15
    np.testing.assert_allclose(found[inside].mean(), theirs[inside].mean(), rtol=5e-3)
