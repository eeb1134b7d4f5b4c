"""Files of optical design programs: formulas as they are printed, their errors, and Zemax' table read back."""

import json

import jax
import numpy as np
import pytest
from merlfit.fitting.commands.scatter_formulas import FORMULAS, around, errors, nearest, tis_of
from merlfit.fitting.results.storage import write_result
from merlfit.merl_io import inputs, zemax
from merlfit.model.geometry import Geometry
from merlfit.model.reflectance import evaluate
from merlfit.model.registry import models
from scipy.interpolate import RegularGridInterpolator

from tests.support.command import call
from tests.support.compiled import directional_albedo
from tests.support.made_results import made

GGX = models()["ggx"]()
VALUES = {"alpha": 0.3, "F0": np.array([0.05, 0.5, 0.2]), "albedo": np.array([0.2, 0.1, 0.05])}
EACH = [(to, name) for to, named in FORMULAS.items() for name in named]


def printed(name, p, x, cosines, um):
    """A formula as it stands in the programs' manuals."""
    if name == "ABg":
        return p["A"] / (p["B"] + x ** p["g"])
    if name == "Harvey-Shack":
        return p["b0"] * (1 + (x / p["L"]) ** 2) ** (p["S"] / 2)
    s, B, roughness = p["s"], p["B_um"], p["sigma_um"]
    psd = roughness**2 * (s - 2) * B**2 / (2 * np.pi * (1 - (1 + (B / um) ** 2) ** (1 - s / 2)))
    return 4 * np.pi**2 * 2**2 / um**4 * cosines * psd * (1 + (B * x / um) ** 2) ** (-s / 2)


@pytest.mark.parametrize(("to", "name"), EACH)
def test_parameters_are_those_of_the_printed_formula_and_are_found_again(to, name):
    formula, um, theta_i = FORMULAS[to][name], 0.65, np.radians(40.0)
    q, at = np.array([-3.0, np.log(0.02), np.log(1.6)]), around(theta_i)
    cosines = np.cos(theta_i) * at.o[:, 2]
    values = np.exp(formula.log(q, at.x, cosines, um))
    told = formula.told(q, um)
    np.testing.assert_allclose(values, printed(name, told, at.x, cosines, um), rtol=1e-9)
    first = next(iter(told))
    assert not np.allclose(values, printed(name, {**told, first: 1.1 * told[first]}, at.x, cosines, um), rtol=0.05)
    np.testing.assert_allclose(nearest(formula, values, at, np.cos(theta_i), um), q, atol=1e-4)
    off = errors(1.2 * values, values, at.share)
    assert off["log_rms"] == pytest.approx(np.log(1.2))
    assert off["smape"] == pytest.approx(0.2 / 2.2)


def test_viewers_are_about_the_mirror_direction():
    """x is the distance of projections, zero at the mirror direction; all values of it count alike."""
    theta_i = np.radians(60.0)
    at = around(theta_i)
    np.testing.assert_allclose(np.linalg.norm(at.o, axis=1), 1)
    mirror = np.array([-np.sin(theta_i), 0.0])
    np.testing.assert_allclose(np.linalg.norm(at.o[:, :2] - mirror, axis=1), at.x, rtol=1e-9)
    shares = [at.share[at.x == x].sum() for x in np.unique(at.x)]
    np.testing.assert_allclose(shares, 1)


