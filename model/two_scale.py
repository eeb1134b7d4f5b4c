"""The two-scale reflectance model of Holzschuch & Pacanowski 2017: microfacets that reflect and diffract.

    rho = A_spec rho_CT + rho_CTD + body                                                   (HP17 Eq. 24, 4.5)
    rho_CT = F(theta_d) D(theta_h) G / (4 cos_i cos_o)                                      (Eq. 26)
    rho_CTD = (Q/2) G (1 - A_spec) (S * D)(theta_h)                                         (Eq. 33, Q/2 for Q)
    A_spec = exp(-(4 pi sigma_rel cos_d / lambda)^2)                                        (Eq. 25)

It is written as a few factors, each a function of a part of the directions and of a part of the parameters:

    rho = toll shadow (mirror / (cos_i cos_o) + hue spread) + pass under;

what the apparatus sees of it has ``mirror_loss`` beside mirror and ``spread_loss`` beside spread.

On a grid ``mirror`` and ``spread`` live on (theta_h, theta_d) alone, ``shadow`` is a one-dimensional table, and whoever
differentiates needs each factor's derivative only in the parameters it names. ``toll`` and ``pass`` belong to the
conserving split (:mod:`merlfit.model.energy`), the losses to the acquisition, not to the material: a blurred footprint
dims what is sharp, each lobe as its width has it, and leaves the body as it is (docs/physics.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from . import acquisition, body, convolution, diffraction, energy, exact, scaled, zonal
from .effects import ANY, BODIES, KINDS, Effects
from .fresnel import diffraction_colour, fresnel, schlick
from .geometry import Geometry
from .ndf import epd
from .numerics import floats, safe_divide
from .parameters import GRAZING, GRAZING_DIFFRACTED, WAVELENGTHS_UM, parameters
from .shadowing import height_correlated, masking, masking_table

LEAST_COSINE = 1e-7  # of theta_d where lobes are blurred: in float32 the cosine of 90 degrees is negative
RING_ORDER = 32  # of the convolution whose width gives the loss of diffracted light
WHICH = "which_body"  # number of the body in `BODIES`, where the effects leave it open
Values = Mapping[str, Array]


class Setting(NamedTuple):
    """What does not depend on parameters: directions, wavelengths (leading axis) and effects."""

    geometry: Geometry  # with cosines of directions below the horizon replaced by 1
    above: Array
    wavelength_um: Array  # shape (C, 1, ..., 1)
    effects: Effects
    log_base: Array | None  # of the acquisition's loss (acquisition.grazing_log_base); None where that is off


class Factor(NamedTuple):
    """One factor of the BRDF, the parameters it depends on, and the tables (`TABLES`) that it looks up if given."""

    names: tuple[str, ...]
    evaluate: Callable[[Values, Setting], Array]
    tables: tuple[str, ...] = ()


def setting(
    geometry: Geometry,
    effects: Effects,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
    log_base: Array | None = None,
) -> Setting:
    """Directions made safe to compute with, and wavelengths with a leading axis.

    Args:
        log_base: :func:`merlfit.model.acquisition.grazing_log_base` of the directions, if it is known already.
    """
    theta_h, theta_d, cos_i, cos_o = floats(geometry.theta_h, geometry.theta_d, geometry.cos_i, geometry.cos_o)
    above = (cos_i > 0) & (cos_o > 0)
    cos_i, cos_o = jnp.where(above, cos_i, 1.0), jnp.where(above, cos_o, 1.0)
    rank = len(jnp.broadcast_shapes(theta_h.shape, theta_d.shape, above.shape))
    wavelength = jnp.asarray(wavelengths_um, jnp.result_type(theta_h)).reshape((-1,) + (1,) * rank)
    safe = Geometry(theta_h, theta_d, cos_i, cos_o)
    if effects.acquisition != "off" and log_base is None:
        log_base = acquisition.grazing_log_base(safe)
    return Setting(safe, above, wavelength, effects, log_base)


def factors(effects: Effects) -> dict[str, Factor]:
    """The factors of a material with these effects."""
    surface, optics = ("beta", "p"), (("n", "k") if effects.index == "complex" else ("eta",))
    nano = ("b", "c", "sigma_s")
    table = {} if effects.masking == "none" else {"shadow": Factor(surface, _shadow, ("masking",))}
    if effects.diffraction == "off":
        table["mirror"] = Factor(surface + optics, _mirror)
    else:
        dimming = nano if effects.renormalised or effects.split == "conserving" else ("sigma_s",)
        share = ("share",) if effects.renormalised else ()
        table["mirror"] = Factor((*dimming, *surface, *optics), _dimmed_mirror, share)
        if effects.diffraction == "exact":
            coloured = optics if effects.colour == "rayleigh_rice" else ()
            table["spread"] = Factor((*nano, *surface, *coloured), _exact_spread, share)
        else:
            table["spread"] = Factor((*nano, *(() if effects.diffraction == "lobe" else surface)), _spread, share)
        if effects.diffraction != "exact" or effects.colour == "fresnel":
            table["hue"] = Factor(optics, _hue)
    every = tuple(q.name for q in parameters(effects.material) if q.name != "albedo")
    if effects.body != "none":
        table["under"] = Factor(("albedo",) if effects.body == "lambert" else (optics[0], "albedo"), _under)
    if _pays_toll(effects):
        table["toll"] = Factor(every, _toll, ("surface_albedo",))
    if effects.acquisition not in ("off", 0.0):
        by_mode = {"free": (GRAZING.name,), "derived": surface}
        table["mirror_loss"] = Factor(by_mode.get(str(effects.acquisition), ()), _mirror_loss)
        if effects.diffraction != "off":
            derived = effects.acquisition == "derived"
            names = (GRAZING_DIFFRACTED.name,) if effects.acquisition == "free" else ()
            names = (*surface, "b", "c") if derived else names
            table["spread_loss"] = Factor(names, _spread_loss, ("diffracted_exponent",) if derived else ())
    return table


def assemble(at: Values, s: Setting) -> Array:
    """The BRDF (1/sr), shape ``(C, ...)``, from the values of its factors."""
    rho = at["mirror"] / (s.geometry.cos_i * s.geometry.cos_o)
    if "mirror_loss" in at:
        rho = at["mirror_loss"] * rho
    if "spread" in at:
        spread = at["hue"] * at["spread"] if "hue" in at else at["spread"]
        rho = rho + (at["spread_loss"] * spread if "spread_loss" in at else spread)
    if "shadow" in at:
        rho = at["shadow"] * rho
    under = at.get("under")
    if "toll" in at:
        rho = at["toll"][0] * rho
        under = None if under is None else at["toll"][1] * under
    if under is not None:
        rho = rho + under
    rho = jnp.where(s.above, rho, 0.0)
    return rho.astype(jnp.result_type(s.geometry.theta_h))  # the reference and the conserving split work in float64


def two_scale(
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    effects: Effects,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
) -> Array:
    """BRDF (1/sr) of a two-scale material for any directions and any number of wavelengths.

    Args:
        params: values by name, as :func:`merlfit.model.parameters.parameters` lists them for ``effects``: scalars, and
            arrays of shape ``(C,)`` for those that are per channel.
        geometry: directions, scattered or as a broadcast grid.
        effects: which effects to simulate (static).
        wavelengths_um: shape ``(C,)``, in micrometres.

    Returns:
        shape ``(C, *broadcast shape of geometry)``; 0 where light or viewer are below the surface.

    Raises:
        KeyError: a parameter that the effects call for is missing from ``params``, or one there is of no effects.

    Reciprocal in light and viewer for every choice of effects. Differentiable in every parameter, with finite gradients
    at the horizon, at theta_h = 0 and for i = o; the conserving split has kinks where an excess begins. Accuracy: that
    of the tier (``docs/effects.md``); the conserving split's tables 5e-4; everything else 1e-8.
    """
    s = setting(geometry, effects, wavelengths_um)
    values = shaped(params, s)
    return assemble({name: f.evaluate(values, s) for name, f in factors(effects).items()}, s)


@cache
def known() -> frozenset[str]:
    """Names that parameters may have: those of any effects, so that a material does for fewer effects as well."""
    every = (Effects(body, index=index, acquisition="free") for index, body in KINDS)
    return frozenset({q.name for effects in every for q in parameters(effects)} | TABLES.keys())


def shaped(params: Mapping[str, ArrayLike], s: Setting) -> dict[str, Array]:
    """Parameters in the precision of the angles, those per channel with a leading axis; tables if given."""
    missing = [q.name for q in parameters(s.effects) if q.name not in params]
    if missing:
        raise KeyError(f"two_scale needs {', '.join(missing)} for {s.effects}")
    if unknown := params.keys() - known() - ({WHICH} if s.effects.body == ANY else set()):
        raise KeyError(f"two_scale has no parameter {', '.join(sorted(unknown))}, whatever the effects")
    precision = jnp.result_type(s.geometry.theta_h)
    given = {name: jnp.asarray(params[name], precision) for name in TABLES if name in params}
    if s.effects.body == ANY:
        given[WHICH] = jnp.asarray(params[WHICH])
    return given | {
        q.name: jnp.asarray(params[q.name], precision).reshape(
            (-1, *s.wavelength_um.shape[1:]) if q.per_channel else ()
        )
        for q in parameters(s.effects)
    }


def generalised(effects: Effects, values: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """Values for :attr:`merlfit.model.effects.Effects.general` that give the same BRDF as these for ``effects``."""
    if effects.general == effects:
        return dict(values)
    given = dict(values)
    if effects.index == "real":
        given["n"] = given.pop("eta")
        given["k"] = np.zeros_like(given["n"])
    if effects.body == "none":
        given["albedo"] = np.zeros_like(given["n"])
    return given | {WHICH: np.int32(BODIES.index(effects.kind[1]))}


def _index(v: Values) -> tuple[Array, Array]:
    """Real and imaginary part of the index; a dielectric has only the first."""
    return (v["n"], v["k"]) if "n" in v else (v["eta"], jnp.zeros_like(v["eta"]))


def _shadow(v: Values, s: Setting) -> Array:
    """G of i and o."""
    cosines = (s.geometry.cos_i, s.geometry.cos_o)
    seen, lit = (masking(cos, v["beta"], v["p"], v.get("masking")) for cos in cosines)
    return seen * lit if s.effects.masking == "smith" else height_correlated(seen, lit)


def _fresnel(v: Values, s: Setting) -> Array:
    """F(theta_d) by the chosen formula."""
    formula = fresnel if s.effects.fresnel == "exact" else schlick
    return formula(s.geometry.cos_d, *_index(v))


def _mirror(v: Values, s: Setting) -> Array:
    """F(theta_d) D(theta_h) / 4."""
    return _fresnel(v, s) * epd(s.geometry.theta_h, v["beta"], v["p"]) / 4


def _share(v: Values, s: Setting) -> Array:
    """sigma_rel^2/sigma_s^2 at theta_d, where the facet meets the light."""
    return diffraction.renormalisation(jnp.sin(s.geometry.theta_d), v["b"] / s.wavelength_um, v["c"])


def _share_and_phase(v: Values, s: Setting) -> tuple[Array, Array]:
    """sigma_rel^2/sigma_s^2, or 1, and the exponent of A_spec."""
    share = jnp.ones((), v["sigma_s"].dtype)
    if s.effects.renormalised:
        share = v["share"] if "share" in v else _share(v, s)
    return share, diffraction.phase_variance(share * v["sigma_s"] ** 2, s.geometry.cos_d, s.wavelength_um)


def _dimmed_mirror(v: Values, s: Setting) -> Array:
    """A_spec F D / 4, or (1 - E) F D / 4."""
    if s.effects.split == "conserving":
        exact_, renormalised = s.effects.diffraction == "exact", s.effects.renormalised
        albedo = energy.lobe_albedo(
            s.geometry.theta_d, v["b"], v["c"], v["sigma_s"], s.wavelength_um, renormalised, exact_
        )
        return jnp.maximum(1 - albedo, 0.0) * _mirror(v, s)
    return jnp.exp(-_share_and_phase(v, s)[1]) * _mirror(v, s)


def _spread(v: Values, s: Setting) -> Array:
    """(1 - A_spec) (S * D)(theta_h) with its renormalised amplitude (1/sr)."""
    share, phase = _share_and_phase(v, s)
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    return -jnp.expm1(-phase) * amplitude * _blurred_lobe(v, s)


def _exact_spread(v: Values, s: Setting) -> Array:
    """The integral of Eq. 27 without G (1/sr)."""
    share, phase = _share_and_phase(v, s)
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    B = 2 * v["b"] / s.wavelength_um * s.geometry.cos_d
    coloured = s.effects.colour == "rayleigh_rice"
    index = _index(v) if coloured else (jnp.ones(()), jnp.zeros(()))
    g, surface = s.geometry, (v["c"], v["beta"], v["p"])
    return amplitude * exact.lobe(
        g.theta_h, g.theta_d, g.cos_i, g.cos_o, B, phase, *index, *surface, coloured=coloured
    )  # fmt: skip


def _hue(v: Values, s: Setting) -> Array:
    """Q/2, or F."""
    if s.effects.colour == "fresnel":
        return _fresnel(v, s)
    g = s.geometry
    return diffraction_colour(g.cos_i, g.cos_o, jnp.where(s.above, g.projected_dot, 1.0), *_index(v))


def _under(v: Values, s: Setting) -> Array:
    """The chosen body's BRDF (1/sr); under the conserving split without the transmittances, which are in the toll."""
    g, kind = s.geometry, s.effects.body
    if s.effects.split == "conserving":
        return energy.unlit_body(kind, g.cos_i, g.cos_o, v["albedo"], v.get("eta"))
    if kind == ANY:
        whole = jnp.broadcast_shapes(v["albedo"].shape, g.cos_i.shape)
        under = [
            lambda n, albedo: jnp.zeros_like(albedo),
            lambda n, albedo: body.lambert(albedo),
            partial(body.plastic, g.cos_i, g.cos_o),
            partial(body.subsurface, g.cos_i, g.cos_o),
        ]  # in the order of BODIES
        chosen = [lambda n, albedo, f=f: jnp.broadcast_to(f(n, albedo), whole) for f in under]
        return jax.lax.switch(v[WHICH], chosen, v["n"], v["albedo"])
    match kind:
        case "plastic":
            return body.plastic(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case "subsurface":
            return body.subsurface(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case _:
            return body.lambert(v["albedo"])


def _pays_toll(effects: Effects) -> bool:
    """Whether the conserving split needs the surface's albedo; Cook-Torrance with masking conserves by itself."""
    by_itself = effects.body == "none" and effects.diffraction == "off" and effects.masking != "none"
    return effects.split == "conserving" and not by_itself


def tables(effects: Effects) -> dict[str, "Table"]:
    """What the factors of these effects look up."""
    return {name: TABLES[name] for factor in factors(effects).values() for name in factor.tables}


def surface_albedo(v: Values, s: Setting) -> Array:
    """Directional albedo of the lobes at :func:`merlfit.model.energy.incidences`, (C, INCIDENCES).

    Args:
        v: parameters, those per channel as ``(C,)`` or with more axes of length one.
    """
    own = {name: x.reshape((-1, 1, 1, 1)) if jnp.ndim(x) else x for name, x in v.items() if name not in TABLES}
    effects, wavelengths_um = s.effects, s.wavelength_um.reshape(-1)
    largest_B = 2 * v["b"] / jnp.min(wavelengths_um) if "b" in v else jnp.ones(())
    degree = effects.zonal_order if effects.diffraction == "zonal" else 0
    incidences = energy.incidences(v["beta"])
    placed = jax.lax.stop_gradient((v["beta"], v["p"], largest_B))  # nodes need no derivative
    geometry, measure = energy.half_vectors(incidences, *placed, degree)
    inner = replace(effects.material, order=min(effects.order, energy.ORDER))
    s = setting(geometry, inner, wavelengths_um)
    if inner.renormalised and inner.diffraction != "off":
        one_minus_sin = 2 * jnp.sin(jnp.pi / 4 - geometry.theta_d[None] / 2) ** 2
        own["share"] = energy.share_of(v["b"] / wavelengths_um, v["c"])(one_minus_sin)
    lobes = {name: f.evaluate(own, s) for name, f in factors(inner).items() if name not in ("under", "toll")}
    return jnp.sum(assemble(lobes, s) * measure, (-2, -1))


class Table(NamedTuple):
    """What depends on parameters, and of directions on theta_d at the most, so that many directions can share it.

    Who evaluates directions in parts computes it once and gives it along among the values.
    """

    names: tuple[str, ...]  # of those parameters, as far as the effects have them
    compute: Callable[[Values, Setting], Array]


TABLES = {
    "masking": Table(("p",), lambda v, s: masking_table(v["p"])),
    "share": Table(("b", "c"), _share),
    "diffracted_exponent": Table(("beta", "p", "b", "c"), lambda v, s: _derived_diffracted(v, s.effects)),
    "surface_albedo": Table(("beta", "p", "b", "c", "sigma_s", "n", "k", "eta"), surface_albedo),
}


def _toll(v: Values, s: Setting) -> Array:
    """What the lobes are multiplied by (0) and what the body is multiplied by (1), stacked: see `energy`."""
    table = v["surface_albedo"] if "surface_albedo" in v else surface_albedo(v, s)
    lit, seen = (energy.at_incidence(table, v["beta"], theta) for theta in (s.geometry.theta_i, s.geometry.theta_o))
    kept = 1 / (jnp.maximum(lit, 1.0) * jnp.maximum(seen, 1.0))
    if s.effects.body == "none":
        return kept[None]
    through = jnp.maximum(1 - lit, 0.0) * jnp.maximum(1 - seen, 0.0)
    mean = energy.mean_transmittance(table, v["beta"]).reshape((-1,) + (1,) * (through.ndim - 1))
    return jnp.stack([kept, safe_divide(through, mean)])


def _mirror_loss(v: Values, s: Setting) -> Array:
    """p(i, o) of specular light, HP17 Eq. 59-60."""
    assert s.log_base is not None  # `setting` has seen to it
    return jnp.exp(grazing_exponent(v, s.effects) * s.log_base)


def _spread_loss(v: Values, s: Setting) -> Array:
    """p(i, o) of diffracted light."""
    assert s.log_base is not None
    return jnp.exp(grazing_exponent_diffracted(v, s.effects) * s.log_base)


def grazing_exponent(values: Values, effects: Effects) -> Array:
    """The acquisition's grazing exponent k of specular light at these parameter values; 0 where it is off."""
    if effects.acquisition == "free":
        return values[GRAZING.name]
    if effects.acquisition == "derived":
        return acquisition.derived_exponent(values["beta"], values["p"], effects.apparatus)
    return jnp.asarray(0.0 if effects.acquisition == "off" else float(effects.acquisition))


def grazing_exponent_diffracted(values: Values, effects: Effects) -> Array:
    """The same of diffracted light, from the width of (S * D) at normal incidence and the middle wavelength."""
    if effects.diffraction == "off":
        return jnp.zeros(())
    if effects.acquisition == "free":
        return values[GRAZING_DIFFRACTED.name]
    if effects.acquisition == "derived":
        if "diffracted_exponent" in values:
            return values["diffracted_exponent"]
        return _derived_diffracted(values, effects)
    return jnp.asarray(0.0 if effects.acquisition == "off" else float(effects.acquisition))


def _derived_diffracted(v: Values, effects: Effects) -> Array:
    """What the apparatus does to (S * D) over the rings that a footprint sees."""
    rings = jnp.asarray(acquisition.RINGS_RAD)[:, None]
    ones = jnp.ones((1, 1))
    inner = replace(effects.material, diffraction="quadrature", order=RING_ORDER)
    middle = WAVELENGTHS_UM[len(WAVELENGTHS_UM) // 2]
    s = setting(Geometry(rings, jnp.zeros((1, 1)), ones, ones), inner, (middle,))
    return acquisition.exponent_of_lobe(_blurred_lobe(v, s)[0, :, 0], effects.apparatus)


def _blurred_lobe(v: Values, s: Setting) -> Array:
    """(S * D) without amplitude, (C, ...), by the chosen tier."""
    b, c, beta, p, effects = v["b"], v["c"], v["beta"], v["p"], s.effects
    theta_h, cos_over_lambda = s.geometry.theta_h, jnp.maximum(s.geometry.cos_d, LEAST_COSINE) / s.wavelength_um
    match effects.diffraction:
        case "lobe":
            return convolution.lobe(theta_h, 2 * b * cos_over_lambda, c)
        case "scaled":
            return scaled.convolve(theta_h, 2 * b * cos_over_lambda, c, beta, p, effects.order)
        case "zonal":
            truncated = zonal.convolve(theta_h, 2 * b * cos_over_lambda, c, beta, p, effects.zonal_order)
            # no bound on the albedo holds for a lobe that is negative somewhere
            return jnp.maximum(truncated, 0.0) if effects.split == "conserving" else truncated
        case _:
            return convolution.convolve_many(theta_h, cos_over_lambda, b, c, beta, p, effects.order)
