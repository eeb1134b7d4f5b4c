"""Beckmann's distribution of microfacet normals."""

import jax.numpy as jnp

from ..numerics import Real, Scalar


def D(theta_h: Real, roughness: Scalar) -> Real:
    """``exp(-tan^2(theta_h) / m^2) / (pi m^2 cos^4 theta_h)`` (1/sr); its integral of D cos over the hemisphere is 1.

    0 at the horizon, where the exponential beats every power. ``m`` is the root mean square slope.
    """
    tan2 = jnp.tan(theta_h) ** 2
    return jnp.exp(-tan2 / roughness**2 + 2 * jnp.log1p(tan2)) / (jnp.pi * roughness**2)
