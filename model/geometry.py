"""Directions of light and viewer as arrays of angles: one description for scattered lists and for broadcast grids.

Every array of a :class:`Geometry` broadcasts against the others. A scattered list of N pairs has all arrays of shape
``(N,)``; a grid keeps ``theta_h`` as ``(H, 1, 1)`` and ``cos_d`` as ``(1, D, 1)``, so that a function of the half angle
alone is computed H times and not H * D * P times. i is light, o is viewer (HP17 Section 3).
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from .numerics import floats, safe_acos, safe_divide, safe_sqrt


class Geometry(eqx.Module):
    """Pairs of directions (i light, o viewer) above a surface of normal n.

    Attributes (all broadcastable against each other):
        theta_h: angle between normal and half vector (rad), in [0, pi/2].
        theta_d: angle between light and half vector (rad), in [0, pi/2].
        cos_i: cosine between normal and light.
        cos_o: cosine between normal and viewer.
    """

    theta_h: Array
    theta_d: Array
    cos_i: Array
    cos_o: Array

    @classmethod
    def from_half_difference(cls, theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike) -> "Geometry":
        """Rusinkiewicz' half and difference angles (rad), of any shapes that broadcast together."""
        theta_h, theta_d, phi_d = floats(theta_h, theta_d, phi_d)
        even = jnp.cos(theta_h) * jnp.cos(theta_d)
        odd = jnp.sin(theta_h) * jnp.sin(theta_d) * jnp.cos(phi_d)
        return cls(theta_h, theta_d, even - odd, even + odd)

    @classmethod
    def from_vectors(cls, i: ArrayLike, o: ArrayLike) -> "Geometry":
        """Unit vectors of light and viewer, shape ``(..., 3)``, in a frame whose third axis is the normal."""
        i, o = floats(i, o)
        sum_, difference = i + o, i - o
        theta_h = jnp.arctan2(safe_sqrt(sum_[..., 0] ** 2 + sum_[..., 1] ** 2), sum_[..., 2])
        theta_d = jnp.arctan2(safe_sqrt(jnp.sum(difference**2, -1)), safe_sqrt(jnp.sum(sum_**2, -1)))
        return cls(theta_h, theta_d, i[..., 2], o[..., 2])

    @property
    def cos_d(self) -> Array:
        """Cosine of the difference angle."""
        return jnp.cos(self.theta_d)

    @property
    def projected_dot(self) -> Array:
        """Dot product of the projections of i and o on the surface, sin_i sin_o cos(phi_o - phi_i)."""
        return jnp.cos(2 * self.theta_d) - self.cos_i * self.cos_o

    @property
    def cos_phi(self) -> Array:
        """Cosine of the azimuth from i to o; where one of them is the normal it means nothing, and is 0."""
        sin_i, sin_o = (safe_sqrt((1 - cos) * (1 + cos)) for cos in (self.cos_i, self.cos_o))
        return jnp.clip(safe_divide(self.projected_dot, sin_i * sin_o), -1.0, 1.0)

    @property
    def mirrored(self) -> "Geometry":
        """The same with the viewer mirrored about the normal, which the half vector then is where light goes back.

        cos^2 theta_d' = sin^2 theta_d + cos_i cos_o, tan^2 theta_h' = (4 sin^2 theta_d - (cos_i - cos_o)^2) / (cos_i +
        cos_o)^2: no difference of nearly equal numbers but near the horizon.
        """
        sin2_d, product = jnp.sin(self.theta_d) ** 2, self.cos_i * self.cos_o
        across = safe_sqrt(4 * sin2_d - (self.cos_i - self.cos_o) ** 2)
        theta_d = jnp.arctan2(safe_sqrt(1 - sin2_d - product), safe_sqrt(sin2_d + product))
        return Geometry(jnp.arctan2(across, self.cos_i + self.cos_o), theta_d, self.cos_i, self.cos_o)

    @property
    def theta_i(self) -> Array:
        """Angle between normal and light (rad)."""
        return safe_acos(self.cos_i)

    @property
    def theta_o(self) -> Array:
        """Angle between normal and viewer (rad)."""
        return safe_acos(self.cos_o)
