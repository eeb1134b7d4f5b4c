"""A facet's own lobe, for the conserving split: what it takes of the light that a facet meets."""

from functools import cache

import mpmath as mp

from .arithmetic import exactly
from .chebyshev import interpolant
from .diffraction import rays, renormalisation
from .quadrature import panels


@cache
def renormalisation_of(b_over_lambda, c):
    """`renormalisation` as a function of cos^2(theta_d): interpolated to 1e-12 in asinh(b/lambda (1 - sin theta_d))."""
    longest = mp.asinh(b_over_lambda)
    along = interpolant(lambda x: renormalisation(1 - mp.sinh(x * longest) / b_over_lambda, b_over_lambda, c), 40)
    return lambda cos2: along(mp.asinh(b_over_lambda * cos2 / (1 + mp.sqrt(1 - cos2))) / longest)


@exactly
def lobe_albedo(theta_d, wavelength_um, b, c, sigma_s, renormalised, exact, order=10):
    """Directional albedo of a facet's own lobe at |F| = 1, light at theta_d: Int (1 - A) S_HS d^2 o_p over the disc.

    Along rays from the lobe's centre to the boundary of the disc, in v of asinh(b r/lambda) = T sin^2(v): cos_o has its
    root at the boundary, and grazing light one at the centre. (1 - A) is (1 - A_spec) cos^2(theta_h), or that of Eq. 23
    where ``exact``. To 1e-5, mostly 1e-9.
    """
    ratio, s, cos_i = b / wavelength_um, mp.sin(theta_d), mp.cos(theta_d)
    share_of = renormalisation_of(ratio, c) if renormalised else lambda cos2: mp.mpf(1)
    strength, total = (4 * mp.pi * sigma_s / wavelength_um) ** 2, mp.mpf(0)
    ladder = [x for x in (mp.mpf(4) ** -j for j in range(10)) if 8 * x > cos_i]
    for x, half, rho, weight in rays(s, cos_i**2, ladder, order):
        end = mp.asinh(ratio * rho)
        count = int(end / 2) + 2
        for v, dv in panels([mp.pi / 2 * j / count for j in range(count + 1)], order):
            t = end * mp.sin(v) ** 2
            r = mp.sinh(t) / ratio
            cos_o = mp.sqrt(max((rho - r) * (r + x + half), mp.mpf(0)))
            cos2_d = (1 + cos_i * cos_o - s**2 - r * x) / 2
            cos2_h = (cos_i + cos_o) ** 2 / (4 * cos2_d)
            share = share_of(cos2_d)
            phase = strength * share * cos2_d
            taken = -mp.expm1(-phase * cos2_h) if exact else -mp.expm1(-phase) * cos2_h
            total += weight * dv * mp.sin(2 * v) * end * mp.tanh(t) * mp.cosh(t) ** (1 - c) * taken / share
    return (c - 1) / mp.pi * total


@cache
def lobe_albedo_of(*facet):
    """`lobe_albedo` as a function of theta_d/(pi/2), to 1e-5."""
    return interpolant(lambda x: lobe_albedo(x * mp.pi / 2, *facet, order=6), 20)
