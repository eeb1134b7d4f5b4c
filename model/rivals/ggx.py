"""Cook & Torrance's model with the GGX distribution of Walter et al. 2007 over a Lambert body."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..body import lambert
from ..numerics import Real, Scalar
from ..parameters import ALBEDO, LogNormal, Parameter
from ..reflectance import OneFormula, Setting, Values


def D(theta_h: Real, alpha: Scalar) -> Real:
    """Distribution of normals (1/sr), alpha^2 / (pi cos^4 (alpha^2 + tan^2)^2) (Walter et al. 2007, Eq. 33).

    Args:
        theta_h: angle between microfacet and surface normal (rad). alpha: width (tangent of an angle), > 0.

    Its integral of D cos over the hemisphere is 1 to 1e-9 (``tests/fitting/test_models.py``).
    """
    sin, cos = jnp.sin(theta_h), jnp.cos(theta_h)
    return alpha**2 / (jnp.pi * (alpha**2 * cos**2 + sin**2) ** 2)


def G1(cos: Real, alpha: Scalar) -> Real:
    """Smith's masking of one direction whose cosine with the normal is ``cos`` > 0 (Walter et al. 2007, Eq. 34)."""
    return 2 * cos / (cos + jnp.sqrt(alpha**2 + (1 - alpha**2) * cos**2))


@dataclass(frozen=True)
class GGX(OneFormula):
    """F D G / (4 cos_i cos_o) + rho_d / pi, F by Schlick's polynomial from F0 (per channel).

    Accuracy: 1e-11 against an independent oracle (``tests/fitting/test_models.py``).
    """

    name: ClassVar[str] = "ggx"
    citation: ClassVar[str] = (
        "Walter, Marschner, Li & Torrance 2007, Microfacet models for refraction through rough surfaces, "
        "doi:10.2312/EGWR/EGSR07/195-206"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        width = "width of the distribution of microfacet normals"
        return (
            Parameter("alpha", r"\alpha", width, "1", 0.1, 1e-3, 1.0, source="Walter et al. 2007, Eq. 33",
                      prior=LogNormal(0.05, 5.0)),
            Parameter("F0", "F_0", "reflectance of a facet at normal incidence", "1", 0.05, 0.0, 1.0, "linear",
                      per_channel=True, source="Schlick 1994", quantity="odds"),
            ALBEDO,
        )  # fmt: skip

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g, alpha = s.geometry, v["alpha"]
        F = v["F0"] + (1 - v["F0"]) * (1 - g.cos_d) ** 5
        return F * D(g.theta_h, alpha) * G1(g.cos_i, alpha) * G1(g.cos_o, alpha) / (4 * g.cos_i * g.cos_o)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["albedo"])
