"""What microfacet models have in common: Cook & Torrance's formula, a Fresnel term and a Lambert body."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from jax import Array

from .. import parameters as declared
from ..body import lambert
from ..fresnel import fresnel, fresnel_of_dielectric, schlick_of_F0
from ..masking import smith_numeric
from ..masking.v_groove import v_groove
from ..parameters import Parameter
from ..reflectance import Factor, Lobes, Reflectance, Setting, Values

F0 = Parameter("F0", "F_0", "reflectance of a facet at normal incidence", "1", 0.05, 0.0, 1.0, "linear",
               per_channel=True, source="Schlick 1994", quantity="odds")  # fmt: skip
INTERFACES = {"schlick": (F0,), "dielectric": declared.INTERFACE, "conductor": declared.CONDUCTOR}


@dataclass(frozen=True)
class Microfacets(Reflectance):
    """F D G / (4 cos_i cos_o) + rho_d / pi (Cook & Torrance 1982 with the 4 of later papers).

    Subclasses, a file each, say what D is, and what Smith's G1.

    Attributes:
        fresnel: ``schlick`` (from F0 per channel), or exact, of a ``dielectric`` (eta per channel) or a ``conductor``
            (n and k per channel).
        masking: ``smith``, G1(i) G1(o); ``v-groove`` (Torrance & Sparrow 1967); ``none`` (1).
    """

    fresnel: Literal["schlick", "dielectric", "conductor"] = "schlick"
    masking: Literal["smith", "v-groove", "none"] = "smith"

    @property
    @abstractmethod
    def widths(self) -> tuple[Parameter, ...]:
        """Parameters of the distribution of normals, of all channels alike."""

    @abstractmethod
    def D(self, theta_h: Array, v: Values) -> Array:
        """Distribution of normals (1/sr)."""

    @abstractmethod
    def G1(self, cos: Array, v: Values) -> Array:
        """Smith's masking of directions whose cosine with the normal is ``cos`` > 0."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (*self.widths, *INTERFACES[self.fresnel], declared.ALBEDO)

    def facets(self, v: Values, s: Setting) -> Array:
        """Reflectance F(theta_d) of the facets."""
        if self.fresnel == "schlick":
            return schlick_of_F0(s.geometry.cos_d, v["F0"])
        if self.fresnel == "dielectric":
            return fresnel_of_dielectric(s.geometry.cos_d, v["eta"])
        return fresnel(s.geometry.cos_d, v["n"], v["k"])

    def masked(self, v: Values, s: Setting) -> Array:
        """G(i, o) / (4 cos_i cos_o)."""
        g = s.geometry
        if self.masking == "none":
            return 1 / (4 * g.cos_i * g.cos_o)
        G = v_groove(g) if self.masking == "v-groove" else self.G1(g.cos_i, v) * self.G1(g.cos_o, v)
        return G / (4 * g.cos_i * g.cos_o)

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        return {
            "facets": self.facets,
            "distribution": lambda v, s: self.D(s.geometry.theta_h, v),
            "masked": self.masked,
            "body": lambda v, s: lambert(v["albedo"]),
        }

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        return Lobes({"specular": at["facets"] * at["distribution"]}, at["masked"], at["body"])


@dataclass(frozen=True)
class NumericMasking(Microfacets):
    """Microfacets whose Smith masking has no closed form: by quadrature, tabulated once a parameter set."""

    @abstractmethod
    def slopes(self, squared: Array, v: Values) -> Array:
        """Density P22 of slopes at their squares."""

    @abstractmethod
    def slope(self, v: Values) -> Array:
        """A typical slope."""

    def tables(self, scattered: bool = False) -> dict[str, Factor]:  # noqa: D102
        return {"masking_curve": lambda v, s: self._curve(v)} if self.masking == "smith" else {}

    def _curve(self, v: Values) -> Array:
        return smith_numeric.G1_table(self.slope(v), lambda squared: self.slopes(squared, v))

    def G1(self, cos: Array, v: Values) -> Array:  # noqa: D102
        return smith_numeric.G1(cos, self.slope(v), v["masking_curve"] if "masking_curve" in v else self._curve(v))
