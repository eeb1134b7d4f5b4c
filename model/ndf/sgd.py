"""Shifted-gamma distribution of microfacet normals (Bagher et al. 2012; HP15 Table 1)."""

import jax.numpy as jnp
import numpy as np

from ..numerics import Real, total

NODES = np.arange(-36.0, 4.7, 0.1)  # of log(t - alpha): t up to 110 more than alpha


def log_constant(alpha: Real, p: Real) -> Real:
    """log of K = 1 / (alpha Gamma(1 - p, alpha)), the incomplete gamma function by the trapezoid rule.

    1e-9 for alpha in [1e-4, 2], p in [0, 5] (``tests/rivals/test_microfacets.py``). The published K are this number, to
    their rounding of 4e-6 (``tests/rivals/test_published.py``).
    """
    grown = jnp.exp(jnp.asarray(NODES, jnp.result_type(alpha)))
    t = jnp.asarray(alpha)[..., None] + grown
    integral = total(jnp.exp(-grown - p[..., None] * jnp.log(t / jnp.asarray(alpha)[..., None])) * grown) * 0.1
    return alpha - (1 - p) * jnp.log(alpha) - jnp.log(integral)


def slopes(squared: Real, alpha: Real, p: Real) -> Real:
    """Density P22 of slopes at their squares: K exp(-t) t^-p / pi, t = alpha + squared / alpha."""
    t = alpha + squared / alpha
    return jnp.exp(log_constant(alpha, p) - t - p * jnp.log(t)) / jnp.pi


def D(theta_h: Real, alpha: Real, p: Real) -> Real:
    """Distribution of normals (1/sr); its integral of D cos over the hemisphere is 1. 0 at the horizon."""
    tan2 = jnp.tan(theta_h) ** 2
    t = alpha + tan2 / alpha
    return jnp.exp(log_constant(alpha, p) + 2 * jnp.log1p(tan2) - t - p * jnp.log(t)) / jnp.pi
