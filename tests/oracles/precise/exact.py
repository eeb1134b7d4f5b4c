"""The diffraction lobe of Eq. 27 as it stands, everything on the facet: rings of normals about n."""

from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import mpmath as mp

from .arithmetic import still
from .colour import diffraction_colour
from .convolution import radii, stretch
from .quadrature import panels, split
from .surface import peak


class _Directions(NamedTuple):
    """h about n, i and o about h: ``along`` and ``beside`` are sin(theta_d) times cosine and sine of phi_d."""

    sin_h: Any
    cos_h: Any
    cos_d: Any
    along: Any
    beside: Any


def exact_lobe(theta_h, theta_d, phi_d, B, phase, n, k, c, beta, p, coloured, order=10):
    """Int Q/2 (1 - A) S D (i.m)+ (o.m)+ domega_m of HP17 Eq. 27, without amplitude: rings of normals about n.

    ``phase`` is that of A at theta_d. Panels in the radius as for `convolve`, with others towards the rings where a
    great circle i.m = 0 or o.m = 0 begins and where both meet.
    """
    sin_h, cos_h, cos_d, sin_d = mp.sin(theta_h), mp.cos(theta_h), mp.cos(theta_d), mp.sin(theta_d)
    along, beside = sin_d * mp.cos(phi_d), sin_d * mp.sin(phi_d)
    cos_i, cos_o = cos_d * cos_h - along * sin_h, cos_d * cos_h + along * sin_h
    # the great circles cross on the axis (i x o)/|i x o|, whose component along n is sin(phi_d) sin(theta_h)
    edges = mp.asin(cos_i), mp.asin(cos_o), mp.acos(min(abs(mp.sin(phi_d) * sin_h), mp.mpf(1)))
    directions = _Directions(sin_h, cos_h, cos_d, along, beside)
    highest, total = peak(beta, p), mp.mpf(0)
    ends = radii(theta_h, still(B), still(c), still(beta), still(p), edges)
    for t, weight in panels(ends, order):
        density = highest * mp.exp(2 * t - (mp.exp(t) / beta) ** (2 * p)) * mp.sqrt(1 + mp.exp(2 * t))
        if density * weight * B**2 > mp.mpf(10) ** -14:  # the lobe's integral is of order 1/B^2 or more
            total += weight * density * _ring(t, directions, B, c, phase, n, k, coloured, order)
    return total


@cache
def _ring(t, directions, B, c, phase, n, k, coloured, order):
    """Integral of Q/2 (1 - A) S (i.m)+ (o.m)+ over the azimuth of normals m at log tan(theta_m) = t.

    Azimuth from h, cut where a facet turns away from i or o and at h, in panels of s between the cuts, where
    alpha = width sinh(s). Nodes stay where they are under differences.
    """
    cos_m = 1 / mp.sqrt(1 + mp.exp(2 * t))
    sin_m = mp.exp(t) * cos_m
    difference = directions.sin_h * cos_m - directions.cos_h * sin_m
    width, total = stretch(still(B), difference, directions.sin_h * sin_m), mp.mpf(0)
    for start, end in pairwise(_cuts(sin_m, cos_m, directions)):
        for s, weight in panels(split(mp.asinh(start / width), mp.asinh(end / width), 2.5), order):
            versed, i_m, o_m = _seen_from_facet(width * mp.sinh(s), sin_m, cos_m, directions)
            if min(i_m, o_m) <= 0:
                break  # i and o keep their signs between the cuts
            value = i_m * o_m * (1 + B**2 * versed * (2 - versed)) ** (-(c + 1) / 2)
            value *= -mp.expm1(-phase * (1 - versed) ** 2)
            if coloured:
                value *= diffraction_colour(i_m, o_m, 2 * directions.cos_d**2 - 1 - i_m * o_m, n, k)
            total += weight * mp.cosh(s) * value
    return total * width


def _cuts(sin_m, cos_m, directions):
    """Azimuths between which no facet turns away from i or o; -pi, h and pi are there always."""
    sin_h, cos_h, cos_d, along, beside = directions
    cuts = [-mp.pi, mp.mpf(0), mp.pi]
    for sign in (1, -1):
        x, y, z = cos_d * sin_h + sign * along * cos_h, sign * beside, cos_d * cos_h - sign * along * sin_h
        length = mp.hypot(x, y) * sin_m
        if length > z * cos_m:
            reach = mp.acos(-z * cos_m / length)
            cuts += [(mp.atan2(y, x) + end + mp.pi) % (2 * mp.pi) - mp.pi for end in (-reach, reach)]
    return sorted(cuts)


def _seen_from_facet(azimuth, sin_m, cos_m, directions):
    """1 - h.m without cancellation, i.m and o.m."""
    sin_h, cos_h, cos_d, along, beside = directions
    product, difference = sin_h * sin_m, sin_h * cos_m - cos_h * sin_m
    half = mp.sin(azimuth / 2) ** 2
    versed = difference**2 / (1 + cos_h * cos_m + product) + 2 * product * half
    tilt = along * (cos_h * sin_m - sin_h * cos_m - 2 * cos_h * sin_m * half)
    tilt += beside * sin_m * mp.sin(azimuth)
    return versed, cos_d * (1 - versed) + tilt, cos_d * (1 - versed) - tilt
