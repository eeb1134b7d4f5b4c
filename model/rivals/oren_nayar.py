"""Rough matte surfaces with interreflection, under a surface that reflects or none (Oren & Nayar 1994)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from jax import Array

from ..body import rough_lambert
from ..masking.v_groove import torrance_sparrow
from ..parameters import ALBEDO, Parameter
from ..reflectance import Profile, Setting, Values
from .oren_nayar_qualitative import ROUGHNESS, WEIGHT, OrenNayarQualitative


@dataclass(frozen=True)
class OrenNayar(OrenNayarQualitative):
    """Eq. 14-16; as near to the integral over facets as `docs/rivals.md` says. Reciprocal.

    Attributes:
        form: the functional one, of the paper's three. surface: ``none``; or ``torrance-sparrow``, k_s exp(-theta_h^2
            / (2 sigma^2)) G / (cos_i cos_o) with V-grooves of the same roughness (Section 4; its k_b is 1 here).
    """

    name: ClassVar[str] = "oren-nayar"
    form: Literal["functional"] = "functional"
    surface: Literal["none", "torrance-sparrow"] = "torrance-sparrow"

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (ROUGHNESS, *(() if self.surface == "none" else (WEIGHT,)), ALBEDO)

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {} if self.surface == "none" else super().lobes

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return v["k_s"] * torrance_sparrow(s.geometry, v["roughness"])

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return rough_lambert(s.geometry, v["roughness"], v["albedo"])
