"""Oren & Nayar's qualitative model of rough matte surfaces: Lambertian facets in symmetric V-cavities."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..parameters import ALBEDO, Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Setting, Values

PAPER = "Oren & Nayar 1994, Generalization of Lambert's reflectance model, doi:10.1145/192161.192213"
ROUGHNESS = Parameter("roughness", r"\sigma", "standard deviation of the facets' slope angle", "rad", 0.3, 1e-3, 1.5,
                      source="Oren & Nayar 1994, Eq. 17", prior=LogNormal(0.3, 2.5))  # fmt: skip

WEIGHT = Parameter("k_s", "k_s", "weight of the surface's reflection", "1", 0.05, 1e-5, 10.0, per_channel=True,
                   source="Oren & Nayar 1994, Section 4", prior=LogNormal(0.03, 6.0))  # fmt: skip


@dataclass(frozen=True)
class OrenNayarQualitative(OneFormula):
    """albedo/pi (A + B max(0, cos(phi_i - phi_o)) sin(alpha) tan(beta)), without interreflection (1994, Eq. 17).

    A = 1 - s^2 / (2 (s^2 + 0.33)), B = 0.45 s^2 / (s^2 + 0.09), s the roughness, alpha and beta the larger and the
    smaller of theta_i and theta_o; sin(alpha) tan(beta) is sin_i sin_o over the larger cosine. Accuracy: 1e-10 against
    an independent oracle (``tests/rivals/test_oren_nayar.py``).
    """

    name: ClassVar[str] = "oren-nayar-qualitative"
    citation: ClassVar[str] = PAPER
    bodies: ClassVar[tuple[str, ...]] = ("rough lambert",)

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (ROUGHNESS, ALBEDO)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g, square = s.geometry, v["roughness"] ** 2
        A, B = 1 - square / (2 * (square + 0.33)), 0.45 * square / (square + 0.09)
        along = jnp.maximum(g.projected_dot, 0.0) / jnp.maximum(g.cos_i, g.cos_o)
        return v["albedo"] / jnp.pi * (A + B * along)
