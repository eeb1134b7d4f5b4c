"""The two-scale reflectance model of Holzschuch & Pacanowski 2017: microfacets that reflect and diffract.

    rho = A_spec rho_CT + rho_CTD + body                                                   (HP17 Eq. 24, 4.5)
    rho_CT = F(theta_d) D(theta_h) G / (4 cos_i cos_o)                                      (Eq. 26)
    rho_CTD = (Q/2) G (1 - A_spec) (S * D)(theta_h)                                         (Eq. 33, Q/2 for Q)
    A_spec = exp(-(4 pi sigma_rel cos_d / lambda)^2)                                        (Eq. 25)

It is written as a few factors, each a function of a part of the directions and of a part of the parameters:

    rho = shadow (mirror / (cos_i cos_o) + hue spread) + under.

On a grid ``mirror`` and ``spread`` live on (theta_h, theta_d) alone, ``shadow`` is a one-dimensional table, and whoever
differentiates needs each factor's derivative only in the parameters it names.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from . import body, convolution, diffraction
from .effects import Effects
from .fresnel import diffraction_colour, fresnel, schlick
from .geometry import Geometry
from .ndf import epd
from .parameters import WAVELENGTHS_UM, parameters
from .shadowing import height_correlated, masking

CHUNK = 4096  # scattered points convolved at a time: 4096 points x 2 x 24 x 8 nodes x 8 bytes = 13 MB an intermediate
Values = Mapping[str, Array]


class Setting(NamedTuple):
    """What does not depend on parameters: directions, wavelengths (leading axis) and effects."""

    geometry: Geometry  # with cosines of directions below the horizon replaced by 1
    above: Array
    wavelength_um: Array  # shape (C, 1, ..., 1)
    effects: Effects


class Factor(NamedTuple):
    """One factor of the BRDF and the parameters it depends on."""

    names: tuple[str, ...]
    evaluate: Callable[[Values, Setting], Array]


def setting(
    geometry: Geometry, effects: Effects, wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM
) -> Setting:
    """Directions made safe to compute with, and wavelengths with a leading axis."""
    above = (geometry.cos_i > 0) & (geometry.cos_o > 0)
    cos_i, cos_o = jnp.where(above, geometry.cos_i, 1.0), jnp.where(above, geometry.cos_o, 1.0)
    theta_h, theta_d = jnp.asarray(geometry.theta_h), jnp.asarray(geometry.theta_d)
    rank = len(jnp.broadcast_shapes(theta_h.shape, theta_d.shape, above.shape))
    wavelength = jnp.asarray(wavelengths_um, dtype=float).reshape((-1,) + (1,) * rank)
    return Setting(Geometry(theta_h, theta_d, cos_i, cos_o), above, wavelength, effects)


def factors(effects: Effects) -> dict[str, Factor]:
    """The factors of a material with these effects."""
    surface, optics = ("beta", "p"), (("n", "k") if effects.body == "none" else ("eta",))
    nano = ("b", "c", "sigma_s")
    table = {} if effects.masking == "none" else {"shadow": Factor(surface, _shadow)}
    if effects.diffraction == "off":
        table["mirror"] = Factor(surface + optics, _mirror)
    else:
        dimming = nano if effects.renormalised else ("sigma_s",)
        table["mirror"] = Factor((*dimming, *surface, *optics), _dimmed_mirror)
        blurred = surface if effects.diffraction == "quadrature" else ()
        table["spread"] = Factor((*nano, *blurred), _spread)
        table["hue"] = Factor(optics, _hue)
    if effects.body != "none":
        table["under"] = Factor(("albedo",) if effects.body == "lambert" else ("eta", "albedo"), _under)
    return table


def assemble(at: Values, s: Setting) -> Array:
    """The BRDF (1/sr), shape ``(C, ...)``, from the values of its factors."""
    surface = at["mirror"] / (s.geometry.cos_i * s.geometry.cos_o)
    if "spread" in at:
        surface = surface + at["hue"] * at["spread"]
    if "shadow" in at:
        surface = at["shadow"] * surface
    return jnp.where(s.above, surface + at["under"] if "under" in at else surface, 0.0)


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
        KeyError: a parameter that the effects call for is missing from ``params``.

    Reciprocal in light and viewer for every choice of effects. Differentiable in every parameter, with finite gradients
    at the horizon, at theta_h = 0 and for i = o. Accuracy: that of the convolution
    (:func:`merlfit.model.convolution.convolve`); masking 2e-6, everything else better than 1e-8.
    """
    s = setting(geometry, effects, wavelengths_um)
    values = shaped(params, s)
    return assemble({name: f.evaluate(values, s) for name, f in factors(effects).items()}, s)


