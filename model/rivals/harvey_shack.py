"""Harvey & Shack's shift-invariant model of optical scatter, with a shoulder."""

from dataclasses import dataclass
from typing import ClassVar

from jax import Array

from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Setting, Values
from .abg import ABg
from .scatter import Scatter
from .smooth import lobe

SOURCE = "Harvey 1976"


@dataclass(frozen=True)
class HarveyShack(Scatter):
    """b0 (1 + (x/L)^2)^(-s/2), b0 per channel; s is minus the S of optical design programs.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "harvey-shack"
    citation: ClassVar[str] = (
        "Harvey 1976, Light-scattering characteristics of optical surfaces, doi:10.1117/12.964594; as in "
        + ABg.citation
    )

    @property
    def scatter(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Scatter`, like what follows
        return (
            Parameter("L", "L", "x of the shoulder, where the lobe begins to fall", "1", 0.05, 1e-5, 2.0, source=SOURCE,
                      prior=LogNormal(0.05, 6.0)),
            Parameter("s", "s", "falloff exponent of the tail, -S", "1", 2.0, 0.1, 20.0, source=SOURCE,
                      prior=LogNormal(2.0, 1.8)),
            Parameter("b0", "b_0", "BRDF in the mirror direction", "1/sr", 1.0, 1e-8, 1e7, per_channel=True,
                      source=SOURCE, prior=LogNormal(1.0, 30.0)),
        )  # fmt: skip

    def lobe(self, x: Array, v: Values, s: Setting) -> Array:  # noqa: D102
        return v["b0"] * lobe(x**2, 1 / v["L"] ** 2, v["s"] / 2)
