"""Microfacet models one pair of directions at a time: D as printed, Smith's G1 from its definition, by scipy.

G1(o) = cos(theta_o) / Int max(0, o.m) D(m) dw_m over the hemisphere of facets m (Ashikhmin et al. 2000; Heitz 2014
Eq. 14): nothing of the slopes' integrals that fast code uses.
"""

import math
from itertools import pairwise

import numpy as np
from scipy.integrate import quad

from .fresnel import fresnel


def beckmann(theta, m):
    return math.exp(-((math.tan(theta) / m) ** 2)) / (math.pi * m**2 * math.cos(theta) ** 4)


def ggx(theta, alpha):
    return alpha**2 / (math.pi * math.cos(theta) ** 4 * (alpha**2 + math.tan(theta) ** 2) ** 2)


def gtr(theta, alpha, gamma):
    """HP15 Table 1."""
    x = math.tan(theta) ** 2
    if gamma == 1:
        p22 = (1 - alpha**2) / (2 * math.pi * math.log(1 / alpha)) / ((1 + x) * (alpha**2 + x))
    else:
        constant = (gamma - 1) * (1 - alpha**2) / (1 - alpha ** (2 * (gamma - 1)))
        p22 = constant * alpha ** (2 * (gamma - 1)) * (1 + x) ** (gamma - 2) / (math.pi * (alpha**2 + x) ** gamma)
    return p22 / math.cos(theta) ** 4


def sgd(theta, alpha, p):
    """HP15 Table 1, with Gamma(1 - p, alpha) by its integral, divided by pi as its Eq. 2 wants it."""
    gamma = quad(lambda t: math.exp(-t) * t**-p, alpha, alpha + 1)[0] + quad(
        lambda t: math.exp(-t) * t**-p, alpha + 1, np.inf
    )[0]  # fmt: skip
    x = math.tan(theta) ** 2
    p22 = alpha ** (p - 1) / gamma * math.exp(-(alpha**2 + x) / alpha) / (alpha**2 + x) ** p
    return p22 / (math.pi * math.cos(theta) ** 4)


def epd(theta, beta, p):
    """HP17 Eq. 34-35."""
    x = math.tan(theta) ** 2
    return p / (math.pi * beta**2 * math.gamma(1 / p)) * math.exp(-((x / beta**2) ** p)) / math.cos(theta) ** 4


def student_t(theta, alpha, gamma):
    """Ribardiere et al. 2017, Eq. 10."""
    x = math.tan(theta) ** 2
    p22 = (gamma - 1) ** gamma * alpha ** (2 * gamma - 2) / (math.pi * ((gamma - 1) * alpha**2 + x) ** gamma)
    return p22 / math.cos(theta) ** 4


def smith_G1(cos_o, D, narrow):
    """By the definition; ``narrow``: a typical slope. 1e-7."""
    sin_o = math.sqrt(1 - cos_o**2)

    def ring(theta):
        """Int max(0, o.m) dphi at theta_m = theta."""
        a, b = cos_o * math.cos(theta), sin_o * math.sin(theta)
        if b <= a:
            return 2 * math.pi * a
        edge = math.acos(-a / b)
        return 2 * (a * edge + b * math.sin(edge))

    def integrand(u):
        theta = math.atan(math.exp(u))
        slope = math.sin(theta) * math.cos(theta)  # dtheta/du
        return ring(theta) * D(theta) * math.sin(theta) * slope

    kink, middle = math.log(cos_o / max(sin_o, 1e-12)), math.log(narrow)
    ends = sorted({middle - 25, middle - 5, middle, middle + 2, middle + 6, kink, 18.0})
    ends = [x for x in ends if middle - 25 <= x <= 18.0]
    total = sum(quad(integrand, a, b, epsabs=0, epsrel=1e-9, limit=400)[0] for a, b in pairwise(ends))
    return cos_o / total


def v_groove(i, o, h):
    """Torrance & Sparrow 1967."""
    return min(1.0, 2 * h[2] * i[2] / (i @ h), 2 * h[2] * o[2] / (i @ h))


def brdf(i, o, D, masking, F0, albedo):
    """F D G / (4 cos_i cos_o) + rho_d / pi with Schlick's F (1/sr); of one channel, or of arrays of them."""
    h = (i + o) / np.linalg.norm(i + o)
    F = F0 + (1 - F0) * (1 - i @ h) ** 5
    return F * D(math.acos(min(h[2], 1.0))) * masking(i, o, h) / (4 * i[2] * o[2]) + albedo / math.pi


def reflectance(i, o, n, k):
    """Exact F at theta_d."""
    return fresnel(np.linalg.norm(i + o) / 2, n, k)
