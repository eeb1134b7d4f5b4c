"""Generalised Trowbridge-Reitz (GTR) distribution of microfacet normals (Burley 2012, HP15 Table 1)."""

import jax.numpy as jnp

from ..numerics import Real, Scalar, expm1_over


def slopes(squared: Real, alpha: Scalar, gamma: Scalar | float) -> Real:
    """Density P22 of slopes at their squares x, c (1 + x)^(gamma - 2) / (alpha^2 + x)^gamma.

    gamma = 2 is GGX, gamma = 1 Berry's distribution. ``constant`` is c (HP15 Table 1).
    """
    return constant(alpha, gamma) * jnp.exp((gamma - 2) * jnp.log1p(squared) - gamma * jnp.log(alpha**2 + squared))


def constant(alpha: Scalar, gamma: Scalar | float) -> Real:
    """What normalises it: u expm1(L) / (pi expm1(u L)), L = log alpha^2, u = 1 - gamma; u = 0 is no exception."""
    L = 2 * jnp.log(alpha)
    return expm1_over(L) / (expm1_over((1 - gamma) * L) * jnp.pi)


def D(theta_h: Real, alpha: Scalar, gamma: Scalar | float) -> Real:
    """Distribution of normals (1/sr); its integral of D cos over the hemisphere is 1.

    P22 / cos^4 = c / (cos^2 alpha^2 + sin^2)^gamma, without a tangent that is infinite at the horizon.
    """
    sin, cos = jnp.sin(theta_h), jnp.cos(theta_h)
    return constant(alpha, gamma) * jnp.exp(-gamma * jnp.log(alpha**2 * cos**2 + sin**2))
