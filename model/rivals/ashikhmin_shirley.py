"""Ashikhmin & Shirley's Phong model of 2000, isotropic."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..fresnel import schlick_of_F0
from ..numerics import Real
from ..parameters import ALBEDO, Parameter
from ..reflectance import OneFormula, Setting, Values
from .blinn_phong import EXPONENT, power
from .microfacets import F0


def coupled_body(cos_i: Real, cos_o: Real, F0: Real, albedo: Real) -> Real:
    """28 albedo/(23 pi) (1 - F0) (1 - (1 - cos_i/2)^5) (1 - (1 - cos_o/2)^5), 1/sr: what the surface lets through."""
    through = (1 - (1 - cos_i / 2) ** 5) * (1 - (1 - cos_o / 2) ** 5)
    return 28 / (23 * jnp.pi) * albedo * (1 - F0) * through


@dataclass(frozen=True)
class AshikhminShirley(OneFormula):
    """(n + 1)/(8 pi) cos^n theta_h F / (cos_d max(cos_i, cos_o)) and :func:`coupled_body`; F Schlick's of F0.

    The paper's two exponents are one: isotropic. Reciprocal; its albedo is at most 1.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "ashikhmin-shirley"
    citation: ClassVar[str] = (
        "Ashikhmin & Shirley 2000, An anisotropic Phong BRDF model, doi:10.1080/10867651.2000.10487522"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (EXPONENT, F0, ALBEDO)

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g, n = s.geometry, v["exponent"]
        lobe = (n + 1) / (8 * jnp.pi) * power(g.theta_h, n) / (g.cos_d * jnp.maximum(g.cos_i, g.cos_o))
        return schlick_of_F0(g.cos_d, v["F0"]) * lobe

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return coupled_body(s.geometry.cos_i, s.geometry.cos_o, v["F0"], v["albedo"])
