"""Fresnel's equations and diffracted light's colour against slow oracles, with wrong formulas that are rejected."""

import jax
import mpmath as mp
import numpy as np
import pytest
from merlfit.model import fresnel

from tests.oracles import fresnel as o_fresnel
from tests.support.arrays import worst

SEED = 20261121
reflected, colour = jax.jit(fresnel.fresnel), jax.jit(fresnel.diffraction_colour)


def optical_cases(count=60):
    rng = np.random.default_rng(SEED)
    n = np.exp(rng.uniform(np.log(0.05), np.log(6), count))
    k = np.where(np.arange(count) % 3 == 0, 0.0, np.exp(rng.uniform(np.log(1e-3), np.log(12), count)))
    return rng.uniform(0, np.pi / 2, count), rng.uniform(0, np.pi / 2, count), rng.uniform(0, np.pi, count), n, k


def test_fresnel_to_1e_12():
    theta, _, _, n, k = optical_cases()
    expected = [o_fresnel.fresnel(np.cos(t), *nk) for t, *nk in zip(theta, n, k, strict=True)]
    assert worst(reflected(np.cos(theta), n, k), expected) < 1e-12
    swapped = [o_fresnel.fresnel(np.cos(t), b, a) for t, a, b in zip(theta, n, k, strict=True) if b > 0]
    assert worst(np.asarray(reflected(np.cos(theta), n, k))[k > 0], swapped) > 1e-2


def test_diffraction_colour_to_1e_8_and_is_half_of_q():
    i, o, phi, n, k = optical_cases()
    dot = -np.sin(i) * np.sin(o) * np.cos(phi)  # phi is counted from the mirror direction
    found = colour(np.cos(i), np.cos(o), dot, n, k)
    q = np.array([float(o_fresnel.rayleigh_rice_q(*case)) for case in zip(i, o, phi, n, k, strict=True)])
    assert worst(found, q / 2) < 1e-8
    assert worst(found, q) > 0.4  # the printed Q, twice as much


def test_diffraction_colour_is_fresnel_in_the_mirror_direction():
    theta, _, _, n, k = optical_cases()
    cos = np.cos(theta)
    np.testing.assert_allclose(colour(cos, cos, -(1 - cos**2), n, k), reflected(cos, n, k), rtol=1e-12)


def test_high_precision_fresnel_at_the_edges():
    mp.mp.dps = 30
    for cos in (0.0, 1e-9, 1.0):
        for n, k in ((1.0, 0.0), (0.1, 20.0), (1.5, 0.0)):
            found = float(reflected(cos, n, k))
            if not (cos == 0.0 and n == 1.0):
                assert found == pytest.approx(float(o_fresnel.fresnel(cos, n, k)), rel=1e-12, abs=1e-15)


def test_a_dielectric_is_a_conductor_that_absorbs_nothing():
    rng = np.random.default_rng(SEED)
    n, cos = np.exp(rng.uniform(np.log(0.3), np.log(4), 200)), rng.uniform(0, 1, 200)
    n[:3], cos[:3] = (1.0, 1.0, 1.5), (0.0, 0.5, 0.0)
    expected = [float(o_fresnel.fresnel(*case, 0.0)) for case in zip(cos[1:], n[1:], strict=True)]
    found = np.asarray(jax.jit(fresnel.fresnel_of_dielectric)(cos, n))
    assert worst(found[1:], expected) < 1e-12
    np.testing.assert_allclose(found, reflected(cos, n, 0 * n), rtol=1e-13, atol=4e-15)
    assert worst(np.asarray(jax.jit(fresnel.fresnel_of_dielectric)(cos, n**2))[1:], expected) > 1e-2
    past = n**2 < 1 - cos**2 - 1e-12
    assert past.sum() > 20
    assert np.all(found[past] == 1)
    slopes = [jax.vmap(jax.grad(f, (0, 1))) for f in (fresnel.fresnel_of_dielectric, _of_conductor)]
    ours, theirs = (np.stack(slope(cos, n)) for slope in slopes)
    assert np.all(np.isfinite(ours))
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-12)


def _of_conductor(cos, n):
    return fresnel.fresnel(cos, n, 0 * n)
