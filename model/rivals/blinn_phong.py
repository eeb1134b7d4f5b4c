"""Blinn's form of Phong's lobe, a power of the half vector's cosine, normalised."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..body import lambert
from ..numerics import Real, Scalar
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Setting, Values
from .common import DIFFUSE

EXPONENT = Parameter("exponent", "n", "exponent of the half vector's cosine", "1", 100.0, 1.0, 1e6,
                     source="Blinn 1977", prior=LogNormal(200.0, 15.0))  # fmt: skip


def power(theta: Real, exponent: Scalar) -> Real:
    """cos^n of an angle up to a right one; log cos as log(1 - sin^2)/2, which keeps its digits near 0."""
    sin = jnp.sin(theta)
    return jnp.exp(exponent / 2 * jnp.log(jnp.where(sin < 0.5, 1.0, jnp.cos(theta)) ** 2) +
                   exponent / 2 * jnp.log1p(-jnp.where(sin < 0.5, sin, 0.0) ** 2))  # fmt: skip


@dataclass(frozen=True)
class BlinnPhong(OneFormula):
    """rho_d/pi + rho_s (n + 2)(n + 4) / (8 pi (2^(-n/2) + n)) cos^n theta_h.

    So normalised, the lobe gives back rho_s of the light that comes along the normal, and less of any other.
    Reciprocal.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "blinn-phong"
    citation: ClassVar[str] = (
        "Blinn 1977, Models of light reflection for computer synthesized pictures, doi:10.1145/563858.563893"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            EXPONENT,
            Parameter("albedo", r"\rho_s", "weight of the specular term", "1", 0.1, 0.0, 2.0, "linear",
                      per_channel=True, source="Blinn 1977"),
            DIFFUSE,
        )  # fmt: skip

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        n = v["exponent"]
        height = (n + 2) * (n + 4) / (8 * jnp.pi * (jnp.exp2(-n / 2) + n))
        return v["albedo"] * height * power(s.geometry.theta_h, n)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])
