"""What the cheap ways to blur the diffraction lobe have in common."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import scaled, zonal

from tests.support.arrays import j
from tests.support.lobes import ANGLES, INSIDE, SEED, lobes_in_range

TIERS = [zonal.convolve, scaled.convolve]


def logarithmic(tier):
    """The tier as a function of theta_h and log B, log(c - 1), log beta, log p."""
    return lambda x: tier(x[0], jnp.exp(x[1]), 1 + jnp.exp(x[2]), jnp.exp(x[3]), jnp.exp(x[4]))


@pytest.mark.parametrize("tier", TIERS)
def test_gradients_against_differences(table, tier):
    lobes = lobes_in_range(12, SEED + 1)
    lobes[:, 0] = np.minimum(lobes[:, 0], 50)  # where the zonal sum is above its rounding errors
    theta_h = np.random.default_rng(SEED).uniform(0.02, 1.5, len(lobes))
    x = np.column_stack([theta_h, np.log(lobes[:, 0]), np.log(lobes[:, 1] - 1), np.log(lobes[:, 2:])])
    value = logarithmic(tier)
    forward, reverse = (np.asarray(jax.jit(partial(jax.lax.map, d(value)))(x)) for d in (jax.jacfwd, jax.jacrev))
    scale = 1e-3 + np.abs(forward).max(1, keepdims=True)
    assert np.max(np.abs(reverse - forward) / scale) < 1e-9
    batch, h = jax.jit(partial(jax.lax.map, value)), 1e-5
    for k in range(5):
        step = h * np.eye(5)[k]
        difference = (np.asarray(batch(x + step)) - np.asarray(batch(x - step))) / (2 * h)
        assert np.max(np.abs(forward[:, k] - difference) / scale[:, 0]) < 1e-5


@pytest.mark.parametrize("tier", TIERS)
def test_values_and_gradients_are_finite_at_every_edge(table, tier):
    def total(theta_h, B, *rest):
        return jnp.sum(tier(theta_h, B, *rest))

    theta_h, B = jnp.array([0.0, 1e-9, np.pi / 2])[:, None], jnp.array([0.0, 1e-6, 1.0, 910.0])
    both = jax.jit(lambda *x: (tier(*x), jax.grad(total, argnums=(0, 1, 2, 3, 4))(*x)))
    for corner in [(1.01, 1e-3, 0.2), (6.0, 1.0, 5.0), (1.01, 1.0, 5.0), (6.0, 1e-3, 0.2), (2.0, 1.5, 0.15)]:
        value, slopes = both(theta_h, B, *j(*corner))
        assert np.all(np.isfinite(value))
        assert all(np.all(np.isfinite(x)) for x in slopes), corner


@pytest.mark.parametrize("tier", TIERS)
@pytest.mark.parametrize("beta", [0.1, 1.5])
def test_grid_and_list_agree(table, tier, beta):
    theta_h, B = jnp.linspace(0, 1.5, 7)[:, None, None], jnp.geomspace(0.1, 60, 33).reshape(3, 1, 11, 1)
    grid = tier(theta_h, B, *j(2.0, beta, 0.8))
    assert grid.shape == (3, 7, 11, 1)
    listed = tier(*(x.ravel() for x in jnp.broadcast_arrays(theta_h, B)), *j(2.0, beta, 0.8))
    # outside the scaled lobe's table a grid interpolates the quadrature
    tolerance = 1e-5 if (tier, beta) == (scaled.convolve, 1.5) else 1e-10
    np.testing.assert_allclose(grid.ravel(), listed, rtol=tolerance, atol=1e-13)
    single = tier(theta_h[3, 0, 0], B[1, 0, 5, 0], *j(2.0, beta, 0.8))
    np.testing.assert_allclose(single, grid[1, 3, 5, 0], rtol=tolerance)


@pytest.mark.parametrize("tier", TIERS)
def test_float32_in_gives_float32_out(table, tier):
    values = [jnp.asarray(x, jnp.float32) for x in (ANGLES, *INSIDE.values())]
    found = tier(*values)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, tier(*j(ANGLES, *INSIDE.values())), rtol=1e-3, atol=1e-6)
