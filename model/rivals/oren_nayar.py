"""Oren & Nayar's models of rough matte surfaces (Oren & Nayar 1994): Lambertian facets in symmetric V-cavities.

The functional approximation is Eq. 14-16, with interreflection; Eq. 14, as far as its print is legible, is that of the
report it is from. It stands for the numerical integral over facets, Eq. 4-13, as does their qualitative model
(:mod:`.oren_nayar_qualitative`).
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from jax import Array

from ..geometry import Geometry
from ..masking.v_groove import v_groove
from ..numerics import Real, Scalar, safe_divide, safe_sqrt
from ..parameters import ALBEDO, Parameter
from ..priors import LogNormal
from ..quadrature import gauss_legendre
from ..reflectance import Factor, Lobes, Reflectance, Setting, Values
from .oren_nayar_qualitative import PAPER, ROUGHNESS

WEIGHT = Parameter("k_s", "k_s", "weight of the surface's reflection", "1", 0.05, 1e-5, 10.0, per_channel=True,
                   source="Oren & Nayar 1994, Section 4", prior=LogNormal(0.03, 6.0))  # fmt: skip
SLOPES, AZIMUTHS = 32, 64  # nodes of the numerical integral


@dataclass(frozen=True)
class OrenNayar(Reflectance):
    """Rough Lambertian facets with interreflection; with or without a surface that reflects.

    Attributes:
        form: ``functional``, the approximation of Eq. 14-16; or ``numerical``, the integral over facets that it stands
            for (Eq. 4-13): a reference, to 4e-3 up to 75 degrees. Nearer to the horizon its nodes are too few: 1.8e-2
            at 88.8 and 72 degrees, 12 % at 86.6 and 87.6.
        surface: ``none``; or ``torrance-sparrow``, k_s exp(-theta_h^2 / (2 sigma^2)) G / (cos_i cos_o) with V-grooves
            of the same roughness, which Section 4 adds with a weight for each channel.

    Reciprocal, the numerical form to its accuracy. The functional form is within 3 % of the integral in the median
    over directions up to 75 degrees, within 2 to 14 % for 95 % of them, and at most 29 % off, for roughnesses from 0.2
    to 0.8 and albedos from 0.1 to 0.9; the qualitative model 1 to 11 %, 8 to 88 %, and 250 %
    (``tests/rivals/test_oren_nayar.py``). Section 4's weight k_b of the body is 1 here.
    """

    name: ClassVar[str] = "oren-nayar"
    citation: ClassVar[str] = PAPER
    bodies: ClassVar[tuple[str, ...]] = ("rough lambert",)
    form: Literal["functional", "numerical"] = "functional"
    surface: Literal["none", "torrance-sparrow"] = "torrance-sparrow"

    @property
    def lobes(self) -> tuple[str, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return () if self.surface == "none" else ("specular",)

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        return (ROUGHNESS, *(() if self.surface == "none" else (WEIGHT,)), ALBEDO)

    @property
    def variant(self) -> str:  # noqa: D102
        unusual = [] if self.form == "functional" else [self.form]
        return " ".join([self.name, *unusual, *(["without a surface"] if self.surface == "none" else [])])

    @property
    def objection(self) -> str | None:  # noqa: D102
        return "form 'numerical' is a reference; no fit uses it" if self.form == "numerical" else None

    def factors(self) -> dict[str, Factor]:  # noqa: D102
        body = functional if self.form == "functional" else numerical
        found: dict[str, Factor] = {"body": lambda v, s: body(s.geometry, v["roughness"], v["albedo"])}
        if self.surface != "none":
            found |= {"distribution": _distribution, "weight": lambda v, s: v["k_s"]}
        return found

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        if self.surface == "none":
            return Lobes({}, body=at["body"])
        g = s.geometry
        grooves = v_groove(g) / (g.cos_i * g.cos_o)
        return Lobes({"specular": at["weight"] * at["distribution"]}, grooves, at["body"])


def _distribution(v: Values, s: Setting) -> Array:
    """Gaussian in the facets' slope angle, one at its peak."""
    return jnp.exp(-((s.geometry.theta_h / v["roughness"]) ** 2) / 2)


