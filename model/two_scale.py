"""The two-scale reflectance model of Holzschuch & Pacanowski 2017: microfacets that reflect and diffract.

    rho = A_spec rho_CT + rho_CTD + body                                                   (HP17 Eq. 24, 4.5)
    rho_CT = F(theta_d) D(theta_h) G / (4 cos_i cos_o)                                      (Eq. 26)
    rho_CTD = (Q/2) G (1 - A_spec) (S * D)(theta_h)                                         (Eq. 33, Q/2 for Q)
    A_spec = exp(-(4 pi sigma_rel cos_d / lambda)^2)                                        (Eq. 25)

The free split has w (1 - A_spec) for 1 - A_spec, with a weight w per channel.

It is evaluated as factors, each a function of a part of the directions and of a part of the parameters (`terms`):

    rho = masking (undiffracted facets distribution / (cos_i cos_o) + colour diffracted) + body,

undiffracted being A_spec, facets F, distribution D / 4, colour Q/2 or F, diffracted (1 - A_spec) (S * D). On a grid
undiffracted and facets depend on theta_d alone, distribution on theta_h alone, diffracted on both. F is a table that is
computed once for the whole grid, and so is masking, of one variable. The conserving split (:mod:`.energy`) multiplies
lobes and body once more.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from . import energy, terms
from . import parameters as declared
from .acquisition import epd_of_rings
from .effects import ANY, BODIES, TWO_SCALE, Effects, Kind
from .geometry import Geometry
from .masking.smith import masking_table
from .measured import Measured
from .numerics import safe_divide
from .parameters import WAVELENGTHS_UM, Parameter
from .reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values, Wavelengths, evaluate, setting

TABLES = (
    "masking_curve", "facet_reflectance", "relative_variance", "variance_curve", "surface_albedo", "lobe_surface",
    "facet_albedo",
)  # fmt: skip
Term = Callable[[Any, Values, Setting], Array]


@dataclass(frozen=True)
class TwoScale(Effects, Reflectance):
    """A two-scale material by the effects it has; what is not chosen is absent from the compiled program.

    Its fields are those of :class:`merlfit.model.effects.Effects`. Values of a material do for fewer effects as well.
    """

    name: ClassVar[str] = TWO_SCALE
    citation: ClassVar[str] = (
        "Holzschuch & Pacanowski 2017, A two-scale microfacet reflectance model combining reflection and diffraction, "
        "doi:10.1145/3072959.3073621"
    )
    bodies: ClassVar[tuple[str, ...]] = BODIES
    passed_over: ClassVar[frozenset[str]] = (
        Reflectance.passed_over | {q.name for q in declared.TWO_SCALE} | frozenset(TABLES)
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return _parameters(self)

    @property
    def lobes(self) -> Mapping[str, Profile]:  # noqa: D102
        profiles: dict[str, Profile] = {"specular": lambda v, middle_um: epd_of_rings(v["beta"], v["p"])}
        if self.diffraction != "off":
            profiles["diffracted"] = partial(terms.blurred_over_rings, self)
        return profiles

    @property
    def variant(self) -> str:  # noqa: D102
        return " ".join(self.kind) + (", no diffraction" if self.diffraction == "off" else "")

    def factors(self) -> dict[str, Factor]:  # noqa: D102
        chosen: dict[str, Term] = {} if self.masking == "none" else {"masking": terms.masking_G}
        chosen |= {"facets": terms.facets, "distribution": terms.distribution}
        if self.diffraction != "off":
            exact = self.diffraction == "exact"
            chosen |= {
                "undiffracted": terms.undiffracted,
                "diffracted": terms.exact_diffracted if exact else terms.diffracted,
            }
            if not exact and self.colour != "fresnel":
                chosen["colour"] = terms.diffraction_colour_Q
        if self.body != "none":
            chosen["body"] = terms.body_term
        if self._renormalises:
            chosen["conservation"] = TwoScale.conservation
        return {name: partial(term, self) for name, term in chosen.items()}

    def tables(self, scattered: bool = False) -> dict[str, Factor]:  # noqa: D102
        chosen: dict[str, Term] = {}
        if self.masking != "none":
            chosen["masking_curve"] = lambda e, v, s: masking_table(v["p"])
        if not scattered:
            chosen["facet_reflectance"] = terms.facet_reflectance
        if self.diffraction != "off" and self.renormalised:
            variance = "variance_curve" if scattered else "relative_variance"
            chosen[variance] = terms.variance_curve if scattered else terms.relative_variance
        if self._renormalises:
            chosen["surface_albedo"] = TwoScale.surface_albedo
        if scattered and self.diffraction == "quadrature":
            chosen["lobe_surface"] = terms.lobe_surface
        if self.diffraction != "off" and self.split == "conserving":
            chosen["facet_albedo"] = terms.facet_albedo
        return {name: partial(term, self) for name, term in chosen.items()}

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        mirror = at["facets"] * at["undiffracted"] if "undiffracted" in at else at["facets"]
        sharp = {"specular": mirror * at["distribution"] / (s.geometry.cos_i * s.geometry.cos_o)}
        if "diffracted" in at:
            colour = at["facets"] if self.colour == "fresnel" else at.get("colour", 1.0)
            sharp["diffracted"] = colour * at["diffracted"]
        common, body = at.get("masking"), at.get("body")
        if "conservation" in at:
            kept, through = at["conservation"][0], at["conservation"][1:]
            common = kept if common is None else common * kept
            body = None if body is None else through[0] * body
        return Lobes(sharp, common, body)

    @property
    def _renormalises(self) -> bool:
        """Whether the conserving split needs the surface's albedo; Cook-Torrance with masking conserves by itself."""
        by_itself = self.body == "none" and self.diffraction == "off" and self.masking != "none"
        return self.split == "conserving" and not by_itself

    def surface_albedo(self, v: Values, s: Setting) -> Array:
        """Directional albedo of the lobes at :func:`merlfit.model.energy.incidences`, (C, INCIDENCES).

        Args:
            v: parameters, those per channel as ``(C,)`` or with more axes of length one.
        """
        wavelengths_um = s.wavelength_um.reshape(-1)
        inner = self.changed(order=min(energy.ORDER, self.order))
        read = {q.name: v[q.name] for q in self.parameters if q.name != declared.ALBEDO.name}
        values = {name: x.reshape((-1, 1, 1, 1)) if jnp.ndim(x) else x for name, x in read.items()}
        shared = {name: f(v, s) for name, f in inner.tables(scattered=True).items() if name != "surface_albedo"}
        largest_B = 2 * v["b"] / jnp.min(wavelengths_um) if "b" in v else jnp.ones(())
        nodes = energy.slopes(*jax.lax.stop_gradient((v["beta"], v["p"], largest_B)))  # they need no derivative

        def at(incidence: Array) -> Array:  # of one at a time, whose intermediates stay in a core's cache
            geometry, measure = energy.half_vectors(incidence[None], *nodes)
            seen, known = setting(geometry, wavelengths_um), {**values, **shared}
            lobes = {n: f(known, seen) for n, f in inner.factors().items() if n not in ("body", "conservation")}
            return jnp.sum(inner.assemble(lobes, seen).brdf(seen) * measure, (1, 2, 3))

        return jax.lax.map(at, energy.incidences(v["beta"])).T

    def conservation(self, v: Values, s: Setting) -> Array:
        """What the lobes are multiplied by (0) and what the body is multiplied by (1), stacked: see `energy`."""
        table = v["surface_albedo"] if "surface_albedo" in v else self.surface_albedo(v, s)
        g, masked = s.geometry, self.masking != "none"
        lit, seen = (energy.at_incidence(table, v["beta"], theta, masked) for theta in (g.theta_i, g.theta_o))
        kept = 1 / (jnp.maximum(lit, 1.0) * jnp.maximum(seen, 1.0))
        if self.body == "none":
            return kept[None]
        through = jnp.maximum(1 - lit, 0.0) * jnp.maximum(1 - seen, 0.0)
        mean = energy.mean_transmittance(table, v["beta"], masked).reshape((-1,) + (1,) * (through.ndim - 1))
        return jnp.stack([kept, safe_divide(through, mean)])

    @property
    def kind(self) -> Kind:
        """Interface and body."""
        return self.index, self.body

    @property
    def general(self) -> "TwoScale":
        """Effects of which these are a special case, whatever the kind; no material has them."""
        return self if self.split == "conserving" else _general(self)


@cache
def _general(model: TwoScale) -> TwoScale:
    return replace(model, index="film" if model.index == "film" else "complex", body=ANY)


@cache
def _parameters(model: TwoScale) -> tuple[Parameter, ...]:
    shared = declared.SURFACE + (() if model.diffraction == "off" else declared.DIFFRACTION)
    if not model.renormalised:  # all height diffracts into directions that exist
        shared = tuple(replace(q, shift=None) if q.name == "sigma_s" else q for q in shared)
    interface = declared.INTERFACE if model.index == "real" else declared.CONDUCTOR
    shared += declared.FILM if model.index == "film" else ()
    weight = (declared.WEIGHT,) if model.split == "free" else ()
    return shared + weight + interface + (() if model.body == "none" else (declared.ALBEDO,))


def two_scale(
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    model: TwoScale | Measured,
    wavelengths_um: Wavelengths = WAVELENGTHS_UM,
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
