"""The exponential power distribution of microfacet normals, HP17 Eq. 34-35, in mpmath."""

import mpmath as mp


def _epd(theta, beta, p):
    tan2 = mp.tan(theta) ** 2
    p22 = p / (mp.pi * beta**2 * mp.gamma(1 / p)) * mp.exp(-((tan2 / beta**2) ** p))
    return p22 / mp.cos(theta) ** 4


def epd(theta, beta, p):
    """D(theta) in 1/sr, 0 at and beyond the horizon. Correct to the last bits (30 digits inside)."""
    with mp.workdps(30):
        theta, beta, p = mp.mpf(theta), mp.mpf(beta), mp.mpf(p)
        return float(_epd(theta, beta, p)) if theta < mp.pi / 2 else 0.0


def normalisation(beta, p, density=_epd):
    """Integral of D cos(theta) over the hemisphere: 1 by construction. Good to 1e-12.

    The variable is t = log tan(theta), in which every width and every p gives a bump a few units wide, times 1/p
    on its slow side; sin(theta) dtheta = sin^2 cos dt.
    """
    with mp.workdps(40):
        beta, p = mp.mpf(beta), mp.mpf(p)

        def integrand(t):
            theta = mp.atan(mp.exp(t))
            return 2 * mp.pi * density(theta, beta, p) * mp.sin(theta) ** 2 * mp.cos(theta) ** 2

        # exp(-x^p) is below 1e-35 once x^p > 80 + 10/p; the other end falls as exp(2 t)
        top = mp.log(80 + 10 / p) / (2 * p)
        ends = [mp.log(beta) + top * j / 8 for j in range(9)]
        return float(mp.quad(integrand, [ends[0] - 45, ends[0] - 20, ends[0] - 8, ends[0] - 3, *ends]))