def test_the_integral_of_a_formula_is_that_over_the_hemisphere():
    formula = FORMULAS["abg"]["ABg"]
    A, B = 0.01, 0.003  # with g = 2 along the normal: pi A ln(1 + 1/B)
    q = np.log([A, B, 2.0])
    assert tis_of(formula, q, 0.0, 0.65) == pytest.approx(np.pi * A * np.log(1 + 1 / B), rel=1e-3)
    theta_i, n = np.radians(60.0), 1500
    theta, phi = (np.arange(n) + 0.5) / n * np.pi / 2, (np.arange(n) + 0.5) / n * 2 * np.pi
    x = np.hypot(np.sin(theta)[:, None] * np.cos(phi) + np.sin(theta_i), np.sin(theta)[:, None] * np.sin(phi))
    light = A / (B + x**2) * (np.sin(theta) * np.cos(theta))[:, None]
    assert tis_of(formula, q, theta_i, 0.65) == pytest.approx(light.sum() * np.pi**2 / n**2, rel=5e-3)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A result of GGX, and what is written of it."""
    folder = tmp_path_factory.mktemp("exported")
    result = made("paint", model=GGX)
    parameters = [
        q.model_copy(update={"value": float(np.ravel(VALUES[q.parameter])["RGB".index(q.channel or "R")])})
        for q in result.parameters
    ]
    write_result(folder / "paint.json", result.model_copy(update={"parameters": parameters}))
    shown = {to: call("export", folder / "paint.json", "--to", to, "-o", folder) for to in ("zemax", *FORMULAS)}
    assert all(each.exit_code == 0 for each in shown.values()), [each.output for each in shown.values()]
    return folder, {to: each.stdout for to, each in shown.items()}


def test_a_table_for_zemax_is_as_near_as_it_says(exported):
    """Linear interpolation between its nodes, at directions of its own choosing, against the model itself."""
    folder, shown = exported
    rng = np.random.default_rng(0)
    for channel, um in zip("RGB", (645, 526, 444), strict=True):
        path = folder / f"paint.{channel}.zemax.bsdf"
        scatter = zemax._scatter(path, zemax.lines_of(path, path.read_bytes(), "file"))
        found = inputs.read(path)
        assert found.bands.wavelengths_um == (um / 1e3,)
        axes = [scatter.angles[name] for name in zemax.COUNTED[1:]]
        table = RegularGridInterpolator(axes, np.array(scatter.blocks["Monochrome"]))
        theta_i = 37.3
        azimuth, radial = rng.uniform(0, 180, 20_000), rng.uniform(0, 120, 20_000)
        at = np.stack(np.broadcast_arrays(theta_i, azimuth, radial), -1)
        own, up = truth(theta_i, azimuth, radial)
        cosine = np.maximum(up, 0) * np.sin(np.radians(radial))
        k = "RGB".index(channel)
        off = np.sum(np.abs(table(at) - own[k]) * cosine) / np.sum(own[k] * cosine)
        assert off < 0.01
        stated = np.array([tis for theta, tis in found.stated_tis])
        albedo = directional_albedo(GGX, VALUES, np.array([theta for theta, _ in found.stated_tis]))[k]
        np.testing.assert_allclose(stated, albedo, rtol=1e-3)
        assert f"paint.{channel}.zemax.bsdf: interpolated linearly it has 0." in shown["zemax"].replace("\n", "")
        assert "by merlfit" in path.read_text().splitlines()[0]


def truth(theta_i, azimuth, radial):
    """The model's BRDF (C, N) in the frame of the mirror direction, and the cosine of the viewer."""
    a, r, t = np.radians(azimuth), np.radians(radial), np.radians(theta_i)
    x, y, z = np.sin(r) * np.cos(a), np.sin(r) * np.sin(a), np.cos(r)
    o = np.stack([np.cos(t) * x - np.sin(t) * z, y, np.sin(t) * x + np.cos(t) * z], -1)
    i = np.broadcast_to([np.sin(t), 0.0, np.cos(t)], o.shape)
    return np.asarray(jax.jit(lambda i, o: evaluate(GGX, VALUES, Geometry.from_vectors(i, o)))(i, o)), o[:, 2]


@pytest.mark.parametrize("to", FORMULAS)
def test_parameters_of_formulas_come_with_their_errors(exported, to):
    folder, shown = exported
    told = json.loads((folder / f"paint.{to}.json").read_text())
    assert told["format"] == f"merlfit-{to} 1"
    assert {(row["theta_i_deg"], row["channel"]) for row in told["rows"]} == {
        (t, c) for t in (0, 30, 60) for c in "RGB"
    }
    for row in told["rows"]:
        assert 0 < row["error"]["log_rms"] < 1
        assert row["error_to_file"] is None, "there is no file"
        assert row["tis"] == pytest.approx(row["tis_of_fit"], rel=0.25)
        assert row["model"] in shown[to]
