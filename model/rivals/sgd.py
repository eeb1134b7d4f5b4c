"""The shifted-gamma microfacet model of Bagher, Soler & Holzschuch 2012 (doi:10.1111/j.1467-8659.2012.03147.x)."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..body import lambert
from ..ndf import sgd
from ..numerics import Real
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Setting, Values
from .common import DIFFUSE

SOURCE = "Bagher et al. 2012"
# log of the masking's inner exponent beyond which G1 is 0 for any Lambda a double can hold: exp(exp(6.4)) = 1e261
LARGEST_LOG_EXPONENT = 6.4


def _channel(
    name: str, symbol: str, meaning: str, default: float, lower: float, upper: float,
    prior: LogNormal | None = None, unit: str = "1",
) -> Parameter:  # fmt: skip
    return Parameter(name, symbol, meaning, unit, default, lower, upper, "log" if prior else "linear", per_channel=True,
                     source=SOURCE, prior=prior)  # fmt: skip


# The bounds are wide enough for every published value. Some of those mean nothing: where Lambda is 1e-7 or theta0 is
# near pi/2 there is no masking, and c and k are whatever the fit left there (c reaches 1e109).
PARAMETERS = (
    _channel("alpha", r"\alpha", "width of the shifted-gamma distribution", 0.03, 1e-6, 2.0, LogNormal(0.03, 5.0)),
    _channel("p", "p", "decay exponent of the shifted-gamma distribution", 0.5, 0.0, 5.0),
    _channel("albedo", r"\rho_s", "weight of the specular term", 0.1, 0.0, 10.0),
    _channel("F0", "F_0", "Fresnel term: reflectance at normal incidence, plus F1", 0.1, 0.0, 10.0),
    _channel("F1", "F_1", "Fresnel term: slope in cos(theta_d)", 0.0, -1.0, 10.0),
    _channel("Lambda", r"\Lambda", "masking: how deep it reaches", 3.0, 1e-9, 1e9, LogNormal(3.0, 3.0)),
    _channel("c", "c", "masking: coefficient of the exponent", 1e-2, 1e-9, 1e110, LogNormal(1e-2, 30.0)),
    _channel("k", "k", "masking: power of the angle", 10.0, 1.0, 1e3, LogNormal(10.0, 2.0)),
    _channel("theta0", r"\theta_0", "masking: angle at which it sets in", 0.2, -1.0, 1.5, unit="rad"),
    DIFFUSE,
)


def fresnel_term(cos_d: Real, F0: Real, F1: Real) -> Real:
    """``F0 - F1 cos_d + (1 - F0)(1 - cos_d)^5``: Schlick's form with a slope.

    Not confined to [0, 1], nor positive within the bounds; to renderers a negative BRDF is 0.
    """
    return F0 - F1 * cos_d + (1 - F0) * (1 - cos_d) ** 5


def masking(theta: Real, Lambda: Real, c: Real, k: Real, theta0: Real) -> Real:
    """G1 in [0, 1]: ``clip(1 + Lambda (1 - exp(c max(0, theta - theta0)^k)), 0, 1)``.

    The inner exponent is formed as ``exp(log c + k log(theta - theta0))``, as published c reach 1e109 and k 855.
    """
    past = theta > theta0
    log_exponent = jnp.log(c) + k * jnp.log(jnp.where(past, theta - theta0, 1.0))
    exponent = jnp.where(past, jnp.exp(jnp.minimum(log_exponent, LARGEST_LOG_EXPONENT)), 0.0)
    return jnp.maximum(0.0, 1 - Lambda * jnp.expm1(exponent))


@dataclass(frozen=True)
class ShiftedGamma(OneFormula):
    """``(k_d + k_s F D G1(i) G1(o) / (cos_i cos_o)) / pi``, every parameter per channel, as published.

    D is :func:`merlfit.model.ndf.sgd.D`: the published K is what normalises it, and no parameter here. The 1/cos is the
    paper's own and is not held back where the fitted masking leaves off, so values at the horizon may be large.
    Reciprocal. Accuracy: 1e-9 against an independent oracle (``tests/rivals/test_rivals.py``); with the published
    parameters the median errors over MERL are RMSE 0.049, sMAPE 0.134 (``tests/rivals/test_published.py``).
    """

    name: ClassVar[str] = "sgd"
    citation: ClassVar[str] = (
        "Bagher, Soler & Holzschuch 2012, Accurate fitting of measured reflectances using a Shifted Gamma micro-facet "
        "distribution, doi:10.1111/j.1467-8659.2012.03147.x"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return PARAMETERS

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g = s.geometry
        F = fresnel_term(g.cos_d, v["F0"], v["F1"])
        G = [masking(theta, v["Lambda"], v["c"], v["k"], v["theta0"]) for theta in (g.theta_i, g.theta_o)]
        return v["albedo"] * F * sgd.D(g.theta_h, v["alpha"], v["p"]) * G[0] * G[1] / (jnp.pi * g.cos_i * g.cos_o)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])
