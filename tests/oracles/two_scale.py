"""The assembled two-scale BRDF (HP17 Eq. 24-33) at one pair of unit vectors, and its exact diffraction lobe (Eq. 27).

i is light, o is viewer, the surface normal is (0, 0, 1). Conventions, where the paper leaves a choice:

- sigma_rel is taken at theta_d throughout (the facet m = h meets the light there), so it is one number per (i, o);
- the lobe of unpolarised light carries Q/2 (`q_factor`; 1 gives the printed Q);
- in the approximation (Eq. 33) Q sees the angles to n, as written; in Eq. 27 all of Eq. 22 lives on the facet, so
  Q, A and f see the angles to m (`colour_frame="facet"`), or Q those to n as Eq. 27 is literally written ("surface").
"""

import math
from typing import NamedTuple

import numpy as np

from .convolution import convolve
from .diffraction import renormalisation, s_hs
from .facets import facet_integral, geometry
from .fresnel import fresnel, q_from_cosines
from .masking import g1, smith_lambda
from .ndf import epd

NORMAL = np.array([0.0, 0.0, 1.0])


class Material(NamedTuple):
    """Parameters of HP17: b and sigma_s in micrometres, n and k at the wavelength in question."""

    beta: float
    p: float
    b: float
    c: float
    sigma_s: float
    n: float
    k: float = 0.0


class Choices(NamedTuple):
    """Other formulas than HP17's: Schlick's F, other masking, sigma_s for sigma_rel, F for Q/2."""

    fresnel: str = "exact"
    masking: str = "smith"
    renormalised: bool = True
    colour: str = "rayleigh_rice"


class Losses(NamedTuple):
    """Exponents k of the apparatus's loss p(i, o) of specular and of diffracted light, HP17 Eq. 59-60; 0 is none."""

    specular: float = 0.0
    diffracted: float = 0.0


def relative_variance(cos_d, wavelength, material, choices=Choices()):
    """sigma_rel^2/sigma_s^2 at theta_d (Eq. 18-19)."""
    if not choices.renormalised:
        return 1.0
    return renormalisation(math.sqrt(max(0.0, 1 - cos_d**2)), material.b / wavelength, material.c)


def specular_share(cos_d, wavelength, material, choices=Choices()):
    """A_spec, HP17 Eq. 25."""
    sigma_rel = material.sigma_s * math.sqrt(relative_variance(cos_d, wavelength, material, choices))
    return math.exp(-((4 * math.pi * sigma_rel * cos_d / wavelength) ** 2))


def masking(g, material, choices=Choices()):
    """G = G1(i) G1(o), HP17 Eq. 38; or 1 / (1 + Lambda_i + Lambda_o), Heitz 2014 Eq. 99; or 1."""
    if choices.masking == "none":
        return 1.0
    taus = [material.beta * math.sqrt(1 - cos**2) / cos for cos in (g.cos_i, g.cos_o)]
    if choices.masking == "height_correlated":
        return 1 / (1 + sum(smith_lambda(tau, material.p) for tau in taus))
    return math.prod(g1(tau, material.p) for tau in taus)


def specular_colour(g, material, choices):
    """F at theta_d, HP17 Eq. 3-4 or Schlick's polynomial."""
    if choices.fresnel == "exact":
        return fresnel(g.cos_d, material.n, material.k)
    eta = complex(material.n, material.k)
    f0 = abs((eta - 1) / (eta + 1)) ** 2
    return f0 + (1 - f0) * (1 - g.cos_d) ** 5


def mirror_cosine(i, o, m):
    """cos(phi_o - phi_i - pi) about the axis m; 1 where a direction is along m and the azimuth means nothing."""
    cos_i, cos_o = i @ m, o @ m
    sines = math.sqrt(max(0.0, 1 - cos_i**2) * max(0.0, 1 - cos_o**2))
    return 1.0 if sines < 1e-12 else min(1.0, max(-1.0, (cos_i * cos_o - i @ o) / sines))


