"""Integrals over facets that models stand for: of Oren & Nayar 1994, Eq. 4-13, and of interfaced Lambertian ones."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from merlfit.model.geometry import Geometry
from merlfit.model.numerics import Real, Scalar, safe_divide, safe_sqrt
from merlfit.model.quadrature import gauss_legendre
from merlfit.model.reflectance import Setting, Values
from merlfit.model.rivals.interfaced_lambertian import InterfacedLambertian
from merlfit.model.rivals.oren_nayar_qualitative import OrenNayarQualitative

SLOPES, TURNS = 32, 64  # nodes of the angle and of the azimuth of a facet


@dataclass(frozen=True)
class Cavities(OrenNayarQualitative):
    """The integral as a model: to 4e-3 up to 75 degrees.

    Nearer to the horizon its nodes are too few: 1.8e-2 at 88.8 and 72 degrees, 12 % at 86.6 and 87.6.
    """

    def body(self, v: Values, s: Setting) -> Array:
        return integral(s.geometry, v["roughness"], v["albedo"])


@dataclass(frozen=True)
class ManyFacets(InterfacedLambertian):
    """Interfaced Lambertian facets by a sum over so many normals that it is the integral, to 5e-3 up to 75 degrees."""

    normals_of_sum = (32, 64)


def integral(g: Geometry, roughness: Scalar, albedo: Real) -> Real:
    """BRDF (1/sr) of direct light and two bounces (Oren & Nayar 1994, Eq. 4-13).

    A facet of normal a in a V-cavity sees the light over the part of its width that its neighbour does not shade, and
    is seen over the part that the neighbour does not hide (GAF, Eq. 5); what the neighbour a' sends over is Eq. 10-11.
    Slopes are Gaussian in their angle, P(theta_a) = c exp(-theta_a^2 / (2 sigma^2)), by area.
    """
    nodes, weights = gauss_legendre(SLOPES)
    most = jnp.minimum(6 * roughness, jnp.pi / 2)
    slope, width = nodes * most, weights * most
    area = jnp.exp(-((slope / roughness) ** 2) / 2) * jnp.sin(slope) * width
    area = area / jnp.sum(area) / TURNS
    sin_i, sin_o = (safe_sqrt((1 - c) * (1 + c)) for c in (g.cos_i, g.cos_o))
    cos_phi = g.cos_phi
    sin_phi = safe_sqrt((1 - cos_phi) * (1 + cos_phi))

    def add(facet: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        k, azimuth = facet % SLOPES, (facet // SLOPES + 0.5) * (2 * math.pi / TURNS)
        sin_a, cos_a = jnp.sin(slope[k]), jnp.cos(slope[k])
        along_i = sin_a * sin_i * jnp.cos(azimuth)
        along_o = sin_a * sin_o * (jnp.cos(azimuth) * cos_phi + jnp.sin(azimuth) * sin_phi)
        lit, seen, other_lit = cos_a * g.cos_i + along_i, cos_a * g.cos_o + along_o, cos_a * g.cos_i - along_i
        bare_lit, bare_seen, bare_other = (
            jnp.clip(safe_divide(2 * c * cos_a, jnp.maximum(x, 0.0)), 0.0, 1.0)
            for c, x in ((g.cos_i, lit), (g.cos_o, seen), (g.cos_i, other_lit))
        )
        there = area[k] * jnp.maximum(seen, 0.0) / (cos_a * g.cos_o * g.cos_i)
        bounced = _bounced(1 - bare_seen, 1 - bare_other, jnp.cos(2 * slope[k]))
        direct = there * jnp.maximum(lit, 0.0) * jnp.minimum(bare_lit, bare_seen)
        return sums[0] + direct, sums[1] + there * jnp.maximum(other_lit, 0.0) * bounced

    zero = jnp.zeros(jnp.broadcast_shapes(g.cos_i.shape, cos_phi.shape))
    direct, again = jax.lax.fori_loop(0, SLOPES * TURNS, add, (zero, zero))
    return albedo / jnp.pi * (direct + albedo * again)


def _bounced(hidden: Real, dark: Real, cos_opening: Real) -> Real:
    """Interreflection factor over pi (Eq. 11) of facets hidden and dark up to shares of their widths."""

    def d(x: Real | float, y: Real) -> Real:
        return safe_sqrt(x**2 + 2 * x * y * cos_opening + y**2)

    return (d(1.0, hidden) + d(1.0, dark) - d(dark, hidden) - d(1.0, jnp.ones_like(hidden))) / 2
