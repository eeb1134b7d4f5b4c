"""Oren & Nayar's models as their paper writes them, for unit vectors i and o; one channel (1/sr)."""

import math

import numpy as np


def oren_nayar_qualitative(i, o, sigma, albedo):
    """Oren & Nayar 1994, Eq. 17 (radiance over irradiance), in angles; one channel (1/sr)."""
    theta_i, theta_o = math.acos(i[2]), math.acos(o[2])
    difference = math.atan2(i[1], i[0]) - math.atan2(o[1], o[0])
    A = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    B = 0.45 * sigma**2 / (sigma**2 + 0.09)
    large, small = max(theta_i, theta_o), min(theta_i, theta_o)
    return albedo / math.pi * (A + B * max(0.0, math.cos(difference)) * math.sin(large) * math.tan(small))


def oren_nayar_functional(i, o, sigma, albedo):
    """Eq. 14-16 in angles, over E0 cos(theta_i)."""
    theta_i, theta_o = math.acos(i[2]), math.acos(o[2])
    phi = math.atan2(i[1], i[0]) - math.atan2(o[1], o[0])
    alpha, beta, s2 = max(theta_i, theta_o), min(theta_i, theta_o), sigma**2
    C1 = 1 - 0.5 * s2 / (s2 + 0.33)
    C2 = 0.45 * s2 / (s2 + 0.09) * (math.sin(alpha) - ((2 * beta / math.pi) ** 3 if math.cos(phi) < 0 else 0))
    C3 = 0.125 * s2 / (s2 + 0.09) * (4 * alpha * beta / math.pi**2) ** 2
    L1 = C1 + C2 * math.cos(phi) * math.tan(beta) + C3 * (1 - abs(math.cos(phi))) * math.tan((alpha + beta) / 2)
    L2 = 0.17 * s2 / (s2 + 0.13) * (1 - math.cos(phi) * (2 * beta / math.pi) ** 2)
    return albedo / math.pi * L1 + albedo**2 / math.pi * L2


def cavities(i, o, sigma, albedo, slopes=400, azimuths=720, bounces=True):
    """Eq. 4-13 by a midpoint rule over facets, each as a vector; interreflection by its kernel (Eq. 8), not Eq. 11."""
    slope = (np.arange(slopes) + 0.5) / slopes * min(6 * sigma, math.pi / 2)
    share = np.exp(-(slope**2) / (2 * sigma**2)) * np.sin(slope)
    share /= share.sum() * azimuths
    turn = (np.arange(azimuths) + 0.5) / azimuths * 2 * math.pi
    t, p = np.meshgrid(slope, turn, indexing="ij")
    a = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1)
    opposite = a * [-1, -1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        gaf = np.minimum(1, np.minimum(2 * i[2] * a[..., 2] / (a @ i), 2 * o[2] * a[..., 2] / (a @ o)))
        direct = np.where((a @ i > 0) & (a @ o > 0), (a @ i) * (a @ o) / (a[..., 2] * o[2]) * np.maximum(gaf, 0), 0)
        total = albedo / math.pi * np.sum(share[:, None] * direct)
        if bounces:
            hidden = np.clip(1 - 2 * o[2] * a[..., 2] / (a @ o), 0, 1)
            dark = np.clip(1 - 2 * i[2] * opposite[..., 2] / (opposite @ i), 0, 1)
            factor = _kernel(hidden, dark, t)
            again = np.where(
                (opposite @ i > 0) & (a @ o > 0), (opposite @ i) * (a @ o) / (a[..., 2] * o[2]) * factor, 0
            )
            total += (albedo / math.pi) ** 2 * np.sum(share[:, None] * again)
    return total / i[2]


def _kernel(hidden, dark, slope, count=16):
    """Int of Eq. 8 over the seen part of a facet and the lit part of its neighbour, by a Gauss rule."""
    u, w = np.polynomial.legendre.leggauss(count)
    u, w = (u + 1) / 2, w / 2
    u, w = u**3, 3 * u**2 * w  # crowded where the facets meet
    total = np.zeros_like(hidden)
    for k in range(count):
        x = hidden + (1 - hidden) * u[k]
        for m in range(count):
            y = dark + (1 - dark) * u[m]
            distance = x**2 + 2 * x * y * np.cos(2 * slope) + y**2
            total += w[k] * w[m] * math.pi / 2 * np.sin(2 * slope) ** 2 * x * y / distance**1.5
    return total * (1 - hidden) * (1 - dark)
