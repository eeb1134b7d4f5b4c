"""Cook & Torrance's model with Beckmann's distribution over a Lambert body."""

from dataclasses import dataclass
from typing import ClassVar

from jax import Array

from ..ndf import beckmann
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Values
from .microfacets import Microfacets


@dataclass(frozen=True)
class Beckmann(Microfacets):
    """:class:`.microfacets.Microfacets` with D = exp(-tan^2 / m^2) / (pi m^2 cos^4), Smith's G1 (Heitz 2014).

    Accuracy: 4e-8 against an independent oracle (``tests/rivals/test_microfacets.py``).
    """

    name: ClassVar[str] = "beckmann"
    citation: ClassVar[str] = (
        "Cook & Torrance 1982, A reflectance model for computer graphics, doi:10.1145/357290.357293"
    )

    @property
    def widths(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Microfacets`, like what follows
        return (
            Parameter("roughness", "m", "root mean square slope of the facets", "1", 0.1, 1e-3, 1.5,
                      source="Cook & Torrance 1982", prior=LogNormal(0.08, 5.0)),
        )  # fmt: skip

    def D(self, theta_h: Array, v: Values) -> Array:  # noqa: D102
        return beckmann.D(theta_h, v["roughness"])

    def G1(self, cos: Array, v: Values) -> Array:  # noqa: D102
        return beckmann.G1(cos, v["roughness"])
