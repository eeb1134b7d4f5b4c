"""Directional albedo of one facet's diffraction lobe at |F| = 1 (HP17 Eq. 22-23 or, with Eq. 30, 32) by brute force."""

import math

import numpy as np
from scipy.interpolate import CubicSpline

from .diffraction import renormalisation, s_hs
from .quadrature import adaptive, geometric, warped


def relative_variances(b_over_lambda, c, nodes=150):
    """sigma_rel^2/sigma_s^2 as a function of cos_d: a spline through 150 oracle values, to 1e-6."""
    longest = math.asinh(b_over_lambda)
    gaps = np.sinh(np.linspace(0, longest, nodes)) / b_over_lambda
    spline = CubicSpline(
        np.arcsinh(b_over_lambda * gaps), [renormalisation(max(0.0, 1 - g), b_over_lambda, c) for g in gaps]
    )
    return lambda cos_d: spline(np.arcsinh(b_over_lambda * cos_d**2 / (1 + np.sqrt(np.maximum(1 - cos_d**2, 0)))))


def lobe_albedo(theta, wavelength, b, c, sigma_s, renormalised=True, exact=False):
    """Int over |o_p| <= 1 of (1 - A) S_HS(|i_p + o_p|/lambda) d^2 o_p for light at `theta` from the facet's normal.

    Rings about the centre of the disc of projected viewers, adaptive in their radius, warped onto the mirror direction.
    """
    s, cos_i = math.sin(theta), math.cos(theta)
    share_at = relative_variances(b / wavelength, c) if renormalised else lambda cos_d: np.ones_like(cos_d)

    def rings(radius):
        width = np.sqrt(((wavelength / b) ** 2 + (radius - s) ** 2) / np.maximum(radius * s, 1e-300))
        phi, weight = warped(np.zeros_like(radius), np.full_like(radius, np.pi), width)
        radius = radius[:, None]
        distance2 = (radius - s) ** 2 + 4 * s * radius * np.sin(phi / 2) ** 2
        cos_o = np.sqrt(np.maximum(1 - radius**2, 0))
        cos_d = np.sqrt(np.maximum((1 + cos_i * cos_o - s * radius * np.cos(phi)) / 2, 1e-300))
        cos_h = (cos_i + cos_o) / (2 * cos_d)
        share = share_at(cos_d)
        phase = share * (4 * np.pi * sigma_s * cos_d / wavelength) ** 2
        taken = 1 - np.exp(-phase * cos_h**2) if exact else (1 - np.exp(-phase)) * cos_h**2
        lobe = s_hs(np.sqrt(distance2) / wavelength, wavelength, b, c, share)
        return 2 * radius[:, 0] * np.sum(weight * lobe * taken, axis=1)

    points = np.clip(np.concatenate([[0.0, 1.0], geometric(s, wavelength / b, 1.0), 1 - 0.1 ** np.arange(1, 8)]), 0, 1)
    return adaptive(rings, points, rtol=1e-8)
