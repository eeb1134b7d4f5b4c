"""The directional-diffuse term of He, Torrance, Sillion & Greenberg 1991 (doi:10.1145/127719.122738).

Scalar wave theory of a Gaussian random surface of height sigma0 and correlation length tau, v = i + o:

    rho = k_d / pi + k_s F G S D / (pi cos_i cos_o)
    D = pi^2 tau^2 / (4 lambda^2) Sum_{m>=1} g^m e^-g / (m! m) exp(-pi^2 v_xy^2 tau^2 / (lambda^2 m))         (Eq. 78)
    g = (2 pi sigma (cos_i + cos_o) / lambda)^2                                                              (Eq. 79)
    sigma = sigma0 / sqrt(1 + z0^2), z0 exp(z0^2 / 2) = (K_i + K_o) / sqrt(8 pi)                        (Eq. 80, 81)
    K = tan(theta) erfc(cot(theta) tau / (2 sigma0))                                                    (Eq. 82, 83)
    S = S1(i) S1(o), S1 = (1 - erfc(q) / 2) / (Lambda + 1), q = cot(theta) tau / (2 sigma0)                  (Eq. 24)
    Lambda = exp(-q^2) / (2 sqrt(pi) q) - erfc(q) / 2                                                        (Eq. 25)
    G = (v.v / v_z)^2 (|s_o.i|^2 + |p_o.i|^2)(|s_i.o|^2 + |p_i.o|^2) / |i x o|^4                              (Eq. 76)

Departures from the 1991 print: exp(-q^2) in Eq. 25 is added by its errata; Eq. 78's exponent is printed as
-v_xy^2 tau^2 / (4 m), which holds for wave vectors, of length 2 pi / lambda. Taken with unit vectors it makes the
median RMSE over MERL 0.68 instead of 0.060; without G it is 0.18.

Two simplifications, both exact: s and p of one direction are a basis of the plane across it, so each bracket of Eq. 76
is |i x o|^2 and G = (v.v / v_z)^2; and z0^2 = W(y^2), W Lambert's function, y the right side of Eq. 81. Then v_z
cancels against g, S1 absorbs 1/cos, and nothing is singular at the horizon.
"""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import erfc

from ..body import lambert
from ..fresnel import fresnel_of_dielectric
from ..numerics import safe_sqrt
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Factor, Lobes, Reflectance, Setting, Values
from .common import DIFFUSE
from .he_series import lambert_w, series

SOURCE = "He et al. 1991"
NORMAL_Q = 30.0  # q at normal incidence, where it is infinite: exp(-30^2) and erfc(30) are 0 in double precision
GRAZING_COS = 1e-100  # keeps tan^2 below 1e200


def _cotangent(cos: Array, slope: Array) -> tuple[Array, Array]:
    """``q = cot(theta) tau / (2 sigma0)``, ``slope = 2 sigma0 / tau``, and sin(theta)."""
    sin = safe_sqrt((1 - cos) * (1 + cos))
    tilted = sin > 0
    return jnp.where(tilted, cos / (slope * jnp.where(tilted, sin, 1.0)), NORMAL_Q), sin


def shadowing_over_cos(cos: Array, slope: Array) -> Array:
    """S1 / cos(theta) (Eq. 24-25), with its limits: 1 at normal incidence, ``sqrt(pi) / slope`` at the horizon.

    Args:
        cos: cosine between normal and direction, >= 0. slope: 2 sigma0 / tau.
    """
    q, sin = _cotangent(cos, slope)
    lit = 1 - erfc(q) / 2
    return lit / (slope * sin * jnp.exp(-(q**2)) / (2 * jnp.sqrt(jnp.pi)) + cos * lit)


def effective_roughness(cos_i: Array, cos_o: Array, roughness: Array, slope: Array) -> Array:
    """sigma (Eq. 80-83), in the unit of ``roughness``: what of the roughness is seen at grazing angles."""

    def obliquity(cos: Array) -> Array:
        q, sin = _cotangent(cos, slope)
        return sin / jnp.maximum(cos, GRAZING_COS) * erfc(q)

    squared = (obliquity(cos_i) + obliquity(cos_o)) ** 2 / (8 * jnp.pi)
    return roughness / jnp.sqrt(1 + lambert_w(squared))


@dataclass(frozen=True)
class He(Reflectance):
    """The module's formula; the mirror's own peak is left out. F is that of a dielectric of index eta at theta_d.

    Reciprocal. Values and first derivatives are finite everywhere; second derivatives miss a part (:func:`lambert_w`).
    Accuracy: 1e-9 against an independent oracle, 1e-7 where more than a few thousand directions are asked for at
    once and the series is looked up (`he_series.series`; ``tests/rivals/test_rivals.py``); with published parameters
    the median errors over 86 materials of MERL are RMSE 0.060, sMAPE 0.252, and 0.055, 0.209 once the table's colours
    are put on MERL's scale (``tests/rivals/test_published.py``).
    """

    name: ClassVar[str] = "he"
    citation: ClassVar[str] = (
        "He, Torrance, Sillion & Greenberg 1991, A comprehensive physical model for light reflection, "
        "doi:10.1145/127719.122738"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            Parameter("roughness", r"\sigma_0", "standard deviation of the surface's height", "um", 0.5, 1e-3, 20.0,
                      source=SOURCE, prior=LogNormal(0.3, 4.0)),
            Parameter("autocorrelation", r"\tau", "correlation length of the surface", "um", 20.0, 0.5, 300.0,
                      source=SOURCE, prior=LogNormal(10.0, 4.0)),
            Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.0, 20.0, "linear", source=SOURCE),
            Parameter("albedo", r"\rho_s", "weight of the directional-diffuse term", "1", 0.3, 1e-4, 1e10,
                      per_channel=True, source="Ngan et al. 2005", prior=LogNormal(1.0, 5.0)),
            DIFFUSE,
        )  # fmt: skip

    def factors(self) -> dict[str, Factor]:  # noqa: D102
        return {
            "fresnel": lambda v, s: fresnel_of_dielectric(s.geometry.cos_d, v["eta"]),
            "surface": surface,
            "albedo": lambda v, s: v["albedo"],
            "body": lambda v, s: lambert(v["diffuse_albedo"]),
        }

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        return Lobes({"specular": at["albedo"] * at["fresnel"] * at["surface"]}, body=at["body"])


def surface(v: Values, s: Setting) -> Array:
    """G S D / (pi cos_i cos_o), per channel."""
    g, wave = s.geometry, 2 * jnp.pi / s.wavelength_um
    roughness, tau = v["roughness"], v["autocorrelation"]
    slope = 2 * roughness / tau
    shadowing = shadowing_over_cos(g.cos_i, slope) * shadowing_over_cos(g.cos_o, slope)
    phase = (wave * effective_roughness(g.cos_i, g.cos_o, roughness, slope)) ** 2  # g / v_z^2
    v_z = 2 * jnp.cos(g.theta_h) * g.cos_d
    projected = (2 * g.cos_d * jnp.sin(g.theta_h)) ** 2  # |i + o|^2 sin^2 theta_h
    summed = series(phase * v_z**2, (wave * tau) ** 2 * projected / 4)
    # pi^2 tau^2 / (4 lambda^2) G g / pi, where G g = (v.v)^2 phase and v.v = 4 cos_d^2
    return shadowing * (wave * tau) ** 2 * phase * g.cos_d**4 / jnp.pi * summed
