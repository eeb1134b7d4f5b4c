"""Zonal harmonics of HP17 Appendix A (Eq. 61-64) with scipy, one coefficient and one term at a time."""

import math

import numpy as np
from scipy.special import eval_legendre

from .convolution import log_p22
from .quadrature import adaptive

LOW, HIGH = math.log(1e-9), math.log(1e9)  # tangents of the angles integrated over


def harmonic(degree, cos_theta):
    """Y_l^0 (Eq. 61)."""
    return math.sqrt((2 * degree + 1) / (4 * math.pi)) * eval_legendre(degree, cos_theta)


def coefficient(function, degree, rtol=1e-11):
    """Int over the hemisphere of function(theta) Y_l^0 domega (Eq. 62-63) for function >= 0.

    `function` is given t = log tan(theta), in which sin(theta) dtheta = sin^2 cos dt. |P_l| <= 1, so that
    f (1 + P_l) and f are both of one sign, as the adaptive rule wants; the coefficient is their difference. Panels
    start no longer than a period of P_l. Correct to about rtol times the coefficient of degree 0.
    """
    waves = max(2, degree)
    angles = np.linspace(0, math.pi / 2, waves + 1)[1:-1]
    points = np.concatenate([np.arange(LOW, HIGH, 0.5), [HIGH], np.log(np.tan(angles))])

    def moment(factor):
        def integrand(t):
            cos = 1 / np.sqrt(1 + np.exp(2 * t))
            # log of sin^2 cos: no overflow at either end
            measure = np.exp(2 * t) * cos**3
            return function(t) * measure * factor(cos)

        return adaptive(integrand, points, rtol=rtol)

    norm = 2 * math.pi * math.sqrt((2 * degree + 1) / (4 * math.pi))
    plain = moment(np.ones_like)
    return norm * (plain if degree == 0 else moment(lambda cos: 1 + eval_legendre(degree, cos)) - plain)


def normals(beta, p):
    """D (Eq. 34-35) as a function of log tan(theta)."""
    return lambda t: np.exp(log_p22(np.exp(2 * t), beta, p) + 2 * np.log1p(np.exp(2 * t)))


def lobe(B, c):
    """S of Eq. 33, no amplitude, as a function of log tan(theta)."""

    def value(t):
        cos2 = 1 / (1 + np.exp(2 * t))
        return (1 + B**2 * (1 - cos2)) ** (-(c + 1) / 2) * cos2

    return value


def truncated(theta_h, B, c, beta, p, order, factor=lambda degree: math.sqrt(4 * math.pi / (2 * degree + 1))):
    """Eq. 64 summed to degree `order` at one half angle or an array of them."""
    cos_h, total = np.cos(theta_h), 0.0
    for degree in range(order + 1):
        S, D = coefficient(lobe(B, c), degree), coefficient(normals(beta, p), degree)
        total = total + S * D * factor(degree) * harmonic(degree, cos_h)
    return total