def functional(g: Geometry, roughness: Scalar, albedo: Real) -> Real:
    """Oren & Nayar 1994, Eq. 14-16, over E0 cos(theta_i).

    With alpha and beta the larger and the smaller of theta_i and theta_o and phi the azimuth between them,

        albedo/pi [C1 + C2 cos(phi) tan(beta) + C3 (1 - |cos phi|) tan((alpha + beta)/2)]
        + 0.17 albedo^2/pi s2/(s2 + 0.13) (1 - cos(phi) (2 beta/pi)^2),    s2 = sigma^2;
        C1 = 1 - s2/(2 (s2 + 0.33)), C3 = 0.125 s2/(s2 + 0.09) (4 alpha beta/pi^2)^2,
        C2 = 0.45 s2/(s2 + 0.09) (sin(alpha) - [(2 beta/pi)^3 where cos(phi) < 0]).

    Opposite the light and near the horizon it is negative, down to -0.21 albedo/pi: to renderers it is 0 there.
    """
    square = roughness**2
    alpha, beta = jnp.maximum(g.theta_i, g.theta_o), jnp.minimum(g.theta_i, g.theta_o)
    sin_alpha, cos_beta = jnp.sin(alpha), jnp.maximum(g.cos_i, g.cos_o)
    sines = sin_alpha * jnp.sin(beta)
    cos_phi = jnp.clip(safe_divide(g.projected_dot, sines), -1.0, 1.0)
    share = square / (square + 0.09)
    behind = jnp.where(cos_phi < 0, (2 * beta / jnp.pi) ** 3, 0.0)
    C2 = 0.45 * share * (sin_alpha - behind)
    C3 = 0.125 * share * (4 * alpha * beta / jnp.pi**2) ** 2
    direct = 1 - square / (2 * (square + 0.33)) + C2 * cos_phi * jnp.sin(beta) / cos_beta
    direct = direct + C3 * (1 - jnp.abs(cos_phi)) * jnp.tan((alpha + beta) / 2)
    again = 0.17 * square / (square + 0.13) * (1 - cos_phi * (2 * beta / jnp.pi) ** 2)
    return albedo / jnp.pi * (direct + albedo * again)


def numerical(g: Geometry, roughness: Scalar, albedo: Real) -> Real:
    """The integral over facets (Oren & Nayar 1994, Eq. 4-13), over E0 cos(theta_i): direct light and two bounces.

    A facet of normal a in a V-cavity sees the light over the part of its width that its neighbour does not shade, and
    is seen over the part that the neighbour does not hide (GAF, Eq. 5); what the neighbour a' sends over is Eq. 10-11.
    Slopes are Gaussian in their angle, P(theta_a) = c exp(-theta_a^2 / (2 sigma^2)), by area.
    """
    nodes, weights = gauss_legendre(SLOPES)
    most = jnp.minimum(6 * roughness, jnp.pi / 2)
    slope, width = nodes * most, weights * most
    area = jnp.exp(-((slope / roughness) ** 2) / 2) * jnp.sin(slope) * width
    area = area / jnp.sum(area) / AZIMUTHS
    sin_i, sin_o = (safe_sqrt((1 - c) * (1 + c)) for c in (g.cos_i, g.cos_o))
    cos_phi = jnp.clip(safe_divide(g.projected_dot, sin_i * sin_o), -1.0, 1.0)
    sin_phi = safe_sqrt((1 - cos_phi) * (1 + cos_phi))

    def add(facet: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        k, azimuth = facet % SLOPES, (facet // SLOPES + 0.5) * (2 * math.pi / AZIMUTHS)
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
    direct, again = jax.lax.fori_loop(0, SLOPES * AZIMUTHS, add, (zero, zero))
    return albedo / jnp.pi * (direct + albedo * again)


def _bounced(hidden: Real, dark: Real, cos_opening: Real) -> Real:
    """Interreflection factor over pi (Eq. 11) of facets hidden and dark up to shares of their widths."""

    def d(x: Real | float, y: Real) -> Real:
        return safe_sqrt(x**2 + 2 * x * y * cos_opening + y**2)

    return (d(1.0, hidden) + d(1.0, dark) - d(dark, hidden) - d(1.0, jnp.ones_like(hidden))) / 2
