"""Rival models fitted through the common interface, as their papers write them, for unit vectors i and o."""

import math

import numpy as np


def ggx(i, o, alpha, F0, albedo):
    """Walter et al. 2007, Eq. 20, 33, 34 with Schlick's F, over Lambert's body; one channel (1/sr)."""
    h = (i + o) / np.linalg.norm(i + o)
    tan2 = (1 - h[2] ** 2) / h[2] ** 2
    D = alpha**2 / (math.pi * h[2] ** 4 * (alpha**2 + tan2) ** 2)
    G = math.prod(2 / (1 + math.sqrt(1 + alpha**2 * (1 - v[2] ** 2) / v[2] ** 2)) for v in (i, o))
    F = F0 + (1 - F0) * (1 - i @ h) ** 5
    return F * D * G / (4 * i[2] * o[2]) + albedo / math.pi


def oren_nayar_qualitative(i, o, sigma, albedo):
    """Oren & Nayar 1994, Eq. 17 (radiance over irradiance), in angles; one channel (1/sr)."""
    theta_i, theta_o = math.acos(i[2]), math.acos(o[2])
    difference = math.atan2(i[1], i[0]) - math.atan2(o[1], o[0])
    A = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    B = 0.45 * sigma**2 / (sigma**2 + 0.09)
    large, small = max(theta_i, theta_o), min(theta_i, theta_o)
    return albedo / math.pi * (A + B * max(0.0, math.cos(difference)) * math.sin(large) * math.tan(small))
