"""The lobe blurred by the distribution of normals: rings of normals, by panels."""

import mpmath as mp

from .arithmetic import exactly
from .quadrature import panels, split
from .surface import peak


@exactly
def convolve(theta_h, B, c, beta, p, order=12):
    """(S * D)(theta_h) of HP17 Eq. 33 without amplitude: rings about n in t = log tan(theta_m), by panels.

    Panels are short where D falls, and geometric towards the ring through h (width 1/B) and towards the horizon of h,
    each with a singularity of the complex t-plane farther away than its own length. ``order`` is that of the panels.
    """
    highest = peak(beta, p)
    sin_h, cos_h, total = mp.sin(theta_h), mp.cos(theta_h), mp.mpf(0)
    for t, weight in panels(radii(theta_h, B, c, beta, p), order):
        tan_m = mp.exp(t)
        cos_m = 1 / mp.sqrt(1 + tan_m**2)
        density = highest * mp.exp(-((tan_m / beta) ** (2 * p))) * tan_m**2 / cos_m
        total += weight * density * _ring(tan_m * cos_m, cos_m, sin_h, cos_h, B, c, order)
    return total


def radii(theta_h, B, c, beta, p, edges=()):
    """Ends of panels in t = log tan(theta_m): see `convolve`; ``edges`` are other angles with a singularity."""
    low = mp.log(min(beta, 1 / B)) - 17
    fall = exponent = 60 + (c + 1) * mp.log1p(B) + 2 / p * mp.log(10 + 2 / p)
    for _ in range(20):
        exponent = fall + mp.mpf(1.5) / p * mp.log(exponent)
    top = mp.log(beta) + mp.log(exponent) / (2 * p)
    bend = max(mp.log(beta) - 3 / p, low)
    points = [*split(low, bend, 2)[:-1], *split(bend, top, min(mp.mpf(1), 1 / p))]
    special = (t for t in _singular(theta_h, B, edges) if points[0] < t < points[-1])
    return sorted([*points, *special])


def _singular(theta_h, B, edges):
    """Ladders in t towards theta_h, the horizon of h and the edges."""
    ladder = [mp.mpf(4) ** (j - 1) / B for j in range(40) if mp.mpf(4) ** (j - 1) < 4 * B]
    angles = [theta_h, *(theta_h - x for x in ladder), *(theta_h + x for x in ladder)]
    for edge in (mp.pi / 2 - theta_h, *edges):
        angles += [edge, *(edge + sign * mp.mpf(4) ** -j for j in range(1, 7) for sign in (-1, 1))]
    least = mp.mpf(10) ** -15
    return [mp.log(mp.tan(x)) for x in angles if least < x < mp.pi / 2 - least]


def stretch(B, difference, product):
    """Width of the peak that S has over the azimuth phi = width sinh(s) of a ring of normals.

    ``difference`` is the sine of theta_h - theta_m, ``product`` that of their sines.
    """
    offset = 1 / B**2 + difference**2
    return mp.sqrt(offset / product) if product * 10**4 > offset else mp.mpf(100)


def _ring(sin_m, cos_m, sin_h, cos_h, B, c, order):
    """Integral of S over the azimuth of m, warped as phi = width sinh(s) onto the peak at phi = 0."""
    product, difference = sin_h * sin_m, sin_h * cos_m - cos_h * sin_m
    cos_difference = cos_h * cos_m + product
    if cos_difference <= 0:  # an h below the horizon by a rounding of pi/2 does not see the normals next to n
        return mp.mpf(0)
    near = difference**2 / (2 * (1 + cos_difference))  # sin^2 of half the difference of the angles
    width = stretch(B, difference, product)
    end = mp.pi if cos_h * cos_m >= product else mp.acos(-cos_h * cos_m / product)
    total = mp.mpf(0)
    for s, weight in panels(split(mp.mpf(0), mp.asinh(end / width), 2.5), order):
        up = mp.exp(s)
        v = near + product * mp.sin(width * (up - 1 / up) / 4) ** 2
        total += weight * (up + 1 / up) * (1 + 4 * B**2 * v * (1 - v)) ** (-(c + 1) / 2) * (1 - 2 * v) ** 2
    return total * width
