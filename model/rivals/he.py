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

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import erfc, gammaln

from ..fresnel import fresnel
from ..geometry import Geometry
from ..numerics import TINY, safe_sqrt
from ..parameters import WAVELENGTHS_UM, Parameter
from .common import projected_half_squared, visible, with_channels

SOURCE = "He et al. 1991"
TERMS = 112  # of the series: see _series
BELOW, ABOVE = 7.0, 8.0  # widths of the summand kept on either side of its largest term; exp(-7^2 / 2) = 2e-11
NORMAL_Q = 30.0  # q at normal incidence, where it is infinite: exp(-30^2) and erfc(30) are 0 in double precision
GRAZING_COS = 1e-100  # keeps tan^2 below 1e200


class He(eqx.Module):
    """Parameters; see ``PARAMETERS``."""

    diffuse_albedo: Array  # (3,)
    albedo: Array  # (3,)
    roughness: Array  # um
    autocorrelation: Array  # um
    eta: Array


PARAMETERS = (
    Parameter("diffuse_albedo", r"\rho_d", "albedo of the diffuse term", "1", 0.1, 0.0, 1.0, "linear",
              per_channel=True, source=SOURCE),
    Parameter("albedo", r"\rho_s", "weight of the directional-diffuse term", "1", 0.3, 1e-4, 1e10, per_channel=True,
              source="Ngan et al. 2005"),
    Parameter("roughness", r"\sigma_0", "standard deviation of the surface's height", "um", 0.5, 1e-3, 20.0,
              source=SOURCE),
    Parameter("autocorrelation", r"\tau", "correlation length of the surface", "um", 20.0, 0.5, 300.0, source=SOURCE),
    Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.0, 20.0, "linear", source=SOURCE),
)  # fmt: skip


def lambert_w(x: Array) -> Array:
    """Lambert's W, ``w e^w = x``, for 0 <= x <= 1e250; relative accuracy 1e-15, exact first derivative in x.

    Halley's iteration without derivative, then one Newton step that carries it.
    """
    fixed = jax.lax.stop_gradient(x)
    w = jnp.log1p(fixed)
    for _ in range(6):
        residual = w - fixed * jnp.exp(-w)
        w = w - residual / (w + 1 - (w + 2) * residual / (2 * w + 2))
    w = jax.lax.stop_gradient(w)
    return w - (w - x * jnp.exp(-w)) / (1 + w)


def _series(g: Array, e: Array) -> Array:
    """``Sum_{m>=1} g^(m-1) exp(-g - e/m) / (m! m)``, each term formed as a logarithm; g reaches 60 000.

    The largest term stands near ``m* = g y``, ``y^2 log y^2 = 2 e / g^2``, and the terms fall off round it as a
    Gaussian of variance ``1 / (1/m* + 2 e/m*^3)``. Where that takes no more than ``TERMS`` terms they are the terms
    themselves; where it takes more, the sum is its own integral to exp(-2 pi^2 width^2), and the trapezoid rule with
    ``TERMS`` nodes has the same kind of error. Accuracy 1e-9, which is what log(m!) leaves at g = 60 000.
    """
    tilt = jnp.minimum(2 * e / jnp.maximum(g, TINY ** (1 / 2)) ** 2, 1e250)
    largest = jnp.maximum(g * jnp.exp(lambert_w(tilt) / 2), 1.0)
    width = 1 / jnp.sqrt(1 / largest + 2 * e / largest**3)
    first = jnp.maximum(jnp.floor(largest - BELOW * width), 1.0)
    step = jnp.maximum((largest + ABOVE * width - first) / (TERMS - 1), 1.0)
    # where the terms lie does not change what they add up to
    first, step = jax.lax.stop_gradient(first), jax.lax.stop_gradient(step)
    m = first[..., None] + step[..., None] * np.arange(TERMS)
    log_g = jnp.log(jnp.maximum(g, TINY))
    log_term = (m - 1) * log_g[..., None] - g[..., None] - gammaln(m + 1) - jnp.log(m) - e[..., None] / m
    return step * jnp.sum(jnp.exp(log_term), -1)


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


def evaluate(parameters: He, geometry: Geometry) -> Array:
    """BRDF (1/sr): diffuse and directional-diffuse terms (module docstring); the mirror's own peak is left out.

    F is the Fresnel reflectance of a dielectric of index eta at theta_d. The wavelengths are 0.645, 0.526 and 0.444 um.

    Args:
        parameters: diffuse_albedo and albedo one value a channel, the others shared; lengths in um.
        geometry: directions, scattered or as a broadcast grid.

    Returns:
        shape ``(*broadcast shape of geometry, 3)``; 0 where light or viewer are not above the surface.

    Reciprocal. Values and first derivatives are finite everywhere; second derivatives miss a part (:func:`lambert_w`).
    Accuracy: 1e-9 against an independent oracle (``tests/rivals/test_rivals.py``); with the published parameters the
    median errors over 86 materials of MERL are RMSE 0.060, sMAPE 0.252, and 0.055, 0.209 once the table's colours are
    put on MERL's scale (``tests/rivals/test_published.py``).
    """
    q, (g, above) = parameters, with_channels(geometry)
    wave = 2 * jnp.pi / jnp.asarray(WAVELENGTHS_UM)
    slope = 2 * q.roughness / q.autocorrelation
    shadowing = shadowing_over_cos(g.cos_i, slope) * shadowing_over_cos(g.cos_o, slope)
    phase = (wave * effective_roughness(g.cos_i, g.cos_o, q.roughness, slope)) ** 2  # g / v_z^2
    v_z = 2 * jnp.cos(g.theta_h) * g.cos_d
    spread = (wave * q.autocorrelation) ** 2 * projected_half_squared(g) / 4
    series = _series(*jnp.broadcast_arrays(phase * v_z**2, spread))
    # pi^2 tau^2 / (4 lambda^2) G g / pi, where G g = (v.v)^2 phase and v.v = 4 cos_d^2
    height = (wave * q.autocorrelation) ** 2 * phase * g.cos_d**4 / jnp.pi
    F = fresnel(g.cos_d, q.eta, jnp.zeros(()))
    return visible(q.diffuse_albedo, q.albedo * F * shadowing * height * series, above)
