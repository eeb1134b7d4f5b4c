"""What the surface itself sends back: mirror term and diffraction lobe, as the effects have them."""

from typing import Any, NamedTuple

import mpmath as mp

from .colour import diffraction_colour, fresnel, schlick
from .convolution import convolve
from .diffraction import lobe, lobe_amplitude, phase_variance, renormalisation
from .exact import exact_lobe
from .facets import lobe_albedo, lobe_albedo_of, renormalisation_of
from .surface import epd, shadowing


class Geometry(NamedTuple):
    """Half and difference angles, and cosines of light and viewer."""

    theta_h: Any
    theta_d: Any
    phi_d: Any
    cos_i: Any
    cos_o: Any


def lobes(at, wavelength_um, v, e, many=False, losses=(1, 1)):
    """Both lobes at a `Geometry`, parameters v, effects e; for ``many`` dear functions of theta_d are interpolated.

    ``losses``: what the apparatus leaves of the mirror term and of the diffracted light.
    """
    cos_d = mp.cos(at.theta_d)
    shadow = shadowing(e.masking, at.cos_i, at.cos_o, v.beta, v.p)
    mirror = _reflectance(cos_d, v, e) * epd(at.theta_h, v.beta, v.p)
    mirror /= 4 * at.cos_i * at.cos_o
    if e.diffraction == "off":
        return shadow * losses[0] * mirror
    ratio = v.b / wavelength_um
    share = _share(at.theta_d, ratio, v, e, many)
    phase = phase_variance(share, v.sigma_s, cos_d, wavelength_um)
    kept = _kept(at.theta_d, phase, wavelength_um, v, e, many)
    blurred = _blurred(at, 2 * ratio * cos_d, phase, v, e)
    return shadow * (losses[0] * kept * mirror + losses[1] * lobe_amplitude(ratio, v.c) / share * blurred)


def _reflectance(cos_d, v, e):
    return (schlick if e.fresnel == "schlick" else fresnel)(cos_d, *v.index)


def _share(theta_d, ratio, v, e, many):
    """sigma_rel^2/sigma_s^2."""
    if not e.renormalised:
        return mp.mpf(1)
    if many:
        return renormalisation_of(ratio, v.c)(mp.cos(theta_d) ** 2)
    return renormalisation(mp.sin(theta_d), ratio, v.c)


def _kept(theta_d, phase, wavelength_um, v, e, many):
    """The share of the light that the mirror term keeps: A_spec, or 1 - albedo of the facet's own lobe."""
    if e.split != "conserving":
        return mp.exp(-phase)
    facet = (wavelength_um, v.b, v.c, v.sigma_s, e.renormalised, e.diffraction == "exact")
    return 1 - (lobe_albedo_of(*facet)(2 * theta_d / mp.pi) if many else lobe_albedo(theta_d, *facet))


def _blurred(at, B, phase, v, e):
    """(1 - A) times colour and blurred lobe, without amplitude."""
    coloured = e.colour == "rayleigh_rice"
    if e.diffraction == "exact":
        n, k = v.index
        blurred = exact_lobe(at.theta_h, at.theta_d, at.phi_d, B, phase, n, k, v.c, v.beta, v.p, coloured)
        blurred /= at.cos_i * at.cos_o
    else:
        plain = e.diffraction == "lobe"
        blurred = lobe(at.theta_h, B, v.c) if plain else convolve(at.theta_h, B, v.c, v.beta, v.p)
        blurred *= -mp.expm1(-phase)
        if coloured:
            dot = mp.cos(2 * at.theta_d) - at.cos_i * at.cos_o
            blurred *= diffraction_colour(at.cos_i, at.cos_o, dot, *v.index)
    return blurred if coloured else blurred * _reflectance(mp.cos(at.theta_d), v, e)
