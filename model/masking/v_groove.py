"""Masking and shadowing in V-grooves (Torrance & Sparrow 1967; Cook & Torrance 1982)."""

import jax.numpy as jnp
from jax import Array

from ..geometry import Geometry
from ..numerics import safe_divide


def v_groove(geometry: Geometry) -> Array:
    """Masking and shadowing in V-grooves, min(1, 2 n.h n.i / h.i, 2 n.h n.o / h.i) (Cook & Torrance 1982)."""
    lower = jnp.minimum(geometry.cos_i, geometry.cos_o)
    return jnp.minimum(1.0, safe_divide(2 * jnp.cos(geometry.theta_h) * lower, geometry.cos_d))


def torrance_sparrow(geometry: Geometry, roughness: Array) -> Array:
    """exp(-theta_h^2 / (2 sigma^2)) G / (cos_i cos_o): facets whose slope angle is Gaussian, in V-grooves (1967)."""
    g = geometry
    return jnp.exp(-((g.theta_h / roughness) ** 2) / 2) * v_groove(g) / (g.cos_i * g.cos_o)
