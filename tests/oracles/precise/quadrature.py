"""Fixed rules: Gauss-Legendre nodes, and panels of them."""

from functools import cache
from itertools import pairwise

import mpmath as mp

from .arithmetic import DIGITS


@cache
def gauss(order):
    """Gauss-Legendre nodes and weights on [0, 1]."""
    with mp.workdps(DIGITS + 10):
        rule = []
        for j in range(order):
            x = mp.cos(mp.pi * (j + mp.mpf(3) / 4) / (order + mp.mpf(1) / 2))
            for _ in range(8):
                low, high = mp.mpf(1), x
                for k in range(2, order + 1):
                    low, high = high, ((2 * k - 1) * x * high - (k - 1) * low) / k
                rate = order * (low - x * high) / (1 - x**2)
                x -= high / rate
            rule.append(((1 + x) / 2, 1 / ((1 - x**2) * rate**2)))
        return rule


def panels(points, order):
    """Composite Gauss rule between neighbouring points."""
    for a, b in pairwise(points):
        for u, w in gauss(order):
            yield a + (b - a) * u, (b - a) * w


def split(start, end, longest):
    """Ends of equal panels from start to end, none longer than ``longest``."""
    count = int((end - start) / longest) + 1
    return [start + (end - start) * j / count for j in range(count + 1)]
