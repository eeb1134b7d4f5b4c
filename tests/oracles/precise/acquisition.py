"""The apparatus: the loss at grazing angles, and its exponents from a footprint."""

from functools import cache

import mpmath as mp

from .arithmetic import exactly
from .chebyshev import interpolant
from .convolution import convolve
from .quadrature import panels
from .surface import epd

MIDDLE_UM = mp.mpf("0.526")
INSIDE, NODES = mp.mpf(10) ** -5, 48  # of the diffracted lobe


@exactly
def grazing(cos_i, cos_o, exponent):
    """p(i, o), HP17 Eq. 59-60."""
    base = [1 - (2 * mp.acos(cos) / mp.pi) ** 2 for cos in (cos_i, cos_o)]
    return (base[0] * base[1]) ** exponent


@exactly
def derived_exponent(beta, p):
    """k of HP17 Eq. 60 by least squares of log loss at 10, 15 .. 80 degrees; the blur of D to 1e-6."""
    return _exponent(lambda angle: epd(angle, beta, p))


@exactly
def derived_exponent_diffracted(beta, p, b, c):
    """The same of (S * D) for light along the normal at MIDDLE_UM, the lobe to 1e-7 by a polynomial of its logarithm.

    Between `INSIDE` and the horizon; nearer to the normal the lobe is flat.
    """
    low, high = mp.log(INSIDE), mp.log(mp.pi / 2)
    logarithm = interpolant(
        lambda x: mp.log(convolve(mp.exp(low + (high - low) * x), 2 * b / MIDDLE_UM, c, beta, p)), NODES
    )
    return _exponent(lambda angle: mp.exp(logarithm(max(0, (mp.log(angle) - low) / (high - low)))))


def _exponent(lobe):
    """k of a lobe around the normal."""

    def signal(degrees):
        return mp.fsum(lobe(angle) * weight for angle, weight in _footprints(mp.radians(degrees)))

    laws = {degrees: 2 * mp.log(1 - (mp.mpf(degrees) / 90) ** 2) for degrees in range(10, 81, 5)}
    losses = mp.fsum(law * mp.log(signal(degrees) / signal(0)) for degrees, law in laws.items())
    return losses / mp.fsum(law**2 for law in laws.values())


@cache
def _footprints(theta):
    """Angles theta_h and weights of D there in the pixel seen at theta by the standard apparatus: a footprint of 1/200.

    Gauss panels in log theta_h up to 9 footprints, stretched by 1/cos(theta); periodic trapezoid rule in the azimuth.
    """
    width, azimuths = mp.mpf(1) / 200, 128
    turns = [(mp.cos(x), mp.sin(x)) for x in (mp.pi * (j + mp.mpf(1) / 2) / azimuths for j in range(azimuths))]
    points = [mp.log(width) - 9 + j for j in range(9)] + [mp.log(width) + mp.mpf(j) / 2 for j in range(10)]
    points = [x for x in points if x < mp.log(9 * width / mp.cos(theta)) + 1]
    rings = ((mp.exp(log_angle), weight) for log_angle, weight in panels(points, 10))
    return [
        (angle, weight * angle * mp.sin(angle) * _ring(angle, mp.sin(theta), mp.cos(theta), width, turns))
        for angle, weight in rings
    ]


def _ring(angle, sin_t, cos_t, width, turns):
    """Sum over a ring of normals of the footprint's weight, cos_o times a Gaussian, where i and o are above."""
    total, versine = mp.mpf(0), 2 * mp.sin(angle / 2) ** 2
    for cosine, sine in turns:
        along, across = mp.sin(angle) * cosine * cos_t - versine * sin_t, mp.sin(angle) * sine
        cos_o = mp.cos(angle) * cos_t - mp.sin(angle) * cosine * sin_t
        cos_i = mp.cos(angle) * cos_t + mp.sin(angle) * cosine * sin_t
        if min(cos_i, cos_o) > 0:
            total += cos_o * mp.exp(-(along**2 + across**2) / (2 * width**2))
    return total
