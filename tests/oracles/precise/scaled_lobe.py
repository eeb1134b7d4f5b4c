"""The lobe blurred as a lobe of another scale, read from a table."""

from functools import cache

import mpmath as mp

from .arithmetic import exactly
from .chebyshev import lagrange


def scaled(table):
    """(S * D)(theta_h) without amplitude as a scaled lobe (HP17 Eq. 39-41, times cos^2) whose table is taken for exact.

    Args:
        table: log s and q - log(1 + B^2), (2, 28, 9, 12, 9), at Chebyshev nodes of the coordinates below.
    """
    numbers = [[[[[mp.mpf(float(x)) for x in row] for row in z] for z in y] for y in x] for x in table]

    @cache
    def along_B(x):
        weights = lagrange(x, 28)
        return [
            [[[mp.fdot(weights, [half[u][j][k][m] for u in range(28)]) for m in range(9)] for k in range(12)]
             for j in range(9)] for half in numbers
        ]  # fmt: skip

    @exactly
    def scaled_lobe(theta_h, B, c, beta, p):
        widest = mp.mpf("1.05") / (1 + (mp.mpf("0.4") / p) ** mp.mpf("5.5"))
        rows = along_B(mp.log1p((2 * B) ** 2) / mp.log1p(mp.mpf(1820) ** 2))
        by_c = lagrange(mp.log((c - 1) / (mp.mpf(1.01) - 1)) / mp.log(5 / (mp.mpf(1.01) - 1)), 9)
        by_beta = lagrange(mp.log(beta * 1000) / mp.log(widest * 1000), 12)
        by_p = lagrange(mp.log(p * 5) / mp.log(25), 9)
        log_s, shift = (
            mp.fdot(by_c, [mp.fdot(by_beta, [mp.fdot(by_p, row) for row in y]) for y in half]) for half in rows
        )
        form = 1 + ((1 + B**2) * mp.exp(shift) - 1) * mp.sin(theta_h) ** 2
        return mp.exp(log_s) * form ** (-(c + 1) / 2) * mp.cos(theta_h) ** 2

    return scaled_lobe
