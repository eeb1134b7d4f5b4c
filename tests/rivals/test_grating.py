"""Rings of gratings against the grating equation, and their light."""

import numpy as np
import pytest
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.rivals.grating import ORDERS, Grating

from tests.support.compiled import evaluate, from_vectors

VALUES = {
    "period": 0.7, "spread": 0.12, "higher": 0.3, "efficiency": np.array([0.2, 0.4, 0.6]),
    "diffuse_albedo": np.array([0.0, 0.1, 0.2]),
}  # fmt: skip


def vectors(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def by_grating_equation(i, o, v, c):
    """Of tangential parts of i + o over the wavelength, in cycles a micrometre, a density over the plane of them."""
    cycles = np.hypot(*(i + o)[..., :2].T).T / WAVELENGTHS_UM[c]
    total = v["diffuse_albedo"][c] / np.pi * np.ones(len(cycles))
    for m in range(1, ORDERS + 1):
        radius = m / v["period"]
        width, share = v["spread"] * radius, v["higher"] ** (m - 1) / sum(v["higher"] ** j for j in range(ORDERS))
        density = np.exp(-(((cycles - radius) / width) ** 2) / 2) / (np.sqrt(2 * np.pi) * width)
        total += v["efficiency"][c] * share * density / (2 * np.pi * radius) / WAVELENGTHS_UM[c] ** 2
    return total


def test_rings_to_1e_9_and_reciprocal():
    rng = np.random.default_rng(3)
    i, o = (vectors(rng.uniform(0, 1.5, 60), rng.uniform(-np.pi, np.pi, 60)) for _ in range(2))
    found = np.asarray(evaluate(Grating(), VALUES, from_vectors(i, o)))
    expected = [by_grating_equation(i, o, VALUES, c) for c in range(3)]
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-300)
    assert np.allclose(found, evaluate(Grating(), VALUES, from_vectors(o, i)), rtol=1e-9)
    assert not np.allclose(
        found, [by_grating_equation(i, o, {**VALUES, "period": 0.72}, c) for c in range(3)], rtol=0.01
    )


@pytest.mark.parametrize("theta_i", [0.0, 0.3])
def test_the_light_of_its_rings_is_its_efficiency(theta_i):
    values = {**VALUES, "period": 3.0, "spread": 0.1, "diffuse_albedo": np.zeros(3)}  # whose rings are all in the air
    nodes, weights = np.polynomial.legendre.leggauss(400)
    theta, turn = (nodes + 1) * np.pi / 4, np.linspace(0, 2 * np.pi, 256, endpoint=False)
    o = vectors(*np.meshgrid(theta, turn, indexing="ij")).reshape(-1, 3)
    i = np.broadcast_to(vectors(np.array(theta_i), np.array(0.0)), o.shape)
    brdf = np.asarray(evaluate(Grating(), values, from_vectors(i, o))).reshape(3, 400, 256)
    measure = weights * np.pi / 4 * np.sin(theta) * np.cos(theta) * 2 * np.pi / 256
    light = np.einsum("ctp,t->c", brdf, measure)
    assert np.allclose(light, values["efficiency"], rtol=5e-3)
