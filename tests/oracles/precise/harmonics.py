"""The lobe blurred as zonal harmonics, their moments by one rule for every lobe."""

from functools import cache

import mpmath as mp

from .arithmetic import exactly
from .diffraction import lobe
from .quadrature import panels
from .surface import epd


@cache
def _legendre_rule(order):
    """t = log tan(theta), measure sin(theta) dtheta, and by degree P_l(cos theta) with it, at nodes for every lobe."""
    points = [mp.mpf(t) for t in range(-26, -10, 2)] + [mp.mpf(t) / 2 for t in range(-20, 29)]
    nodes, polynomials = list(panels(points, 24)), []
    cosines = [1 / mp.sqrt(1 + mp.exp(2 * t)) for t, _ in nodes]
    measure = [weight * mp.exp(2 * t) * x**3 for (t, weight), x in zip(nodes, cosines, strict=True)]
    before, now = [mp.mpf(0)] * len(nodes), measure
    for k in range(order + 1):
        polynomials.append(now)
        following = [((2 * k + 1) * x * a - k * b) / (k + 1) for x, a, b in zip(cosines, now, before, strict=True)]
        before, now = now, following
    return [mp.atan(mp.exp(t)) for t, _ in nodes], polynomials


@cache
def _moments(function, order, *arguments):
    """Int_0^(pi/2) f P_l(cos theta) sin(theta) dtheta, l = 0 .. order."""
    angles, polynomials = _legendre_rule(order)
    values = [function(theta, *arguments) for theta in angles]
    return [mp.fdot(values, row) for row in polynomials]


@exactly
def zonal(theta_h, B, c, beta, p, order):
    """(S * D)(theta_h) without amplitude as zonal harmonics to degree ``order``, HP17 Eq. 61-64 in plain moments.

    Moments to 1e-13 of the zeroth, for beta and 1/B down to 1e-4: the edge of an EPD of p = 5 is what decides.
    """
    total, before, now = mp.mpf(0), mp.mpf(0), mp.mpf(1)
    pairs = zip(_moments(lobe, order, B, c), _moments(epd, order, beta, p), strict=True)
    for k, (of_lobe, of_normals) in enumerate(pairs):
        total += (2 * k + 1) * of_lobe * of_normals * now
        before, now = now, ((2 * k + 1) * mp.cos(theta_h) * now - k * before) / (k + 1)
    return mp.pi * total
