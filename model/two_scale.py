"""The two-scale reflectance model of Holzschuch & Pacanowski 2017: microfacets that reflect and diffract.

    rho = A_spec rho_CT + rho_CTD + body                                                   (HP17 Eq. 24, 4.5)
    rho_CT = F(theta_d) D(theta_h) G / (4 cos_i cos_o)                                      (Eq. 26)
    rho_CTD = (Q/2) G (1 - A_spec) (S * D)(theta_h)                                         (Eq. 33, Q/2 for Q)
    A_spec = exp(-(4 pi sigma_rel cos_d / lambda)^2)                                        (Eq. 25)

It is evaluated as factors, each a function of a part of the directions and of a part of the parameters (`terms`):

    rho = masking (specular / (cos_i cos_o) + colour diffracted) + body,

specular being A_spec F D / 4, colour Q/2, diffracted (1 - A_spec) (S * D). On a grid specular and diffracted live on
(theta_h, theta_d) alone and masking is a one-dimensional table. The conserving split (:mod:`merlfit.model.energy`)
multiplies lobes and body once more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from . import body as bodies
from . import derived as derivation
from . import parameters as declared
from . import plausible, terms
from .acquisition import epd_of_rings
from .effects import ANY, BODIES, KINDS, TWO_SCALE, Effects, Kind
from .fresnel import fresnel, schlick
from .geometry import Geometry
from .interfaces import DIELECTRICS, METALS, fresnel_of_dielectric, schlick_of_dielectric
from .masking.smith import masking_table
from .measured import Measured
from .ndf.epd import HALF
from .parameters import WAVELENGTHS_UM, Parameter
from .reflectance import (
    Clues,
    Factor,
    Lobes,
    Quantity,
    Reflectance,
    Separated,
    Setting,
    Values,
    Wavelengths,
    evaluate,
)
from .terms import WHICH

TYPICAL = {"p": 1.0, "b": 2.0, "c": 1.5, "sigma_s": 0.03}  # where fits start
BODY_BRDF = {
    "none": None, "lambert": bodies.lambert_of, "plastic": bodies.plastic, "subsurface": bodies.subsurface,
}  # fmt: skip
PERFECT = (("n", 0.0), ("k", 1.0))  # index of facets that reflect everything


@dataclass(frozen=True)
class TwoScale(Effects, Reflectance):
    """A two-scale material by the effects it has; what is not chosen is absent from the compiled program.

    Its fields are those of :class:`merlfit.model.effects.Effects`.
    """

    name: ClassVar[str] = TWO_SCALE
    citation: ClassVar[str] = (
        "Holzschuch & Pacanowski 2017, A two-scale microfacet reflectance model combining reflection and diffraction, "
        "doi:10.1145/3072959.3073621"
    )
    bodies: ClassVar[tuple[str, ...]] = BODIES

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return _parameters(self)

    @property
    def lobes(self) -> tuple[str, ...]:  # noqa: D102
        return ("specular",) if self.diffraction == "off" else ("specular", "diffracted")

    @property
    def variant(self) -> str:  # noqa: D102
        return " ".join(self.kind)

    @classmethod
    def variants(cls) -> "tuple[TwoScale, ...]":  # noqa: D102
        return tuple(cls(body, index=index) for index, body in KINDS)

    @property
    def words(self) -> str:  # noqa: D102
        interface = "conductor" if self.index == "complex" else "dielectric"
        return f"{self.name}, {interface}" + ("" if self.body == "none" else f" over {self.body}")

    @property
    def details(self) -> tuple[str, ...]:  # noqa: D102
        return f"diffraction by {self.diffraction}", f"energy split {self.split}"

    @property
    def objection(self) -> str | None:  # noqa: D102
        if self.body == ANY:
            return f"body should be {', '.join(BODIES)}, not {ANY!r}"
        if self.diffraction == "exact":
            return "diffraction 'exact' is a reference that takes hours; no fit uses it"
        return None

    def of_matter(self, v: Mapping[str, np.ndarray]) -> bool:  # noqa: D102
        return plausible.of_matter(v)

    def cautions(  # noqa: D102
        self, v: Mapping[str, np.ndarray], channels: Sequence[str], wavelengths_um: Sequence[float]
    ) -> list[str]:
        return plausible.cautions(v, channels, wavelengths_um)

    @property
    def quantities(self) -> tuple[Quantity, ...]:  # noqa: D102
        return derivation.quantities(self)

    def derived(self, v: Values, wavelengths_um: Wavelengths = WAVELENGTHS_UM) -> dict[str, Array]:  # noqa: D102
        return derivation.derived(v, self, wavelengths_um)

    def factors(self) -> dict[str, Factor]:  # noqa: D102
        diffracts = self.diffraction != "off"
        table: dict[str, Factor] = {} if self.masking == "none" else {"masking": terms.masking_G}
        table["specular"] = terms.undiffracted if diffracts else terms.specular
        if diffracts:
            exact = self.diffraction == "exact"
            table["diffracted"] = terms.exact_diffracted if exact else terms.diffracted
            if not exact or self.colour == "fresnel":
                table["colour"] = terms.diffraction_colour_Q
        if self.body != "none":
            table["body"] = terms.body_term
        if self._renormalises:
            table["conservation"] = terms.conservation
        return table

    def tables(self) -> dict[str, Factor]:  # noqa: D102
        found: dict[str, Factor] = {}
        if self.masking != "none":
            found["masking_curve"] = lambda v, s: masking_table(v["p"])
        if self.diffraction != "off" and self.renormalised:
            found["relative_variance"] = terms.relative_variance
        if self._renormalises:
            found["surface_albedo"] = terms.surface_albedo
        return found

    def curves(self) -> dict[str, Factor]:  # noqa: D102
        found = self.tables()
        if found.pop("relative_variance", None):
            found["variance_curve"] = terms.variance_curve
        if self.diffraction == "quadrature":
            found["lobe_surface"] = terms.lobe_surface
        if self.diffraction != "off" and self.split == "conserving":
            found["facet_albedo"] = terms.facet_albedo
        return found

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        sharp = {"specular": at["specular"] / (s.geometry.cos_i * s.geometry.cos_o)}
        if "diffracted" in at:
            sharp["diffracted"] = at["colour"] * at["diffracted"] if "colour" in at else at["diffracted"]
        common, body = at.get("masking"), at.get("body")
        if "conservation" in at:
            kept, through = at["conservation"][0], at["conservation"][1:]
            common = kept if common is None else common * kept
            body = None if body is None else through[0] * body
        return Lobes(sharp, common, body)

    def profile(self, lobe: str, v: Values, wavelengths_um: Wavelengths = WAVELENGTHS_UM) -> Array:  # noqa: D102
        if lobe == "specular":
            return epd_of_rings(v["beta"], v["p"])
        return terms.blurred_over_rings(v, self, jnp.asarray(wavelengths_um)[np.size(wavelengths_um) // 2])

    @property
    def _renormalises(self) -> bool:
        """Whether the conserving split needs the surface's albedo; Cook-Torrance with masking conserves by itself."""
        by_itself = self.body == "none" and self.diffraction == "off" and self.masking != "none"
        return self.split == "conserving" and not by_itself

    def coarse(self, order: int) -> "TwoScale":  # noqa: D102
        return self.changed(order=min(order, self.order))

    def stand_in(self, order: int) -> "TwoScale":  # noqa: D102
        if self.diffraction == "exact":
            return self.changed(diffraction="quadrature", order=order)
        return self.coarse(order)

    @property
    def kind(self) -> Kind:
        """Interface and body."""
        return self.index, self.body

    def starts(self, clues: Clues, middle_um: float) -> list[dict[str, float]]:
        """The measured highlight may be the facets' lobe, or diffracted light.

        A diffraction lobe's half width is where 2 tan(theta_h) / lambda = 1 / b.
        """
        first = {**TYPICAL, "beta": clues.half_width / float(np.exp(HALF / TYPICAL["p"]))}
        if self.diffraction == "off":
            return [{name: first[name] for name in ("beta", "p")}]
        return [first, {**first, "b": middle_um / (2 * clues.half_width)}]

    @property
    def basins(self) -> dict[str, int]:  # noqa: D102
        return {"beta": 3, "p": 2, **({} if self.diffraction == "off" else {"sigma_s": 2})}

    @property
    def separated(self) -> Separated | None:
        """Nearly: with F instead of Q for the colour of diffracted light."""
        exact, real = self.fresnel == "exact", self.index == "real"
        of_metal, of_dielectric = (fresnel, fresnel_of_dielectric) if exact else (schlick, schlick_of_dielectric)
        lobes = self.changed(body="none", index="complex", colour="fresnel", split="printed")
        return Separated(
            lobes, PERFECT, DIELECTRICS if real else METALS, of_dielectric if real else of_metal,
            real, BODY_BRDF[self.body], "eta" if self.body in ("plastic", "subsurface") else None,
        )  # fmt: skip

    @property
    def sought(self) -> "TwoScale":
        """With the printed split of energy: the conserving one costs a hundred times as much."""
        return replace(self, split="printed")

    @property
    def general(self) -> "TwoScale":
        """Effects of which these are a special case, whatever the kind; no material has them.

        A dielectric is a conductor with k = 0, and which body it is, is said by a number when the program runs
        (:meth:`generalised`). The conserving split treats kinds too differently.
        """
        return _general(self)

    def generalised(self, values: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:  # noqa: D102
        given = dict(values)
        if self.general == self:
            return given
        if self.index == "real":
            given["n"] = given.pop("eta")
            given["k"] = np.zeros_like(given["n"])
        if self.body == "none":
            given["albedo"] = np.zeros_like(given["n"])
        return given | {WHICH: np.int32(BODIES.index(self.body))}

    def in_general(self, name: str) -> str:  # noqa: D102
        return "n" if name == "eta" and self.general != self else name

    @property
    def switches(self) -> dict[str, int]:  # noqa: D102
        return {WHICH: 0} if self.body == ANY else {}

    def ignored(self) -> frozenset[str]:  # noqa: D102
        return super().ignored() | _names_of_all()


@cache
def _general(model: TwoScale) -> TwoScale:
    return model if model.split == "conserving" else replace(model, index="complex", body=ANY)


@cache
def _parameters(model: TwoScale) -> tuple[Parameter, ...]:
    shared = declared.SURFACE + (() if model.diffraction == "off" else declared.DIFFRACTION)
    if not model.renormalised:  # all height diffracts into directions that exist
        shared = tuple(replace(q, shift=None) if q.name == "sigma_s" else q for q in shared)
    interface = declared.CONDUCTOR if model.index == "complex" else declared.INTERFACE
    return shared + interface + (() if model.body == "none" else (declared.ALBEDO,))


@cache
def _names_of_all() -> frozenset[str]:
    """Names that parameters and tables may have, so that values of a material do for fewer effects as well."""
    every = [TwoScale(body, index=index) for index, body in KINDS]
    whole = TwoScale("lambert", split="conserving")
    tables = [*whole.tables(), *whole.curves()]
    return frozenset([*(q.name for model in every for q in model.parameters), *tables])


def two_scale(
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    model: TwoScale | Measured,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
) -> Array:
    """BRDF (1/sr) of a two-scale material for any directions and any number of wavelengths.

    Args:
        params: values by name, those of ``model.parameters``: scalars, and arrays of shape ``(C,)`` for those that
            are per channel.
        geometry: directions, scattered or as a broadcast grid.
        model: which effects to simulate (static), of the material alone or as an apparatus sees it.
        wavelengths_um: shape ``(C,)``, in micrometres.

    Returns:
        shape ``(C, *broadcast shape of geometry)``; 0 where light or viewer are below the surface.

    Raises:
        KeyError: a parameter of the model is missing from ``params``, or one there belongs to no set of effects.

    Reciprocal in light and viewer for every choice of effects. Differentiable in every parameter, with finite gradients
    at the horizon, at theta_h = 0 and for i = o; the conserving split has kinks where an excess begins. Accuracy: that
    of the tier (``docs/effects.md``); the conserving split's tables 5e-4; everything else 1e-8.
    """
    return evaluate(model, params, geometry, wavelengths_um)
