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


def interfaced_lambertian(i, o, roughness, n, albedo, normals, grooves, slopes=300, azimuths=360):
    """Body of Meneveaux et al. 2017, Eq. 8 and 12, by a midpoint rule over facets, each as a vector.

    ``roughness`` along x and y. Smith's masking by its definition, Eq. 18, with the same rule.
    """
    u = (np.arange(slopes) + 0.5) / slopes
    turn = (np.arange(azimuths) + 0.5) / azimuths * 2 * math.pi
    if normals == "gaussian":
        slope = u * min(6 * roughness[0], math.pi / 2)
        share = np.exp(-(slope**2) / (2 * roughness[0] ** 2)) * np.sin(slope)
        tangents = [np.tan(slope)] * 2
    else:
        radius = 6 * u if normals == "beckmann" else np.tan(u * math.pi / 2)
        share = radius * np.exp(-(radius**2)) if normals == "beckmann" else np.sin(u * math.pi)
        tangents = [x * radius for x in roughness]
    share = (share / share.sum() / azimuths)[:, None] * np.ones(azimuths)
    x, y = tangents[0][:, None] * np.cos(turn), tangents[1][:, None] * np.sin(turn)
    a = np.stack([x, y, np.ones_like(x)], -1) / np.sqrt(1 + x**2 + y**2)[..., None]
    dots = [np.maximum(a @ v, 0.0) for v in (i, o)]
    if grooves:
        with np.errstate(divide="ignore"):
            mask = np.minimum(1, np.minimum(*(2 * v[2] * a[..., 2] / dot for v, dot in zip((i, o), dots, strict=True))))
    else:
        mask = np.prod([v[2] / np.sum(share * dot / a[..., 2]) for v, dot in zip((i, o), dots, strict=True)])
    through = [dot * (1 - _dielectric(dot, n)) for dot in dots]
    cosines, step = (np.arange(20_000) + 0.5) / 20_000, 1 / 20_000
    r_e = np.sum(_dielectric(cosines, n) * 2 * cosines) * step  # Eq. 10's integral
    r_i = 1 - (1 - r_e) / n**2
    seen = np.sum(share / a[..., 2] * through[0] * through[1] * mask) / (i[2] * o[2])
    return albedo / (math.pi * n**2 * (1 - r_i * albedo)) * seen


def _dielectric(c, n):
    """Eq. 7, as printed."""
    g = np.sqrt(n**2 + c**2 - 1)
    ratio = np.divide(c * (g + c) - 1, c * (g - c) + 1)
    return np.where(c > 0, ((g - c) / (g + c)) ** 2 / 2 * (1 + ratio**2), 1.0)
