"""Beckmann's distribution of microfacet normals."""

import jax.numpy as jnp
from jax import Array


def beckmann_shape(theta_h: Array, roughness: Array) -> Array:
    """``exp(-tan^2(theta_h) / m^2) / (m^2 cos^4 theta_h)``: Cook & Torrance's D; divided by pi it is normalised.

    0 at the horizon, where the exponential beats every power. ``m`` is the root mean square slope.
    """
    tan2 = jnp.tan(theta_h) ** 2
    return jnp.exp(-tan2 / roughness**2 + 2 * jnp.log1p(tan2)) / roughness**2
