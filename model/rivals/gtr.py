"""Cook & Torrance's model with the generalised Trowbridge-Reitz distribution (Burley 2012) over a Lambert body."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from ..ndf import gtr
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Values
from .microfacets import NumericMasking


@dataclass(frozen=True)
class GTR(NumericMasking):
    """:class:`.microfacets.Microfacets` with D = c / (alpha^2 cos^2 + sin^2)^gamma (HP15 Table 1); G1 by quadrature.

    Attributes:
        gamma: ``free``, a parameter; or 1, Berry's distribution; or 2, GGX.

    Accuracy: 2e-6 against an independent oracle (``tests/rivals/test_microfacets.py``).
    """

    name: ClassVar[str] = "gtr"
    citation: ClassVar[str] = (
        "Burley 2012, Physically-based shading at Disney, SIGGRAPH course notes, doi:10.1145/2343483.2343493"
    )
    gamma: Literal["free", "1", "2"] = "free"

    @property
    def widths(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Microfacets`, like what follows
        alpha = Parameter("alpha", r"\alpha", "width of the distribution of microfacet normals", "1", 0.1, 1e-3, 0.999,
                          source="HP15 Table 1", prior=LogNormal(0.05, 5.0))  # fmt: skip
        tail = Parameter("gamma", r"\gamma", "falloff exponent of the distribution's tail", "1", 2.0, 0.3, 10.0,
                         source="HP15 Table 1", prior=LogNormal(1.8, 1.6))  # fmt: skip
        return (alpha, tail) if self.gamma == "free" else (alpha,)

    def _gamma(self, v: Values) -> Array | float:
        return v["gamma"] if self.gamma == "free" else float(self.gamma)

    def D(self, theta_h: Array, v: Values) -> Array:  # noqa: D102
        return gtr.D(theta_h, v["alpha"], self._gamma(v))

    def slopes(self, squared: Array, v: Values) -> Array:  # noqa: D102
        return gtr.slopes(squared, v["alpha"], self._gamma(v))

    def slope(self, v: Values) -> Array:
        """alpha, and larger where the tail is heavy."""
        return v["alpha"] ** jnp.clip(jnp.asarray(self._gamma(v)) / 2, 0.1, 1.0)
