"""The K-correlation diffraction lobe and its renormalisation, HP17 Eq. 9 and 16-20 with the errata.

Lobe, not spectrum: Eq. 16 integrates to sigma_s^2 over f; divided by sigma_s^2 lambda^2 it integrates to one over the
projected outgoing directions, since cos_o dw_o = lambda^2 d^2f.
"""

import mpmath as mp
import numpy as np

from .quadrature import adaptive, geometric, warped


def s_hs(f, wavelength, b, c, renormalised_by=1.0):
    """Lobe value at f in 1/um; `renormalised_by` is sigma_rel^2/sigma_s^2 (Eq. 17), 1 for the bare lobe."""
    return (c - 1) / (2 * np.pi) * (b / wavelength) ** 2 * (1 + (b * f) ** 2) ** (-(c + 1) / 2) / renormalised_by


def renormalisation(sin_theta, b_over_lambda, c):
    """sigma_rel^2/sigma_s^2: the bare lobe integrated over the unit disc of outgoing projections (Eq. 18-19), to 1e-10.

    Two-dimensional, polar about the centre of the disc; the lobe is centred at distance sin_theta. The azimuth rule is
    warped onto the lobe, the radius is adaptive and split geometrically about it.
    """
    kappa, s = float(b_over_lambda), float(sin_theta)

    def ring(radius):
        offset2 = 1 / kappa**2 + (radius - s) ** 2
        with np.errstate(divide="ignore"):
            width = np.sqrt(offset2 / (radius * s))
        phi, weight = warped(np.zeros_like(radius), np.full_like(radius, np.pi), width)
        distance2 = (radius - s)[:, None] ** 2 + 4 * s * radius[:, None] * np.sin(phi / 2) ** 2
        lobe = (c - 1) / (2 * np.pi) * kappa**2 * (1 + kappa**2 * distance2) ** (-(c + 1) / 2)
        return 2 * radius * np.sum(weight * lobe, axis=1)

    points = np.clip(np.concatenate([[0.0, 1.0], geometric(s, 1 / kappa, 1.0)]), 0, 1)
    return adaptive(ring, points, rtol=1e-12)


def renormalisation_rings(sin_theta, b_over_lambda, c):
    """The same as rings about the lobe: the inner disc in closed form, the cut rings in mpmath. To 1e-13."""
    with mp.workdps(30):
        kappa, s, c = mp.mpf(b_over_lambda), mp.mpf(sin_theta), mp.mpf(c)
        inner = 1 - (1 + (kappa * (1 - s)) ** 2) ** (-(c - 1) / 2)
        if s == 0:
            return float(inner)

        def cut_ring(angle):
            # r from 1 - s to 1 + s, by an angle that takes the square-root ends of the arc length away
            r = (1 - s) + 2 * s * mp.sin(angle / 2) ** 2
            arc = 2 * mp.acos(max(mp.mpf(-1), min(mp.mpf(1), (r**2 - (1 - s) * (1 + s)) / (2 * r * s))))
            return (1 + (kappa * r) ** 2) ** (-(c + 1) / 2) * r * arc * s * mp.sin(angle)

        # at s = 1 the rings reach the peak itself, r ~ angle^2/2: split where r is of the order 1/kappa
        knee = mp.sqrt(2 / kappa)
        pieces = sorted({mp.mpf(0), mp.pi, *(a for a in (knee / 16, knee / 4, knee, 4 * knee, mp.pi / 2) if a < mp.pi)})
        return float(inner + (c - 1) / (2 * mp.pi) * kappa**2 * mp.quad(cut_ring, pieces))
