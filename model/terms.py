"""The terms of the two-scale model, each a function of the parameters that it reads and of a part of the directions.

:class:`merlfit.model.two_scale.TwoScale` says which of them a material has, and puts them together.
"""

from functools import partial
from typing import cast

import jax
import jax.numpy as jnp
from jax import Array

from . import body, convolution, diffraction, energy, exact
from .acquisition import RINGS_RAD
from .effects import ANY, Effects
from .fresnel import diffraction_colour, fresnel, schlick
from .geometry import Geometry
from .masking.smith import height_correlated, masking
from .ndf.epd import epd
from .numerics import safe_divide
from .reflectance import Reflectance, Setting, Values, setting

LEAST_COSINE = 1e-7  # of theta_d where lobes are blurred: in float32 the cosine of 90 degrees is negative
RING_ORDER = 32  # of the convolution whose width gives the loss of diffracted light
WHICH = "which_body"  # number of the body in `BODIES`, where the model leaves it open
LIT = ("beta", "p", "b", "c", "sigma_s", "n", "k", "eta")  # what the surface's albedo depends on


def _effects(s: Setting) -> Effects:
    """Settings of the two-scale model; no other has these terms."""
    return cast(Effects, s.model)


def _index(v: Values) -> tuple[Array, Array]:
    """Real and imaginary part of the index; a dielectric has only the first."""
    return (v["n"], v["k"]) if "n" in v else (v["eta"], jnp.zeros_like(v["eta"]))


def masking_G(v: Values, s: Setting) -> Array:
    """G of i and o."""
    cosines = (s.geometry.cos_i, s.geometry.cos_o)
    seen, lit = (masking(cos, v["beta"], v["p"], v.get("masking_curve")) for cos in cosines)
    return seen * lit if _effects(s).masking == "smith" else height_correlated(seen, lit)


def fresnel_F(v: Values, s: Setting) -> Array:
    """F(theta_d) by the chosen formula."""
    formula = fresnel if _effects(s).fresnel == "exact" else schlick
    return formula(s.geometry.cos_d, *_index(v))


def specular(v: Values, s: Setting) -> Array:
    """F(theta_d) D(theta_h) / 4."""
    return fresnel_F(v, s) * epd(s.geometry.theta_h, v["beta"], v["p"]) / 4


def relative_variance(v: Values, s: Setting) -> Array:
    """sigma_rel^2/sigma_s^2 at theta_d, where the facet meets the light."""
    return diffraction.renormalisation(jnp.sin(s.geometry.theta_d), v["b"] / s.wavelength_um, v["c"])


def variance_curve(v: Values, s: Setting) -> Array:
    """The same as a table over theta_d, (SHARES, C)."""
    return energy.share_curve(v["b"] / s.wavelength_um.reshape(-1), v["c"])


def facet_albedo(v: Values, s: Setting) -> Array:
    """Albedo of the facets' diffraction lobe as a table over theta_d, (C, LOBE_INCIDENCES)."""
    e = _effects(s)
    return energy.lobe_albedo_table(
        v["b"], v["c"], v["sigma_s"], s.wavelength_um, e.renormalised, e.diffraction == "exact"
    )


def lobe_surface(v: Values, s: Setting) -> Array:
    """log (S * D) as a table over theta_h and B, up to the sharpest channel's: :func:`convolution.surface`."""
    sharpest = 2 * v["b"] / jnp.min(s.wavelength_um)
    return convolution.surface(sharpest, v["c"], v["beta"], v["p"], _effects(s).order)


def _variance_and_phase(v: Values, s: Setting) -> tuple[Array, Array]:
    """sigma_rel^2/sigma_s^2, or 1, and the exponent of A_spec."""
    share = jnp.ones((), v["sigma_s"].dtype)
    if _effects(s).renormalised:
        if "relative_variance" in v:
            share = v["relative_variance"]
        elif "variance_curve" in v:
            lacks = 2 * jnp.sin(jnp.pi / 4 - s.geometry.theta_d / 2) ** 2  # 1 - sin(theta_d)
            lacks = lacks.reshape((1,) * (s.wavelength_um.ndim - lacks.ndim) + lacks.shape)
            share = energy.share_of(v["b"] / s.wavelength_um.reshape(-1), v["c"], v["variance_curve"])(lacks)
        else:
            share = relative_variance(v, s)
    return share, diffraction.phase_variance(share * v["sigma_s"] ** 2, s.geometry.cos_d, s.wavelength_um)


def undiffracted(v: Values, s: Setting) -> Array:
    """A_spec F D / 4, or (1 - E) F D / 4."""
    e = _effects(s)
    if e.split == "conserving":
        albedo = energy.lobe_albedo(
            s.geometry.theta_d, v["b"], v["c"], v["sigma_s"], s.wavelength_um, e.renormalised, e.diffraction == "exact",
            v.get("facet_albedo"),
        )  # fmt: skip
        return jnp.maximum(1 - albedo, 0.0) * specular(v, s)
    return A_spec(v, s) * specular(v, s)


def A_spec(v: Values, s: Setting) -> Array:
    """Share of the light that a facet reflects without diffraction, HP17 Eq. 25."""
    return jnp.exp(-_variance_and_phase(v, s)[1])


def diffracted(v: Values, s: Setting) -> Array:
    """(1 - A_spec) (S * D)(theta_h) with its renormalised amplitude (1/sr)."""
    share, phase = _variance_and_phase(v, s)
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    return -jnp.expm1(-phase) * amplitude * blurred_lobe(v, s)


