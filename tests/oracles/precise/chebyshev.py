"""Polynomials through values at the Chebyshev nodes of [0, 1]."""

import mpmath as mp


def _angles(count):
    return [mp.pi * (j + mp.mpf(1) / 2) / count for j in range(count)]


def interpolant(function, count):
    """The polynomial through the values of a function at ``count`` nodes."""
    angles = _angles(count)
    values = [function((1 + mp.cos(x)) / 2) for x in angles]
    factors = [
        2 * mp.fsum(f * mp.cos(k * x) for f, x in zip(values, angles, strict=True)) / count for k in range(count)
    ]

    def at(x):
        after, now = mp.mpf(0), mp.mpf(0)
        for factor in reversed(factors[1:]):  # Clenshaw
            after, now = now, factor + (4 * x - 2) * now - after
        return factors[0] / 2 + (2 * x - 1) * now - after

    return at


def lagrange(x, count):
    """Weights of the values at ``count`` nodes in their polynomial at x: the barycentric formula."""
    weights = [(-1) ** j * mp.sin(angle) / (2 * x - 1 - mp.cos(angle)) for j, angle in enumerate(_angles(count))]
    return [weight / mp.fsum(weights) for weight in weights]
