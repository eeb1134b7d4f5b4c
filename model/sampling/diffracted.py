"""Directions of a nano-geometry's diffraction lobe, by its own shape (HP17 Eq. 51-55)."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from ..diffraction import lobe_amplitude
from ..numerics import safe_acos, safe_divide, safe_sqrt

NARROWEST = 1e-12  # radius below which its direction does not matter


class Diffracted(eqx.Module):
    """On the disc of projected directions, around the mirror direction of a flat surface, at one wavelength.

    With r = lambda f the distance from -i_p, and s = sin(theta_i), the density is

        S_HS(r) / M  pi / phi_max  cos_o,    cos(phi_max) = max(-1, (r^2 + s^2 - 1) / (2 r s)),

    M the lobe's integral up to 1 + s (Eq. 52). Two errata, both found by the chi-square test: the printed density lacks
    1/M, and Eq. 54 turns by pi too much (o_p = -i_p + lambda f is within the disc where f points towards its centre).
    """

    b_over_lambda: Array
    c: Array
    dimensions = 2

    def __init__(self, b_over_lambda: ArrayLike, c: ArrayLike) -> None:
        self.b_over_lambda, self.c = jnp.asarray(b_over_lambda, float), jnp.asarray(c, float)

    def draw(self, given: Array, u: Array) -> Array:
        """Never below the horizon."""
        s, bl = _sine(given), self.b_over_lambda
        falloff = -2 / (self.c - 1) * jnp.log1p(-self._mass(s) * u[..., 0])
        r = safe_sqrt(jnp.expm1(falloff)) / bl
        azimuth = jnp.arctan2(given[..., 1], given[..., 0]) + (2 * u[..., 1] - 1) * _widest(r, s)
        x, y = r * jnp.cos(azimuth) - given[..., 0], r * jnp.sin(azimuth) - given[..., 1]
        return jnp.stack([x, y, safe_sqrt(1 - x * x - y * y)], -1)

    def density(self, given: Array, drawn: Array) -> Array:
        """S_HS(f) / M pi / phi_max cos_o."""
        s, bl = _sine(given), self.b_over_lambda
        r = jnp.hypot(given[..., 0] + drawn[..., 0], given[..., 1] + drawn[..., 1])
        shape = jnp.exp(-(self.c + 1) / 2 * jnp.log1p((bl * r) ** 2))
        turned = safe_divide(jnp.pi, _widest(r, s))
        return lobe_amplitude(bl, self.c) * shape / self._mass(s) * turned * jnp.maximum(drawn[..., 2], 0.0)

    def _mass(self, s: Array) -> Array:
        """Share of the lobe within 1 + s (Eq. 52)."""
        return -jnp.expm1(-(self.c - 1) / 2 * jnp.log1p((self.b_over_lambda * (1 + s)) ** 2))


def _sine(given: Array) -> Array:
    return jnp.hypot(given[..., 0], given[..., 1])


def _widest(r: Array, s: Array) -> Array:
    """phi_max of Eq. 53."""
    whole = 2 * r * s < NARROWEST
    cos = (r * r + s * s - 1) / jnp.where(whole, 1.0, 2 * r * s)
    return jnp.where(whole, jnp.pi, safe_acos(jnp.clip(cos, -1.0, 1.0)))
