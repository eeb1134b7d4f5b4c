"""Reflection and diffraction side by side: the model of Holzschuch & Pacanowski 2015 (INRIA RR-8807), 15 parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from .. import parameters as declared
from ..acquisition import epd_of_rings
from ..body import lambert
from ..fresnel import schlick_of_F0
from ..masking import smith
from ..ndf.epd import epd
from ..numerics import Real
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values
from .common import DIFFUSE

SOURCE = "HP15 Eq. 24-27"
PARAMETERS = (
    *declared.SURFACE,
    Parameter("a", "a", "width of the diffraction lobe, a spatial frequency", "1/um", 0.9, 1e-2, 50.0, source=SOURCE,
              prior=LogNormal(0.8, 3.0)),
    Parameter("k_s", "k_s", "weight of the reflected light", "1", 0.5, 0.0, 2.0, "linear", per_channel=True,
              source=SOURCE),
    Parameter("F0", "F_0", "reflectance of a facet at normal incidence", "1", 0.5, 0.02, 1.2, "linear",
              per_channel=True, source="HP15 Section 5.8"),
    Parameter("k_w", "k_w", "weight of the diffracted light, at a wavelength of 1 um", "1", 5e-3, 1e-6, 1.0,
              per_channel=True, source=SOURCE, prior=LogNormal(5e-3, 5.0)),
    DIFFUSE,
)  # fmt: skip


def diffraction_lobe(f: Real, a: Real, wavelength_um: Real) -> Real:
    """S_z(f) / E (HP15 Eq. 17, 25), a BRDF of albedo one (1/sr) where it has the whole disc of projected directions.

    E = Int S_z over the disc = pi / (1 + 1/(a lambda)^2); HP15 prints the inverse of the bracket, which normalises
    nothing.
    """
    return (1 + 1 / (a * wavelength_um) ** 2) / jnp.pi / (1 + (f / a) ** 2) ** 2


@dataclass(frozen=True)
class HP15(Reflectance):
    """k_d / pi + G (k_s D F / (4 cos_i cos_o) + k_w / lambda^4 S_z(f) / E), f = 2 sin_h cos_d / lambda (HP15 24-27).

    D is the exponential power distribution with sigma for beta, G Smith's, F Schlick's; F is not applied to diffracted
    light. Reciprocal. Accuracy: 1e-8 against an independent oracle (``tests/rivals/test_hp15.py``).
    """

    name: ClassVar[str] = "hp15"
    citation: ClassVar[str] = (
        "Holzschuch & Pacanowski 2015, A physically accurate reflectance model combining reflection and diffraction, "
        "INRIA RR-8807, https://inria.hal.science/hal-01224702"
    )

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return {"specular": lambda v, middle_um: epd_of_rings(v["beta"], v["p"]), "diffracted": None}

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        return PARAMETERS

    def factors(self) -> dict[str, Factor]:  # noqa: D102
        return {
            "masking": _masking,
            "distribution": lambda v, s: epd(s.geometry.theta_h, v["beta"], v["p"]) / 4,
            "facets": lambda v, s: v["k_s"] * schlick_of_F0(s.geometry.cos_d, v["F0"]),
            "diffracted": _diffracted,
            "body": lambda v, s: lambert(v["diffuse_albedo"]),
        }

    def tables(self, scattered: bool = False) -> dict[str, Factor]:  # noqa: D102
        return {"masking_curve": lambda v, s: smith.masking_table(v["p"])}

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        reflected = at["facets"] * at["distribution"] / (s.geometry.cos_i * s.geometry.cos_o)
        return Lobes({"specular": reflected, "diffracted": at["diffracted"]}, at["masking"], at["body"])


def _masking(v: Values, s: Setting) -> Array:
    """G1(i) G1(o)."""
    one, other = (
        smith.masking(cos, v["beta"], v["p"], v.get("masking_curve")) for cos in (s.geometry.cos_i, s.geometry.cos_o)
    )
    return one * other


def _diffracted(v: Values, s: Setting) -> Array:
    """k_w / lambda^4 S_z / E."""
    f = 2 * jnp.sin(s.geometry.theta_h) * s.geometry.cos_d / s.wavelength_um
    return v["k_w"] / s.wavelength_um**4 * diffraction_lobe(f, v["a"], s.wavelength_um)
