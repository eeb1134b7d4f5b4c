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

from . import parameters as declared
from . import terms
from .acquisition import epd_of_rings
from .effects import ANY, BODIES, KINDS, TWO_SCALE, Effects, Kind
from .geometry import Geometry
from .masking.smith import masking_table
from .measured import Measured
from .parameters import WAVELENGTHS_UM, Parameter
from .reflectance import (
    Factor,
    Lobes,
    Reflectance,
    Setting,
    Values,
    Wavelengths,
    evaluate,
)
from .terms import WHICH


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

    def tables(self, scattered: bool = False) -> dict[str, Factor]:  # noqa: D102
        found: dict[str, Factor] = {}
        if self.masking != "none":
            found["masking_curve"] = lambda v, s: masking_table(v["p"])
        if self.diffraction != "off" and self.renormalised:
            variance = "variance_curve" if scattered else "relative_variance"
            found[variance] = terms.variance_curve if scattered else terms.relative_variance
        if self._renormalises:
            found["surface_albedo"] = terms.surface_albedo
        if scattered and self.diffraction == "quadrature":
            found["lobe_surface"] = terms.lobe_surface
        if scattered and self.diffraction != "off" and self.split == "conserving":
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
        middle_um = jnp.asarray(wavelengths_um)[np.size(wavelengths_um) // 2]
        return terms.blurred_over_rings(v, self.changed(diffraction="quadrature", order=terms.RING_ORDER), middle_um)

    @property
    def _renormalises(self) -> bool:
        """Whether the conserving split needs the surface's albedo; Cook-Torrance with masking conserves by itself."""
        by_itself = self.body == "none" and self.diffraction == "off" and self.masking != "none"
        return self.split == "conserving" and not by_itself

    def cheap_variant(self, order: int) -> "TwoScale":  # noqa: D102
        if self.diffraction == "exact":
            return self.changed(diffraction="quadrature", order=order)
        return self.changed(order=min(order, self.order))

    @property
    def kind(self) -> Kind:
        """Interface and body."""
        return self.index, self.body

    @property
    def general(self) -> "TwoScale":
        """Effects of which these are a special case, whatever the kind; no material has them."""
        return _general(self)

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
    tables = [*whole.tables(), *whole.tables(scattered=True)]
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