def shaped(params: Mapping[str, ArrayLike], s: Setting) -> dict[str, Array]:
    """Parameters as float64 arrays, those per channel with the leading axis of the wavelengths."""
    missing = [q.name for q in parameters(s.effects) if q.name not in params]
    if missing:
        raise KeyError(f"two_scale needs {', '.join(missing)} for {s.effects}")
    return {
        q.name: jnp.asarray(params[q.name], dtype=float).reshape(
            (-1, *s.wavelength_um.shape[1:]) if q.per_channel else ()
        )
        for q in parameters(s.effects)
    }


def _index(v: Values) -> tuple[Array, Array]:
    """Real and imaginary part of the index; a dielectric has only the first."""
    return (v["n"], v["k"]) if "n" in v else (v["eta"], jnp.zeros(()))


def _shadow(v: Values, s: Setting) -> Array:
    """G of i and o."""
    seen, lit = (masking(cos, v["beta"], v["p"]) for cos in (s.geometry.cos_i, s.geometry.cos_o))
    return seen * lit if s.effects.masking == "smith" else height_correlated(seen, lit)


def _fresnel(v: Values, s: Setting) -> Array:
    """F(theta_d) by the chosen formula."""
    formula = fresnel if s.effects.fresnel == "exact" else schlick
    return formula(s.geometry.cos_d, *_index(v))


def _mirror(v: Values, s: Setting) -> Array:
    """F(theta_d) D(theta_h) / 4."""
    return _fresnel(v, s) * epd(s.geometry.theta_h, v["beta"], v["p"]) / 4


def _share_and_phase(v: Values, s: Setting) -> tuple[Array, Array]:
    """sigma_rel^2/sigma_s^2 at theta_d, where the facet meets the light, and the exponent of A_spec."""
    share = jnp.ones(())
    if s.effects.renormalised:
        share = diffraction.renormalisation(jnp.sin(s.geometry.theta_d), v["b"] / s.wavelength_um, v["c"])
    return share, diffraction.phase_variance(share * v["sigma_s"] ** 2, s.geometry.cos_d, s.wavelength_um)


def _dimmed_mirror(v: Values, s: Setting) -> Array:
    """A_spec F D / 4."""
    return jnp.exp(-_share_and_phase(v, s)[1]) * _mirror(v, s)


def _spread(v: Values, s: Setting) -> Array:
    """(1 - A_spec) (S * D)(theta_h) with its renormalised amplitude (1/sr)."""
    share, phase = _share_and_phase(v, s)
    amplitude = diffraction.lobe_amplitude(v["b"] / s.wavelength_um, v["c"]) / share
    return -jnp.expm1(-phase) * amplitude * _blurred_lobe(v, s)


def _hue(v: Values, s: Setting) -> Array:
    """Q/2, or F."""
    if s.effects.colour == "fresnel":
        return _fresnel(v, s)
    g = s.geometry
    return diffraction_colour(g.cos_i, g.cos_o, jnp.where(s.above, g.projected_dot, 1.0), *_index(v))


def _under(v: Values, s: Setting) -> Array:
    """The chosen body's BRDF (1/sr)."""
    g = s.geometry
    match s.effects.body:
        case "plastic":
            return body.plastic(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case "subsurface":
            return body.subsurface(g.cos_i, g.cos_o, v["eta"], v["albedo"])
        case _:
            return body.lambert(v["albedo"])


def _blurred_lobe(v: Values, s: Setting) -> Array:
    """(S * D) without amplitude; on a grid through a table shared by the channels, else point by point."""
    b, c, beta, p = (v[name] for name in ("b", "c", "beta", "p"))
    theta_h, cos_over_lambda = s.geometry.theta_h, s.geometry.cos_d / s.wavelength_um
    if s.effects.diffraction == "lobe":
        return convolution.lobe(theta_h, 2 * b * cos_over_lambda, c)
    shape = jnp.broadcast_shapes(theta_h.shape, cos_over_lambda.shape)
    along = cos_over_lambda.shape[1:]
    is_grid = theta_h.ndim == len(along) and all(1 in pair for pair in zip(theta_h.shape, along, strict=True))
    if is_grid and cos_over_lambda.size > convolution.interpolation_nodes(s.effects.order):
        log_u = jnp.log(cos_over_lambda).ravel()
        table = convolution.convolve_grid(theta_h.ravel(), log_u, b, c, beta, p, s.effects.order)
        # (H axes, C, D axes) -> (C, H axis with D axis ...): every axis belongs to one of the two
        pairs = [axis for a in range(len(along)) for axis in (a, len(along) + 1 + a)]
        return table.reshape(theta_h.shape + cos_over_lambda.shape).transpose([len(along), *pairs]).reshape(shape)

    def at(point: tuple[Array, Array]) -> Array:
        return convolution.convolve(point[0], point[1], c, beta, p, s.effects.order)

    points = jax.tree.map(jnp.ravel, tuple(jnp.broadcast_arrays(theta_h, 2 * b * cos_over_lambda)))
    result = at(points) if points[0].size <= CHUNK else jax.lax.map(at, points, batch_size=CHUNK)
    return result.reshape(shape)
