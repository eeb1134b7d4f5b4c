"""The shifted-gamma microfacet model of Bagher, Soler & Holzschuch 2012 (doi:10.1111/j.1467-8659.2012.03147.x)."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..geometry import Geometry
from ..parameters import ALBEDO, Parameter
from .common import visible, with_channels

SOURCE = "Bagher et al. 2012"
# log of the masking's inner exponent beyond which G1 is 0 for any Lambda a double can hold: exp(exp(6.4)) = 1e261
LARGEST_LOG_EXPONENT = 6.4


class ShiftedGamma(eqx.Module):
    """Parameters, every one of shape ``(3,)`` (dimensionless unless said; see ``PARAMETERS``)."""

    diffuse_albedo: Array
    albedo: Array
    alpha: Array
    p: Array
    F0: Array
    F1: Array
    K: Array
    Lambda: Array
    c: Array
    k: Array
    theta0: Array  # rad


def _channel(
    name: str, symbol: str, meaning: str, default: float, lower: float, upper: float, linear: bool, unit: str = "1"
) -> Parameter:
    scale = "linear" if linear else "log"
    return Parameter(name, symbol, meaning, unit, default, lower, upper, scale, per_channel=True, source=SOURCE)


# The bounds are wide enough for every published value. Some of those mean nothing: where Lambda is 1e-7 or theta0 is
# near pi/2 there is no masking, and c and k are whatever the fit left there (c reaches 1e109).
PARAMETERS = (
    Parameter("diffuse_albedo", ALBEDO.symbol, "albedo of the diffuse term", "1", 0.1, 0.0, 1.0, "linear",
              per_channel=True, source=SOURCE),
    _channel("albedo", r"\rho_s", "weight of the specular term", 0.1, 0.0, 10.0, True),
    _channel("alpha", r"\alpha", "width of the shifted-gamma distribution", 0.03, 1e-6, 2.0, False),
    _channel("p", "p", "decay exponent of the shifted-gamma distribution", 0.5, 0.0, 5.0, True),
    _channel("F0", "F_0", "Fresnel term: reflectance at normal incidence, plus F1", 0.1, 0.0, 10.0, True),
    _channel("F1", "F_1", "Fresnel term: slope in cos(theta_d)", 0.0, -1.0, 10.0, True),
    _channel("K", "K_{ap}", "normalisation of the distribution, fitted by itself", 30.0, 1e-1, 1e6, False),
    _channel("Lambda", r"\Lambda", "masking: how deep it reaches", 3.0, 1e-9, 1e9, False),
    _channel("c", "c", "masking: coefficient of the exponent", 1e-6, 1e-9, 1e110, False),
    _channel("k", "k", "masking: power of the angle", 25.0, 1.0, 1e3, False),
    _channel("theta0", r"\theta_0", "masking: angle at which it sets in", 0.2, -1.0, 1.5, True, "rad"),
)  # fmt: skip


def distribution(theta_h: Array, alpha: Array, p: Array, K: Array) -> Array:
    """D (1/sr): ``K exp(-t) t^-p / (pi cos^4 theta_h)``, ``t = alpha + tan^2(theta_h) / alpha``.

    Formed in logarithms; 0 at the horizon.
    """
    tan2 = jnp.tan(theta_h) ** 2
    t = alpha + tan2 / alpha
    return K * jnp.exp(2 * jnp.log1p(tan2) - t - p * jnp.log(t)) / jnp.pi


def fresnel_term(cos_d: Array, F0: Array, F1: Array) -> Array:
    """``F0 - F1 cos_d + (1 - F0)(1 - cos_d)^5``: Schlick's form with a slope. Not confined to [0, 1]."""
    return F0 - F1 * cos_d + (1 - F0) * (1 - cos_d) ** 5


def masking(theta: Array, Lambda: Array, c: Array, k: Array, theta0: Array) -> Array:
    """G1 in [0, 1]: ``clip(1 + Lambda (1 - exp(c max(0, theta - theta0)^k)), 0, 1)``.

    The inner exponent is formed as ``exp(log c + k log(theta - theta0))``, as published c reach 1e109 and k 855.
    """
    past = theta > theta0
    log_exponent = jnp.log(c) + k * jnp.log(jnp.where(past, theta - theta0, 1.0))
    exponent = jnp.where(past, jnp.exp(jnp.minimum(log_exponent, LARGEST_LOG_EXPONENT)), 0.0)
    return jnp.maximum(0.0, 1 - Lambda * jnp.expm1(exponent))


def evaluate(parameters: ShiftedGamma, geometry: Geometry) -> Array:
    """BRDF (1/sr), ``(k_d + k_s F D G1(i) G1(o) / (cos_i cos_o)) / pi``.

    Args:
        parameters: one value a channel each.
        geometry: directions, scattered or as a broadcast grid.

    Returns:
        shape ``(*broadcast shape of geometry, 3)``; 0 where light or viewer are not above the surface.

    Reciprocal. Values and gradients are finite everywhere. The 1/cos is the paper's own and is not held back where the
    fitted masking leaves off, so values at the horizon may be large. Accuracy: 1e-9 against an independent oracle
    (``tests/rivals/test_rivals.py``); with the published parameters the median errors over MERL are RMSE 0.049,
    sMAPE 0.134 (``tests/rivals/test_published.py``).
    """
    q, (g, above) = parameters, with_channels(geometry)
    D = distribution(g.theta_h, q.alpha, q.p, q.K)
    F = fresnel_term(g.cos_d, q.F0, q.F1)
    G = masking(g.theta_i, q.Lambda, q.c, q.k, q.theta0) * masking(g.theta_o, q.Lambda, q.c, q.k, q.theta0)
    return visible(q.diffuse_albedo, q.albedo * F * D * G / (jnp.pi * g.cos_i * g.cos_o), above)
