"""What the rival models share: directions with a channel axis, V-groove masking, the Beckmann exponential."""

import jax.numpy as jnp
from jax import Array

from ..geometry import Geometry
from ..numerics import floats


def with_channels(geometry: Geometry) -> tuple[Geometry, Array]:
    """The geometry with a trailing channel axis, and where light and viewer are both above the surface.

    Cosines of directions that are not above are replaced by 1, so that every formula stays finite there; the mask
    has the full broadcast shape ``(..., 1)`` and :func:`visible` applies it. Other arrays keep their own shapes: what
    depends on the half angle alone is computed once for each half angle.
    """
    angles = floats(geometry.theta_h, geometry.theta_d, geometry.cos_i, geometry.cos_o)
    theta_h, theta_d, cos_i, cos_o = (x[..., None] for x in angles)
    shape = jnp.broadcast_shapes(theta_h.shape, theta_d.shape, cos_i.shape, cos_o.shape)
    above = jnp.broadcast_to((cos_i > 0) & (cos_o > 0), shape)
    lifted = Geometry(theta_h, theta_d, jnp.where(cos_i > 0, cos_i, 1.0), jnp.where(cos_o > 0, cos_o, 1.0))
    return lifted, above


def visible(diffuse_albedo: Array, specular: Array, above: Array) -> Array:
    """``k_d / pi + specular`` (1/sr), shape ``(..., 3)``; 0 where light or viewer are not above the surface."""
    return jnp.where(above, diffuse_albedo / jnp.pi + specular, 0.0)


def projected_half_squared(geometry: Geometry) -> Array:
    """Squared length of i + o projected on the surface, ``|i + o|^2 sin^2 theta_h = 4 cos_d^2 sin_h^2``."""
    return (2 * geometry.cos_d * jnp.sin(geometry.theta_h)) ** 2
