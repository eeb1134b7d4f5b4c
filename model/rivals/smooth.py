"""The smooth-surface (ABC) model of Loew, Kronander, Ynnerman & Unger 2012 (doi:10.1145/2077341.2077350)."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..body import lambert
from ..fresnel import fresnel_of_dielectric
from ..geometry import Geometry
from ..numerics import Real, safe_sqrt
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Setting, Values
from .common import DIFFUSE, LOEW_ETA, LOEW_PAPER

C_ = Parameter("C", "C", "falloff exponent of the lobe's tail", "1", 1.0, 1e-2, 10.0, source="Loew et al. 2012",
               prior=LogNormal(0.8, 2.5))  # fmt: skip


def lobe(squared: Real, B: Real, C: Real) -> Real:
    """The ABC function ``(1 + B x)^-C`` of a non-negative ``x``."""
    return jnp.exp(-C * jnp.log1p(B * squared))


def facet_cosine(geometry: Geometry) -> Real:
    """``sqrt(1 - |i_p - o_p|^2 / 4)`` of the projected directions (Loew et al. Eq. 14).

    Formed as ``sqrt(cos_d^2 + (cos_i - cos_o)^2 / 4)``, the same thing without cancellation.
    """
    return safe_sqrt(geometry.cos_d**2 + (geometry.cos_i - geometry.cos_o) ** 2 / 4)


@dataclass(frozen=True)
class Smooth(OneFormula):
    """``k_d / pi + A F (1 + B D_p^2)^-C``, ``D_p`` the length of i + o projected (Loew et al. Eq. 10-14).

    F is the Fresnel reflectance of a dielectric of index eta at :func:`facet_cosine`; there is no masking. Reciprocal.
    Accuracy: 1e-9 against an independent oracle (``tests/rivals/test_rivals.py``); with the published parameters the
    median errors over MERL are RMSE 0.045, sMAPE 0.100 (``tests/rivals/test_published.py``).
    """

    name: ClassVar[str] = "smooth"
    citation: ClassVar[str] = LOEW_PAPER

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            Parameter("B", "B", "inverse square of the lobe's width", "1", 3e3, 1e-1, 1e8, source="Loew et al. 2012",
                      prior=LogNormal(1e3, 20.0)),
            C_, LOEW_ETA,
            Parameter("A", "A", "height of the lobe", "1/sr", 50.0, 1e-3, 1e5, per_channel=True,
                      source="Loew et al. 2012", prior=LogNormal(20.0, 10.0)),
            DIFFUSE,
        )  # fmt: skip

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g = s.geometry
        projected = 2 * g.cos_d * jnp.sin(g.theta_h)  # length of (i + o), |i + o| sin theta_h
        return v["A"] * fresnel_of_dielectric(facet_cosine(g), v["eta"]) * lobe(projected**2, v["B"], v["C"])

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])
