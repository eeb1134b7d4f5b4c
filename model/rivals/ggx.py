"""Cook & Torrance's model with the GGX distribution of Walter et al. 2007 over a Lambert body."""

from dataclasses import dataclass
from typing import ClassVar

from jax import Array

from ..body import lambert
from ..masking.ggx import G1
from ..ndf.ggx import D
from ..parameters import ALBEDO, LogNormal, Parameter
from ..reflectance import OneFormula, Setting, Values


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
