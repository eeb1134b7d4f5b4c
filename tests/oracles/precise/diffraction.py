"""The K-correlation lobe of the small scale: its peak, its mass on the disc and what it takes from the mirror term."""

import mpmath as mp

from .arithmetic import exactly
from .quadrature import panels


def rays(sin_theta, cos2_theta, ladder, order):
    """Rule over directions phi in which to leave the lobe's centre, at sin(theta) from that of the unit disc.

    Half of them, by symmetry, in panels that end at ``ladder`` around phi = pi/2: for light at the horizon the boundary
    has a corner there.

    Yields:
        x = sin(theta) cos(phi), half the chord along phi, the distance rho to the boundary, and the weight.
    """
    edges = [*(mp.pi / 2 - x for x in ladder), *(mp.pi / 2 + x for x in ladder)]
    for phi, weight in panels(sorted([mp.mpf(0), mp.pi / 2, mp.pi, *edges]), order):
        x, half = sin_theta * mp.cos(phi), mp.sqrt(1 - (sin_theta * mp.sin(phi)) ** 2)
        yield x, half, cos2_theta / (x + half) if x > 0 else half - x, weight


@exactly
def renormalisation(sin_theta, b_over_lambda, c):
    """sigma_rel^2/sigma_s^2, HP17 Eq. 17-19: the lobe's mass on the unit disc, seen from the lobe's centre.

    In direction phi from there the disc reaches as far as rho(phi), and up to that radius the lobe's mass is known:
    1/pi Int_0^pi 1 - (1 + (b rho/lambda)^2)^(-(c-1)/2) dphi.
    """
    total, ladder = mp.mpf(0), [mp.mpf(4) ** -j for j in range(12)]
    for _, _, rho, weight in rays(sin_theta, (1 - sin_theta) * (1 + sin_theta), ladder, 20):
        total -= weight * mp.expm1(-(c - 1) / 2 * mp.log1p((b_over_lambda * rho) ** 2))
    return total / mp.pi


@exactly
def lobe_amplitude(b_over_lambda, c):
    """Peak of the K-correlation lobe."""
    return (c - 1) / (2 * mp.pi) * b_over_lambda**2


@exactly
def lobe(theta_h, B, c):
    """K-correlation lobe at theta_h, with the cos^2 of HP17 Eq. 33."""
    return (1 + (B * mp.sin(theta_h)) ** 2) ** (-(c + 1) / 2) * mp.cos(theta_h) ** 2


def phase_variance(share, sigma_s, cos_theta, wavelength_um):
    """(4 pi sigma_rel cos(theta)/lambda)^2; ``share`` is that of sigma_rel^2 in sigma_s^2."""
    return share * (4 * mp.pi * sigma_s * cos_theta / wavelength_um) ** 2


@exactly
def specular_share(theta_d, wavelength_um, b, c, sigma_s):
    """A_spec, HP17 Eq. 25, with sigma_rel at theta_d."""
    share = renormalisation(mp.sin(theta_d), b / wavelength_um, c)
    return mp.exp(-phase_variance(share, sigma_s, mp.cos(theta_d), wavelength_um))
