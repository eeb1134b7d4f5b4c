"""Whether drawn directions follow their density: Pearson's chi-square over bins of the half vector."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

STEEPNESSES, AZIMUTHS, WITHIN = 20, 8, 48  # bins of log tan(theta_h) and of phi_h, nodes a side of a bin
DRAWN = 100_000
LEAST = 8.0  # expected in a bin that counts for itself


def given_at(degrees, azimuth=0.7):
    theta = np.radians(degrees)
    return np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])


@eqx.filter_jit
def draws(sampler, given, u):
    return sampler.draw(jnp.broadcast_to(given, (*u.shape[:-1], 3)), u)


@eqx.filter_jit
def densities(sampler, given, drawn):
    return sampler.density(jnp.broadcast_to(given, drawn.shape), drawn)


def numbers(sampler, count=DRAWN, seed=1):
    return np.random.default_rng(seed).random((count, sampler.dimensions))


def half_vectors(given, drawn):
    """log tan(theta_h) and phi_h."""
    half = given + drawn
    return np.log(np.maximum(np.hypot(half[:, 0], half[:, 1]), 1e-30) / half[:, 2]), np.arctan2(half[:, 1], half[:, 0])


def expected(sampler, given, edges):
    """Probability of each bin by the midpoint rule; viewers below the horizon have none."""
    steps = (np.arange(WITHIN) + 0.5) / WITHIN
    y = (edges[0][:-1, None] + np.diff(edges[0])[:, None] * steps).reshape(-1, 1)
    phi = (edges[1][:-1, None] + np.diff(edges[1])[:, None] * steps).reshape(1, -1)
    tan = np.exp(y)
    cos = 1 / np.sqrt(1 + tan**2)
    half = np.stack([tan * cos * np.cos(phi), tan * cos * np.sin(phi), cos + 0 * phi], -1)
    cos_d = half @ given
    drawn = 2 * cos_d[..., None] * half - given
    seen = (cos_d > 0) & (drawn[..., 2] > 0)
    density = np.asarray(densities(sampler, given, np.where(seen[..., None], drawn, given)))
    each = np.where(seen, density * 4 * cos_d * tan**2 * cos**3, 0.0)
    area = np.diff(edges[0])[:, None] * np.diff(edges[1]) / WITHIN**2
    return each.reshape(len(edges[0]) - 1, WITHIN, len(edges[1]) - 1, WITHIN).sum((1, 3)) * area


def p_value(sampler, given, count=DRAWN, seed=1, density_of=None):
    """Of the hypothesis that ``sampler`` draws by the density of ``density_of``, itself unless another is given.

    What comes to nothing, or lies beyond the bins, is a bin of its own, which has the rest of the probability.
    """
    drawn = np.asarray(draws(sampler, given, numbers(sampler, count, seed)))
    above = drawn[:, 2] > 0
    y, phi = half_vectors(given, drawn[above])
    low, high = np.quantile(y, [0.002, 0.998])
    edges = np.linspace(low, high, STEEPNESSES + 1), np.linspace(-np.pi, np.pi, AZIMUTHS + 1)
    found = np.histogram2d(y, phi, edges)[0].ravel()
    aim = expected(density_of or sampler, given, edges).ravel() * count
    found, aim = np.append(found, count - found.sum()), np.append(aim, count - aim.sum())
    assert aim[-1] > -0.003 * count, "the density integrates to more than one"
    few = aim < LEAST
    found, aim = np.append(found[~few], found[few].sum()), np.append(aim[~few], max(aim[few].sum(), 1e-9))
    if aim[-1] < LEAST:  # too few even together: they join the largest bin
        most = np.argmax(aim[:-1])
        found[most], aim[most] = found[most] + found[-1], aim[most] + aim[-1]
        found, aim = found[:-1], aim[:-1]
    statistic = np.sum((found - aim) ** 2 / aim)
    return float(chi2.sf(statistic, len(aim) - 1))
