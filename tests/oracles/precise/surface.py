"""Microfacet normals and what they hide: the exponential power distribution, Smith's Lambda and masking."""

import mpmath as mp

from .arithmetic import DIGITS, exactly


def peak(beta, p):
    """Value of the exponential power distribution at theta = 0."""
    return p / (mp.pi * beta**2 * mp.gamma(1 / p))


@exactly
def epd(theta, beta, p):
    """Exponential power distribution, HP17 Eq. 34-35; 0 at and beyond the horizon."""
    if mp.cos(theta) <= 0:
        return mp.mpf(0)
    return peak(beta, p) * mp.exp(-((mp.tan(theta) / beta) ** (2 * p))) / mp.cos(theta) ** 4


@exactly
def smith_lambda(tau, p):
    """Lambda of HP17 Eq. 36-37, q over the whole line, in w = s tau = cosh(v):

    2 p/(pi Gamma(1/p)) tau^-2 Int_0^inf cosh v sinh v exp(-(cosh v/tau)^(2p)) [sinh v - atan(sinh v)] dv.

    The integrand is even and analytic for |Im v| < pi/2, of double exponential decay: a trapezoid rule over the line.
    """
    if tau == 0:
        return mp.mpf(0)
    start = tau ** (-2 * p)
    if start > 10**6:
        return mp.mpf(0)
    with mp.workdps(DIGITS + 10):
        # e^(-2 pi strip/step), and the Gaussian of variance 1/(2 p start) that is left where the exponent is large
        strip = min(mp.pi / 2, mp.pi / (4 * p)) / mp.mpf(1.2)
        step = min(2 * mp.pi * strip, mp.pi**2 / mp.sqrt(80 * p * (start + 15))) / 80
        step = min(step, mp.mpf(1) / 8)
        end = mp.acosh(tau * (start + 90 + 20 / p) ** (1 / (2 * p)))
        total = mp.mpf(0)
        for j in range(1, int(end / step) + 2):
            up = mp.exp(j * step)
            w, z = (up + 1 / up) / 2, (up - 1 / up) / 2
            total += w * z * mp.exp(start - (w / tau) ** (2 * p)) * (z - mp.atan(z))
        return 2 * p / (mp.pi * mp.gamma(1 / p)) * total * step * mp.exp(-start) / tau**2


@exactly
def masking(cos_theta, beta, p):
    """Smith's G1, HP17 Eq. 38."""
    if cos_theta <= 0:
        return mp.mpf(0)
    return 1 / (1 + smith_lambda(beta * mp.sqrt(1 - cos_theta**2) / cos_theta, p))


def shadowing(kind, cos_i, cos_o, beta, p):
    """G of both directions: Smith's, height-correlated (Heitz 2014 Eq. 99) or 1."""
    if kind == "none":
        return mp.mpf(1)
    hidden = [1 / masking(cos, beta, p) - 1 for cos in (cos_i, cos_o)]
    return 1 / (1 + sum(hidden)) if kind == "height_correlated" else 1 / ((1 + hidden[0]) * (1 + hidden[1]))
