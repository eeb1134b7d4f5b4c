"""HP15's model against its equations, its normalisation, and the models that it is between."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model.geometry import Geometry
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.reflectance import evaluate
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.hp15 import HP15, diffraction_lobe
from oracles import microfacets as oracle
from oracles.facets import direction
from scipy.integrate import quad

VALUES = {
    "beta": 0.2, "p": 0.7, "a": 0.9, "k_s": np.array([0.8, 0.5, 0.2]), "F0": np.array([0.9, 0.5, 0.1]),
    "k_w": np.array([8e-3, 6e-3, 2e-3]), "diffuse_albedo": np.array([0.05, 0.1, 0.2]),
}  # fmt: skip


def printed(i, o, k, inverted=True):
    """HP15 Eq. 10, 24-27 of channel k; E as printed, or inverted, as it normalises."""
    h = (i + o) / np.linalg.norm(i + o)
    D = lambda t: oracle.epd(t, VALUES["beta"], VALUES["p"])  # noqa: E731
    wavelength, a = WAVELENGTHS_UM[k], VALUES["a"]
    G = math.prod(oracle.smith_G1(v[2], D, 0.2) for v in (i, o))
    F = VALUES["F0"][k] + (1 - VALUES["F0"][k]) * (1 - i @ h) ** 5
    f = np.linalg.norm(np.cross(i + o, [0, 0, 1])) / wavelength
    bracket = 1 + 1 / (a**2 * wavelength**2)
    E = math.pi / bracket if inverted else math.pi * bracket
    lobe = VALUES["k_s"][k] * D(math.acos(h[2])) * F / (4 * i[2] * o[2])
    return VALUES["diffuse_albedo"][k] / math.pi + G * (
        lobe + VALUES["k_w"][k] / wavelength**4 / E / (1 + f**2 / a**2) ** 2
    )


def test_it_is_the_printed_model_with_e_inverted():
    rng = np.random.default_rng(3)
    for _ in range(5):
        i, o = (direction(np.arccos(rng.uniform(0.1, 1)), rng.uniform(0, 2 * np.pi)) for _ in range(2))
        for pair in ((i, o), (o, i)):
            found = evaluate(HP15(), VALUES, Geometry.from_vectors(*pair))
            np.testing.assert_allclose(found, [printed(i, o, k) for k in range(3)], rtol=1e-8)
        assert not np.allclose(found, [printed(i, o, k, inverted=False) for k in range(3)], rtol=1e-3)


@pytest.mark.parametrize("a", [0.1, 0.9, 20.0])
def test_the_diffraction_lobe_integrates_to_one(a):
    """Over the disc of projected directions at normal incidence, where |o_p| = lambda f."""
    wavelength = 0.526
    lobe = lambda r: float(diffraction_lobe(jnp.asarray(r / wavelength), jnp.asarray(a), jnp.asarray(wavelength)))  # noqa: E731
    total = quad(lambda r: 2 * math.pi * r * lobe(r), 0, 1, points=[min(a * wavelength, 1.0)], limit=200)[0]
    assert total == pytest.approx(1, rel=1e-9)


def test_without_diffraction_it_is_epd():
    dark = {**VALUES, "k_w": np.full(3, 1e-30), "k_s": np.ones(3)}
    i, o = direction(0.3, 0.0), direction(0.8, 2.0)
    values = {"beta": 0.2, "p": 0.7, "F0": VALUES["F0"], "albedo": VALUES["diffuse_albedo"]}
    g = Geometry.from_vectors(i, o)
    np.testing.assert_allclose(evaluate(HP15(), dark, g), evaluate(EPD(), values, g), rtol=1e-9)