def reflection_lobe(i, o, material, choices=Choices()):
    """rho_CT, HP17 Eq. 26."""
    g = geometry(i, o)
    d = epd(g.theta_h, material.beta, material.p)
    return specular_colour(g, material, choices) * d * masking(g, material, choices) / (4 * g.cos_i * g.cos_o)


def diffraction_lobe(i, o, wavelength, material, q_factor=0.5, choices=Choices()):
    """rho_CTD by the convolution of HP17 Eq. 33; the 1/lambda that Eq. 29 omits is restored."""
    g = geometry(i, o)
    colour = q_factor * q_from_cosines(g.cos_i, g.cos_o, mirror_cosine(i, o, NORMAL), material.n, material.k)
    if choices.colour == "fresnel":
        colour = specular_colour(g, material, choices)
    peak = s_hs(0.0, wavelength, material.b, material.c, relative_variance(g.cos_d, wavelength, material, choices))
    shape = convolve(g.theta_h, 2 * material.b * g.cos_d / wavelength, material.c, material.beta, material.p)
    share = 1 - specular_share(g.cos_d, wavelength, material, choices)
    return float(colour * masking(g, material, choices) * share * peak * shape)


def grazing_loss(i, o, k):
    """p(i, o) = (1 - 4 theta_i^2/pi^2)^k (1 - 4 theta_o^2/pi^2)^k, HP17 Eq. 59-60."""
    thetas = [math.acos(min(1.0, direction[2])) for direction in (i, o)]
    return math.prod((1 - (2 * theta / math.pi) ** 2) ** k for theta in thetas)


def brdf(i, o, wavelength, material, body=0.0, q_factor=0.5, choices=Choices(), losses=Losses()):
    """The assembled BRDF in 1/sr: A_spec(theta_d) rho_CT + rho_CTD + body (HP17 Eq. 24, section 4.5). To 1e-9.

    With ``losses`` what the apparatus measures of it: each lobe loses by itself, the body nothing.
    """
    share = specular_share(geometry(i, o).cos_d, wavelength, material, choices)
    diffracted = grazing_loss(i, o, losses.diffracted) * diffraction_lobe(i, o, wavelength, material, q_factor, choices)
    specular = grazing_loss(i, o, losses.specular) * reflection_lobe(i, o, material, choices)
    return share * specular + diffracted + body


def exact_ctd(i, o, wavelength, material, q_factor=0.5, colour_frame="facet"):
    """rho_CTD by HP17 Eq. 27 itself: A (Eq. 23), Q and S_HS inside the integral over microfacet normals. To 1e-8.

    Facets turned away from i or o do not contribute. Departs from the print as the module says. Seconds at worst.
    """
    if colour_frame not in ("facet", "surface"):
        raise ValueError(f"colour_frame is 'facet' or 'surface', not {colour_frame!r}")
    g = geometry(i, o)
    ratio = relative_variance(g.cos_d, wavelength, material)
    sigma_rel = material.sigma_s * math.sqrt(ratio)
    on_surface = q_from_cosines(g.cos_i, g.cos_o, mirror_cosine(i, o, NORMAL), material.n, material.k)
    cos_io = float(i @ o)

    def weight(i_m, o_m, _):
        share = -np.expm1(-((2 * np.pi * sigma_rel / wavelength * (i_m + o_m)) ** 2))
        if colour_frame == "surface":
            return i_m * o_m * share * on_surface
        sines = np.sqrt(np.maximum(1 - i_m**2, 0) * np.maximum(1 - o_m**2, 0))
        cos_phi = np.clip((i_m * o_m - cos_io) / np.maximum(sines, 1e-12), -1, 1)
        i_m, o_m = np.minimum(i_m, 1.0), np.minimum(o_m, 1.0)
        return i_m * o_m * share * q_from_cosines(i_m, o_m, cos_phi, material.n, material.k)

    B = 2 * material.b * g.cos_d / wavelength
    integral = facet_integral(i, o, B, material.c, material.beta, material.p, weight)
    peak = s_hs(0.0, wavelength, material.b, material.c, ratio)
    return float(q_factor * masking(g, material) * peak * integral / (g.cos_i * g.cos_o))
