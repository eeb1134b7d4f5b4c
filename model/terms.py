"""The terms of the two-scale model, each of the effects, the parameters that it reads and a part of the directions.

:class:`.two_scale.TwoScale` says which of them a material has, and puts them together.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from . import body, convolution, diffraction, energy, exact, film
from .acquisition import RINGS_RAD
from .effects import ANY, BODIES, Effects
from .fresnel import diffraction_colour, fresnel, schlick
from .geometry import Geometry
from .masking.smith import height_correlated, masking
from .ndf.epd import epd
from .parameters import FILM, WHICH_BODY
from .reflectance import Setting, Values, setting

LEAST_COSINE = 1e-7  # of theta_d where lobes are blurred: in float32 the cosine of 90 degrees is negative
RING_ORDER = 32  # of the convolution whose width gives the loss of diffracted light


def _index(v: Values) -> tuple[Array, Array]:
    """Real and imaginary part of the index; a dielectric has only the first."""
    return (v["n"], v["k"]) if "n" in v else (v["eta"], jnp.zeros_like(v["eta"]))


def masking_G(e: Effects, v: Values, s: Setting) -> Array:
    """G of i and o."""
    cosines = (s.geometry.cos_i, s.geometry.cos_o)
    seen, lit = (masking(cos, v["beta"], v["p"], v.get("masking_curve")) for cos in cosines)
    return seen * lit if e.masking == "smith" else height_correlated(seen, lit)


def facets(e: Effects, v: Values, s: Setting) -> Array:
    """F(theta_d) by the chosen formula, or that of a film."""
    if "facet_reflectance" in v:
        return v["facet_reflectance"]
    if e.index == "film":
        of_film = v["film_eta"], v["film_thickness"]
        return film.reflectance(s.geometry.cos_d, v["n"], v["k"], *of_film, s.wavelength_um)
    formula = fresnel if e.fresnel == "exact" else schlick
    return formula(s.geometry.cos_d, *_index(v))


def facet_reflectance(e: Effects, v: Values, s: Setting) -> Array:
    """The same as a table at each theta_d."""
    per_channel, shared = ("eta",) if e.index == "real" else ("n", "k"), tuple(q.name for q in FILM)
    own = {name: v[name].reshape(-1, *s.wavelength_um.shape[1:]) for name in per_channel}
    return facets(e, own | {name: v[name] for name in shared if e.index == "film"}, s)


def distribution(e: Effects, v: Values, s: Setting) -> Array:
    """D(theta_h) / 4."""
    return epd(s.geometry.theta_h, v["beta"], v["p"]) / 4


def relative_variance(e: Effects, v: Values, s: Setting) -> Array:
    """sigma_rel^2/sigma_s^2 at theta_d, where the facet meets the light."""
    return diffraction.renormalisation(jnp.sin(s.geometry.theta_d), v["b"] / s.wavelength_um, v["c"])


def variance_curve(e: Effects, v: Values, s: Setting) -> Array:
    """The same as a table over theta_d, (SHARES, C)."""
    return energy.share_curve(v["b"] / s.wavelength_um.reshape(-1), v["c"])


def facet_albedo(e: Effects, v: Values, s: Setting) -> Array:
    """Albedo of the facets' diffraction lobe as a table over theta_d, (C, LOBE_INCIDENCES)."""
    return energy.lobe_albedo_table(
        v["b"], v["c"], v["sigma_s"], s.wavelength_um, e.renormalised, e.diffraction == "exact"
    )


def lobe_surface(e: Effects, v: Values, s: Setting) -> Array:
    """Chebyshev coefficients of log (S * D) in log(1 + B^2), at places of theta_h, up to the sharpest channel's B.

    :func:`convolution.surface` makes them.
    """
    sharpest = 2 * v["b"] / jnp.min(s.wavelength_um)
    return convolution.surface(sharpest, v["c"], v["beta"], v["p"], e.order)


def _variance_and_phase(e: Effects, v: Values, s: Setting) -> tuple[Array, Array]:
    """sigma_rel^2/sigma_s^2, or 1, and the exponent of A_spec."""
    share = jnp.ones((), v["sigma_s"].dtype)
    if e.renormalised:
        if "relative_variance" in v:
            share = v["relative_variance"]
        elif "variance_curve" in v:
            lacks = 2 * jnp.sin(jnp.pi / 4 - s.geometry.theta_d / 2) ** 2  # 1 - sin(theta_d)
            lacks = lacks.reshape((1,) * (s.wavelength_um.ndim - lacks.ndim) + lacks.shape)
            share = energy.share_of(v["b"] / s.wavelength_um.reshape(-1), v["c"], v["variance_curve"])(lacks)
        else:
            share = relative_variance(e, v, s)
    return share, diffraction.phase_variance(share * v["sigma_s"] ** 2, s.geometry.cos_d, s.wavelength_um)


