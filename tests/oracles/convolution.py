"""The spherical convolution (S*D)(theta_h) of HP17 Eq. 32-33, amplitude left out, three ways.

    (S*D)(theta_h) = Int_hemisphere S(angle(h, m)) D(m) dw_m,
    S(psi) = (1 + B^2 sin^2 psi)^(-(c+1)/2) cos^2 psi for psi < pi/2, 0 beyond,  B = 2 b cos_d / lambda,

with D the exponential power distribution (Eq. 34-35): no foreshortening cosine, facets above the horizon only.
"""

import math

import numpy as np
from scipy.special import gammaln

from .quadrature import adaptive, geometric, warped


def log_p22(x, beta, p):
    """Logarithm of P22 (HP17 Eq. 35) at x = tan^2(theta)."""
    return math.log(p / (math.pi * beta**2)) - gammaln(1 / p) - np.minimum((x / beta**2) ** p, 1e4)


def slope_breakpoints(theta_h, B, c, beta, p, others=()):
    """Breakpoints in t = log tan(theta_m): unit steps, the ring at theta_h of width 1/B, and the angles `others`."""
    low = math.log(1e-9 * min(beta, 1 / B))  # the slope disc left out holds 1e-18 of anything
    # D must outlast the power-law tail it competes with, (1 + B^2)^(-(c+1)/2), and its own growth x^(3/2) dlog x
    fall = 60 + (c + 1) * math.log1p(B) + 2 / p * math.log(10 + 2 / p)
    exponent = fall
    for _ in range(20):
        exponent = fall + 1.5 / p * math.log(exponent)
    high = math.log(beta) + math.log(exponent) / (2 * p)
    angles = np.concatenate(
        [geometric(theta_h, 1 / B, math.pi), [math.pi / 2 - theta_h], np.asarray(others, dtype=float)]
    )
    angles = angles[(angles > 0) & (angles < math.pi / 2)]
    points = np.concatenate([np.linspace(low, high, math.ceil(high - low) + 1), np.log(np.tan(angles))])
    return points[(points >= low) & (points <= high)]


def ring_of_s(theta_m, sin_m, cos_m, theta_h, B, c):
    """Integral of S over the azimuth of m, all normals at polar angle theta_m (array)."""
    sin_h, cos_h = math.sin(theta_h), math.cos(theta_h)
    delta, product = theta_m - theta_h, sin_h * sin_m
    with np.errstate(divide="ignore", over="ignore"):
        width = np.sqrt((1 / B**2 + np.sin(delta) ** 2) / product)
        horizon = np.arccos(np.clip(-cos_h * cos_m / product, -1, 1))
    phi, weight = warped(np.zeros_like(theta_m), horizon, width)
    # sin^2(psi/2) without cancellation, however close m is to h
    v = np.sin(delta / 2)[:, None] ** 2 + product[:, None] * np.sin(phi / 2) ** 2
    return 2 * np.sum(weight * (1 + B**2 * 4 * v * (1 - v)) ** (-(c + 1) / 2) * (1 - 2 * v) ** 2, axis=1)


def convolve(theta_h, B, c, beta, p, ring=ring_of_s):
    """(S*D)(theta_h) as rings about n: adaptive in log tan(theta_m), each ring by the warped rule. 1e-9 relative.

    D dw_m = P22(x) sqrt(1 + x) d^2 slope, d^2 slope = x dt dphi: no precision is lost near the horizon. Domain: beta
    1e-4..2, p 0.12..5, c 1.001..8, B 1e-3..2e4, theta_h 0..pi/2.
    """

    def rings(t):
        x = np.exp(2 * t)
        cos_m = 1 / np.sqrt(1 + x)
        density = np.exp(log_p22(x, beta, p) + 2 * t) / cos_m
        return density * ring(np.arctan(np.exp(t)), np.exp(t) * cos_m, cos_m, theta_h, B, c)

    return adaptive(rings, slope_breakpoints(theta_h, B, c, beta, p))


def convolve_about_h(theta_h, B, c, beta, p):
    """The same as rings about h: adaptive in log tan(psi), and a nested adaptive integral of D over each ring.

    Shares only the adaptive rule with `convolve`. Seconds per point; 1e-8 relative, for p >= 0.3 (below, the mass of D
    sits within a few float spacings of the horizon, which this frame does not resolve).
    """
    sin_h, cos_h = math.sin(theta_h), math.cos(theta_h)

    def ring_of_d(psi):
        product, cos_mid = sin_h * math.sin(psi), cos_h * math.cos(psi)
        # (sin_h sin_psi) = 0 leaves cos_m constant, and above the horizon
        horizon = math.pi if cos_mid >= product else math.acos(-cos_mid / product)

        def density(chi):
            v = math.sin((psi - theta_h) / 2) ** 2 + product * np.sin(chi / 2) ** 2
            cos_m = np.maximum(1 - 2 * v, 1e-9)
            return np.exp(log_p22(4 * v * (1 - v) / cos_m**2, beta, p) - 4 * np.log(cos_m))

        steps = 4.0 ** -np.arange(1, 18)
        return 2 * adaptive(density, horizon * np.concatenate([[0, 1], steps, 1 - steps]), rtol=1e-9)

    def rings(t):
        psi = np.arctan(np.exp(t))
        s = (1 + (B * np.sin(psi)) ** 2) ** (-(c + 1) / 2) * np.cos(psi) ** 2
        return s * np.sin(psi) ** 2 * np.cos(psi) * np.array([ring_of_d(angle) for angle in psi])

    low, high = math.log(1e-8 * min(beta, 1 / B)), 20.0
    angles = np.concatenate([geometric(theta_h, beta, math.pi), [math.pi / 2 - theta_h, math.atan(1 / B)]])
    angles = angles[(angles > 0) & (angles < math.pi / 2)]
    points = np.concatenate([np.arange(low, high, 2.0), [high], np.log(np.tan(angles))])
    return adaptive(rings, points[(points >= low) & (points <= high)], rtol=1e-8)


def convolve_brute(theta_h, B, c, beta, p, n_polar=4000, n_azimuth=2000):
    """The same by midpoints on a plain grid of (theta_m, phi_m): 1e-6 relative where beta and 1/B exceed about 0.1."""
    theta = (np.arange(n_polar) + 0.5) / n_polar * math.pi / 2
    phi = (np.arange(n_azimuth) + 0.5) / n_azimuth * math.pi
    density = np.exp(log_p22(np.tan(theta) ** 2, beta, p)) / np.cos(theta) ** 4 * np.sin(theta)
    total = 0.0
    for angle, weight in zip(theta, density, strict=True):
        cos_psi = math.cos(theta_h) * math.cos(angle) + math.sin(theta_h) * math.sin(angle) * np.cos(phi)
        cos_psi = np.maximum(cos_psi, 0)
        total += weight * np.sum((1 + B**2 * (1 - cos_psi**2)) ** (-(c + 1) / 2) * cos_psi**2)
    return float(total * (math.pi / 2 / n_polar) * (2 * math.pi / n_azimuth))
