"""Pairs of directions, and integrals over the microfacet normals both of them see (the skeleton of HP17 Eq. 21, 27)."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .convolution import log_p22, slope_breakpoints
from .quadrature import adaptive, warped


class Geometry(NamedTuple):
    """Cosines and angles of a pair of directions."""

    cos_i: float
    cos_o: float
    cos_d: float
    theta_h: float
    h: np.ndarray


def direction(theta, phi):
    """Unit vector at polar angle theta and azimuth phi."""
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def geometry(i, o):
    """Half-vector frame of a pair; theta_h from the sine and cosine, accurate at both ends."""
    total = i + o
    h = total / np.linalg.norm(total)
    return Geometry(i[2], o[2], np.linalg.norm(total) / 2, math.atan2(math.hypot(h[0], h[1]), h[2]), h)


def facet_integral(i, o, B, c, beta, p, weight):
    """Int weight(i.m, o.m, h.m) (1 + B^2 sin^2 psi)^(-(c+1)/2) D(m) dw_m over the facets that i and o both see.

    psi = angle(h, m). Rings about n, adaptive in log tan(theta_m); on each ring the azimuth from h is cut where i.m or
    o.m changes sign and warped onto h. 1e-8 relative for a positive smooth weight.
    """
    g = geometry(i, o)
    phi_h = math.atan2(g.h[1], g.h[0])
    sides = [(math.hypot(v[0], v[1]), v[2], math.atan2(v[1], v[0]) - phi_h) for v in (i, o)]
    sin_h = math.sin(g.theta_h)
    pole = np.cross(i, o)
    length = np.linalg.norm(pole)
    others = [math.asin(min(1.0, v[2])) for v in (i, o)] + ([math.acos(abs(pole[2]) / length)] if length > 0 else [])

    def rings(t):
        x = np.exp(2 * t)
        cos_m = 1 / np.sqrt(1 + x)
        theta_m, sin_m = np.arctan(np.exp(t)), np.exp(t) * cos_m
        delta = theta_m - g.theta_h
        cuts = [np.zeros_like(t), np.full_like(t, -np.pi), np.full_like(t, np.pi)]
        with np.errstate(divide="ignore", over="ignore"):
            width = np.sqrt((1 / B**2 + np.sin(delta) ** 2) / (sin_h * sin_m))
            for sine, cosine, azimuth in sides:
                half = (
                    np.arccos(np.clip(-cosine * cos_m / (sine * sin_m), -1, 1)) if sine > 0 else np.full_like(t, np.pi)
                )
                cuts += [(azimuth + sign * half + np.pi) % (2 * np.pi) - np.pi for sign in (-1, 1)]
        cuts = np.sort(np.array(cuts), axis=0)
        total = np.zeros_like(t)
        for start, end in pairwise(cuts):
            phi, w = warped(start, end, width, panels=10, order=12)
            lit = [cosine * cos_m[:, None] + sine * sin_m[:, None] * np.cos(phi - a) for sine, cosine, a in sides]
            v = np.sin(delta / 2)[:, None] ** 2 + sin_h * sin_m[:, None] * np.sin(phi / 2) ** 2
            s = (1 + B**2 * 4 * v * (1 - v)) ** (-(c + 1) / 2)
            both = (lit[0] > 0) & (lit[1] > 0)
            total += np.sum(np.where(both, w * s * weight(lit[0], lit[1], 1 - 2 * v), 0), axis=1)
        return np.exp(log_p22(x, beta, p) + 2 * t) / cos_m * total

    return adaptive(rings, slope_breakpoints(g.theta_h, B, c, beta, p, others), rtol=1e-9)
