"""Smith's Lambda of the exponential power distribution, HP17 Eq. 36-38, three ways.

tau = beta tan(theta). The printed Eq. 36 starts its q-integral at 0; it runs over the whole line.
"""

import math

import mpmath as mp
import numpy as np
from scipy.special import gammaln


def slope_marginal(r, p, step=None):
    """P2(r) of HP17 Eq. 36 over the whole q line, for an array of r > 0.

    q = r sinh(t) makes the integrand r cosh(t) exp(-(r cosh t)^(2p)), double-exponentially small at both ends and
    analytic in a strip of half-width pi/(4 p) or more: the trapezoid rule is then exponentially accurate.
    """
    r = np.asarray(r, dtype=float)[:, None]
    step = trapezoid_step(p, r.min()) if step is None else step
    # beyond this the exponent has grown by 60 over its value at q = 0
    longest = ((r.min() ** (2 * p) + 60 + 6 / p) ** (1 / (2 * p))) / r.min()
    t = np.arange(0.0, math.acosh(longest) + step, step)
    weight = np.where(t == 0, 1.0, 2.0) * step
    radius = r * np.cosh(t)
    exponent = np.minimum(radius ** (2 * p), 1e4)
    return p / math.pi * np.exp(-gammaln(1 / p)) * np.sum(weight * radius * np.exp(-exponent), axis=1)


def trapezoid_step(p, r):
    """Step at which the trapezoid rule's error is below e^-45 for both integrals, r being the least radius.

    exp(-2 pi strip / step) with strip = min(1, pi / (4 p)) / 1.3, and, where exp(-(r cosh t)^(2p)) is a narrower
    Gaussian, exp(-(pi / step)^2 / (p r^(2p))); radii whose exponent is 15 greater carry nothing.
    """
    return min(2 * math.pi * min(1.0, math.pi / (4 * p)) / 1.3 / 45, math.pi / math.sqrt(45 * p * (r ** (2 * p) + 15)))


def smith_lambda(tau, p, marginal=slope_marginal, refine=1):
    """Lambda by the double integral of HP17 Eq. 36-37 (q over the whole line): 1e-11 relative for p in 0.12..5.

    r = (1 + e^u)/tau covers the half line from 1/tau with exponential decay at both ends, so the trapezoid rule applies
    again. `refine` divides both steps, to let a test see the convergence.
    """
    if (1 / tau) ** (2 * p) > 745:  # exp underflows
        return 0.0
    step = trapezoid_step(p, 1 / tau) / refine
    top = ((1 / tau) ** (2 * p) + 60 + 8 / p * math.log(10 + 8 / p)) ** (1 / (2 * p))
    u = np.arange(-20.0, math.log(max(top * tau - 1, 1.0)) + 1, step)  # e^(2u) at -20: 4e-18
    total = 0.0
    for part in np.array_split(u, max(1, u.size // 100)):
        total += np.sum(np.exp(2 * part) / tau * marginal((1 + np.exp(part)) / tau, p, step)) * step
    return float(total)


def smith_lambda_single(tau, p):
    """Lambda as one integral, 2 Int_{s > 1/tau} s P22(s^2) [sqrt(s^2 tau^2 - 1) - arccos(1/(s tau))] ds, in mpmath.

    The same double integral taken in polar slopes (s, angle), its angular half done by hand. 40 digits absorb the
    bracket's cancellation near s = 1/tau. Good to 1e-13 relative.
    """
    with mp.workdps(40):
        tau, p = mp.mpf(tau), mp.mpf(p)
        start = 1 / tau

        def integrand(u):
            s = start * (1 + mp.exp(u))
            bracket = mp.sqrt((s * tau) ** 2 - 1) - mp.acos(1 / (s * tau))
            # the factor exp(-start^(2p)) waits outside: mp.quad stops at an absolute error
            return s * mp.exp(start ** (2 * p) - s ** (2 * p)) * bracket * start * mp.exp(u)

        top = (start ** (2 * p) + 80 + 8 / p * mp.log(10 + 8 / p)) ** (1 / (2 * p))
        end = mp.log(mp.mpf(max(top * tau - 1, 1))) + 1
        pieces = [-20 + (end + 20) * mp.mpf(j) / 12 for j in range(13)]
        return float(2 * p / (mp.pi * mp.gamma(1 / p)) * mp.exp(-(start ** (2 * p))) * mp.quad(integrand, pieces))


def beckmann_lambda(tau):
    """Closed form at p = 1, a = 1/tau: (erf(a) - 1)/2 + exp(-a^2)/(2 a sqrt(pi))."""
    with mp.workdps(60):
        a = 1 / mp.mpf(tau)
        return float(mp.exp(-(a**2)) / (2 * a * mp.sqrt(mp.pi)) - mp.erfc(a) / 2)


def g1(tau, p):
    """Masking of one direction, HP17 Eq. 38; tau = 0 (the normal) is unmasked."""
    return 1.0 if tau == 0 else 1 / (1 + smith_lambda(tau, p))
