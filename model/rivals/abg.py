"""The ABg model of optical scatter."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Setting, Values
from .scatter import Scatter

SOURCE = "Pfisterer 2011"


@dataclass(frozen=True)
class ABg(Scatter):
    """A / (B + x^g), A per channel.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "abg"
    citation: ClassVar[str] = (
        "Pfisterer 2011, Approximated scatter models for stray light analysis, "
        "https://photonengr.com/wp-content/uploads/2014/10/ApproximatedScatter1.pdf"
    )

    @property
    def scatter(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Scatter`, like what follows
        return (
            Parameter("B", "B", "x^g at which the lobe has fallen to half", "1", 1e-3, 1e-14, 10.0, source=SOURCE,
                      prior=LogNormal(1e-2, 30.0)),
            Parameter("g", "g", "falloff exponent of the tail", "1", 2.0, 0.1, 8.0, source=SOURCE,
                      prior=LogNormal(2.0, 1.6)),
            Parameter("A", "A", "height of the tail", "1/sr", 1e-2, 1e-12, 1e3, per_channel=True, source=SOURCE,
                      prior=LogNormal(1e-2, 30.0)),
        )  # fmt: skip

    def lobe(self, x: Array, v: Values, s: Setting) -> Array:  # noqa: D102
        off = x > 0
        return v["A"] / (v["B"] + jnp.where(off, jnp.exp(v["g"] * jnp.log(jnp.where(off, x, 1.0))), 0.0))