def exact_diffracted(v: Values, s: Setting) -> Array:
    """The integral of Eq. 27 without G (1/sr)."""
    share, phase = _variance_and_phase(v, s)
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    B = 2 * v["b"] / s.wavelength_um * s.geometry.cos_d
    coloured = _effects(s).colour == "rayleigh_rice"
    index = _index(v) if coloured else (jnp.ones(()), jnp.zeros(()))
    g, surface = s.geometry, (v["c"], v["beta"], v["p"])
    return amplitude * exact.lobe(
        g.theta_h, g.theta_d, g.cos_i, g.cos_o, B, phase, *index, *surface, coloured=coloured
    )  # fmt: skip


def diffraction_colour_Q(v: Values, s: Setting) -> Array:
    """Q/2, or F."""
    if _effects(s).colour == "fresnel":
        return fresnel_F(v, s)
    g = s.geometry
    return diffraction_colour(g.cos_i, g.cos_o, jnp.where(s.above, g.projected_dot, 1.0), *_index(v))


def body_term(v: Values, s: Setting) -> Array:
    """The chosen body's BRDF (1/sr); under the conserving split without its transmittances: `conservation`."""
    g, kind = s.geometry, _effects(s).body
    if _effects(s).split == "conserving":
        eta = v["eta"] if kind in ("plastic", "subsurface") else None
        return energy.unlit_body(kind, g.cos_i, g.cos_o, v["albedo"], eta)
    if kind == ANY:
        whole = jnp.broadcast_shapes(v["albedo"].shape, g.cos_i.shape)
        bodies = [
            lambda n, albedo: jnp.zeros_like(albedo),
            lambda n, albedo: body.lambert(albedo),
            partial(body.plastic, g.cos_i, g.cos_o),
            partial(body.subsurface, g.cos_i, g.cos_o),
        ]  # in the order of BODIES
        chosen = [lambda n, albedo, f=f: jnp.broadcast_to(f(n, albedo), whole) for f in bodies]
        return jax.lax.switch(v[WHICH], chosen, v["n"], v["albedo"])
    match kind:
        case "plastic":
            return body.plastic(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case "subsurface":
            return body.subsurface(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case _:
            return body.lambert(v["albedo"])


def surface_albedo(v: Values, s: Setting) -> Array:
    """Directional albedo of the lobes at :func:`merlfit.model.energy.incidences`, (C, INCIDENCES).

    Args:
        v: parameters, those per channel as ``(C,)`` or with more axes of length one.
    """
    given = {name: v[name] for name in LIT if name in v}
    own = {name: x.reshape((-1, 1, 1, 1)) if jnp.ndim(x) else x for name, x in given.items()}
    wavelengths_um = s.wavelength_um.reshape(-1)
    largest_B = 2 * v["b"] / jnp.min(wavelengths_um) if "b" in v else jnp.ones(())
    incidences = energy.incidences(v["beta"])
    placed = jax.lax.stop_gradient((v["beta"], v["p"], largest_B))  # nodes need no derivative
    geometry, measure = energy.half_vectors(incidences, *energy.slopes(*placed))
    inner = s.model.cheap_variant(energy.ORDER) if _effects(s).diffraction != "exact" else s.model
    s = setting(geometry, inner, wavelengths_um)
    if _effects(s).renormalised and _effects(s).diffraction != "off":
        one_minus_sin = 2 * jnp.sin(jnp.pi / 4 - geometry.theta_d[None] / 2) ** 2
        own["relative_variance"] = energy.share_of(v["b"] / wavelengths_um, v["c"])(one_minus_sin)
    lobes = {name: f(own, s) for name, f in inner.factors().items() if name not in ("body", "conservation")}
    return jnp.sum(inner.assemble(lobes, s).brdf(s) * measure, (-2, -1))


def conservation(v: Values, s: Setting) -> Array:
    """What the lobes are multiplied by (0) and what the body is multiplied by (1), stacked: see `energy`."""
    table = v["surface_albedo"] if "surface_albedo" in v else surface_albedo(v, s)
    g, masked = s.geometry, _effects(s).masking != "none"
    lit, seen = (energy.at_incidence(table, v["beta"], theta, masked) for theta in (g.theta_i, g.theta_o))
    kept = 1 / (jnp.maximum(lit, 1.0) * jnp.maximum(seen, 1.0))
    if _effects(s).body == "none":
        return kept[None]
    through = jnp.maximum(1 - lit, 0.0) * jnp.maximum(1 - seen, 0.0)
    mean = energy.mean_transmittance(table, v["beta"], masked).reshape((-1,) + (1,) * (through.ndim - 1))
    return jnp.stack([kept, safe_divide(through, mean)])


def blurred_over_rings(v: Values, model: Reflectance, wavelength_um: Array) -> Array:
    """(S * D) over the rings that a footprint sees, at normal incidence and one wavelength."""
    rings = jnp.asarray(RINGS_RAD)[:, None]
    ones = jnp.ones((1, 1))
    s = setting(Geometry(rings, jnp.zeros((1, 1)), ones, ones), model, wavelength_um)
    return blurred_lobe(v, s)[0, :, 0]


def blurred_lobe(v: Values, s: Setting) -> Array:
    """(S * D) without amplitude, (C, ...), by the chosen tier."""
    e, theta_h = _effects(s), s.geometry.theta_h
    cos_over_lambda = jnp.maximum(s.geometry.cos_d, LEAST_COSINE) / s.wavelength_um
    B = 2 * v["b"] * cos_over_lambda
    if e.diffraction == "lobe":
        return convolution.lobe(theta_h, B, v["c"])
    if "lobe_surface" in v:
        shortest_um = jnp.min(s.wavelength_um)
        share, sharpest = cos_over_lambda * shortest_um, 2 * v["b"] / shortest_um
        return convolution.from_surface(v["lobe_surface"], theta_h, share, sharpest)
    return convolution.convolve_many(theta_h, cos_over_lambda, v["b"], v["c"], v["beta"], v["p"], e.order)
