"""One generalised cosine lobe of Lafortune et al. 1997 over a Lambert body, isotropic."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..acquisition import RINGS_RAD
from ..body import lambert
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Profile, Setting, Values
from .common import DIFFUSE

SOURCE = "Lafortune et al. 1997"
LARGEST_LOG = 80.0  # a lobe off the mirror direction grows as C^n: beyond this it is no reflectance, but finite


@dataclass(frozen=True)
class Lafortune(OneFormula):
    """rho_d/pi + rho_s (n + 2)/(2 pi) max(0, cos_i cos_o - C (i_x o_x + i_y o_y))^n.

    The paper's C_z is 1 and its C_x = C_y are -C: what scales all three is in rho_s. C = 1 is Phong's lobe about the
    mirror direction, of albedo rho_s along the normal; above 1 it grows towards grazing angles, below 1 it falls.
    Reciprocal.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "lafortune"
    citation: ClassVar[str] = (
        "Lafortune, Foo, Torrance & Greenberg 1997, Non-linear approximation of reflectance functions, "
        "doi:10.1145/258734.258801"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            Parameter("exponent", "n", "exponent of the lobe", "1", 50.0, 0.5, 1e6, source=SOURCE,
                      prior=LogNormal(50.0, 15.0)),
            Parameter("C", "C", "ratio of the lobe's coefficients, -C_x / C_z", "1", 1.0, 0.3, 3.0, source=SOURCE,
                      prior=LogNormal(1.0, 1.2)),
            Parameter("albedo", r"\rho_s", "weight of the specular term", "1", 0.1, 0.0, 2.0, "linear",
                      per_channel=True, source=SOURCE),
            DIFFUSE,
        )  # fmt: skip

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {"specular": lambda v, middle_um: _lobe(jnp.cos(2 * jnp.asarray(RINGS_RAD)), v["exponent"])}

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g, n = s.geometry, v["exponent"]
        aligned = g.cos_i * g.cos_o - v["C"] * g.projected_dot
        return v["albedo"] * (n + 2) / (2 * jnp.pi) * _lobe(aligned, n)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])


def _lobe(aligned: Array, exponent: Array) -> Array:
    lit = aligned > 0
    return jnp.where(lit, jnp.exp(jnp.minimum(exponent * jnp.log(jnp.where(lit, aligned, 1.0)), LARGEST_LOG)), 0.0)