def undiffracted(e: Effects, v: Values, s: Setting) -> Array:
    """A_spec (HP17 Eq. 25), or 1 - E."""
    if e.split == "conserving":
        table = v["facet_albedo"] if "facet_albedo" in v else facet_albedo(e, v, s)
        return jnp.maximum(1 - energy.lobe_albedo(s.geometry.theta_d, table), 0.0)
    return jnp.exp(-_variance_and_phase(e, v, s)[1])


def _amplitude(e: Effects, v: Values, s: Setting, share: Array) -> Array:
    """Of the diffraction lobe, renormalised (1/sr), with the weight of the free split."""
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    return v["weight"] * amplitude if e.split == "free" else amplitude


def diffracted(e: Effects, v: Values, s: Setting) -> Array:
    """(1 - A_spec) (S * D)(theta_h) with its amplitude (1/sr)."""
    share, phase = _variance_and_phase(e, v, s)
    return -jnp.expm1(-phase) * _amplitude(e, v, s, share) * blurred_lobe(e, v, s)


def exact_diffracted(e: Effects, v: Values, s: Setting) -> Array:
    """The integral of Eq. 27 without G (1/sr)."""
    share, phase = _variance_and_phase(e, v, s)
    B = 2 * v["b"] / s.wavelength_um * s.geometry.cos_d
    coloured = e.colour == "rayleigh_rice"
    index = _index(v) if coloured else (jnp.ones(()), jnp.zeros(()))
    g, surface = s.geometry, (v["c"], v["beta"], v["p"])
    return _amplitude(e, v, s, share) * exact.lobe(
        g.theta_h, g.theta_d, g.cos_i, g.cos_o, B, phase, *index, *surface, coloured=coloured
    )  # fmt: skip


def diffraction_colour_Q(e: Effects, v: Values, s: Setting) -> Array:
    """Q/2."""
    g = s.geometry
    return diffraction_colour(g.cos_i, g.cos_o, jnp.where(s.above, g.projected_dot, 1.0), *_index(v))


def body_term(e: Effects, v: Values, s: Setting) -> Array:
    """The chosen body's BRDF (1/sr); under the conserving split without its transmittances: `conservation`."""
    g, kind = s.geometry, e.body
    if e.split == "conserving":
        eta = v["eta"] if kind in ("plastic", "subsurface") else None
        return energy.unlit_body(kind, g.cos_i, g.cos_o, v["albedo"], eta)
    if kind == ANY:
        whole = jnp.broadcast_shapes(v["albedo"].shape, g.cos_i.shape)
        which, layers = v[WHICH_BODY], BODIES.index("plastic")

        def layered(n: Array, albedo: Array) -> Array:
            """Plastic or subsurface, the last two of BODIES, which differ in what comes back from below."""
            r_i = body.internal_diffuse_reflectance(n)
            below = [body.substrate, partial(body.scattered, g.cos_i, g.cos_o)]
            chosen = [lambda n, albedo, f=f: jnp.broadcast_to(f(n, albedo, r_i), whole) for f in below]
            return body.transmittance(g.cos_i, g.cos_o, n) * jax.lax.switch(which - layers, chosen, n, albedo)

        bodies = [lambda n, albedo: jnp.zeros_like(albedo), lambda n, albedo: body.lambert(albedo), layered]
        chosen = [lambda n, albedo, f=f: jnp.broadcast_to(f(n, albedo), whole) for f in bodies]
        return jax.lax.switch(jnp.minimum(which, layers), chosen, v["n"], v["albedo"])
    match kind:
        case "plastic":
            return body.plastic(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case "subsurface":
            return body.subsurface(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case _:
            return body.lambert(v["albedo"])


def blurred_over_rings(e: Effects, v: Values, wavelength_um: Array) -> Array:
    """(S * D) over the rings that a footprint sees, at normal incidence and one wavelength; whatever the tier."""
    rings, ones = jnp.asarray(RINGS_RAD)[:, None], jnp.ones((1, 1))
    s = setting(Geometry(rings, jnp.zeros((1, 1)), ones, ones), wavelength_um)
    return blurred_lobe(e.changed(diffraction="quadrature", order=RING_ORDER), v, s)[0, :, 0]


def blurred_lobe(e: Effects, v: Values, s: Setting) -> Array:
    """(S * D) without amplitude, (C, ...), by the chosen tier."""
    theta_h = s.geometry.theta_h
    cos_over_lambda = jnp.maximum(s.geometry.cos_d, LEAST_COSINE) / s.wavelength_um
    B = 2 * v["b"] * cos_over_lambda
    if e.diffraction == "lobe":
        return convolution.lobe(theta_h, B, v["c"])
    if "lobe_surface" in v:
        shortest_um = jnp.min(s.wavelength_um)
        share, sharpest = cos_over_lambda * shortest_um, 2 * v["b"] / shortest_um
        return convolution.from_surface(v["lobe_surface"], theta_h, share, sharpest)
    return convolution.convolve_many(theta_h, cos_over_lambda, v["b"], v["c"], v["beta"], v["p"], e.order)
