"""Interpolation through Chebyshev nodes: tables of smooth functions that cost a handful of evaluations."""

import jax.numpy as jnp
import numpy as np

from .numerics import Real


def nodes(count: int) -> np.ndarray:
    """The ``count`` roots of T_count in (0, 1), shape ``(count,)``."""
    return (1 + np.cos(np.pi * (np.arange(count) + 0.5) / count)) / 2


def evaluate(values: Real, x: Real) -> Real:
    """The interpolating polynomial of one function or of several, by Clenshaw's recurrence: a pass over ``x`` a node.

    Args:
        values: at the nodes, shape (count, ...), trailing axes broadcasting with those of ``x``. x: in [0, 1]; beyond,
            as for `weights`.
    """
    return series(coefficients(values), x)


def coefficients(values: Real) -> Real:
    """Coefficients of the polynomials T_k of 2 x - 1, from values at the nodes, both of shape (count, ...)."""
    return jnp.tensordot(jnp.asarray(_to_coefficients(len(values)), values.dtype), values, 1)


def series(coefficients: Real, x: Real) -> Real:
    """The sum of the polynomials with these coefficients: :func:`evaluate`, if they are known already."""
    x = jnp.clip(2 * x - 1, -1.01, 1.01)
    later = last = jnp.zeros((), coefficients.dtype)
    for coefficient in coefficients[:0:-1]:
        later, last = last, 2 * x * last - later + coefficient
    return x * last - later + coefficients[0]


def weights(x: Real, count: int) -> Real:
    """Weights by which values at the nodes make the interpolating polynomial at ``x`` in [0, 1].

    Where rounding has put x just beyond an end the polynomial goes on, and its slope; farther out it stays what it is.

    Returns:
        shape ``(count, *x.shape)``; summed with the values over the first axis they give the polynomial.
    """
    x = jnp.clip(2 * x - 1, -1.01, 1.01)
    rows = jnp.stack([jnp.ones_like(x), x])
    while len(rows) < count:  # T_(m+k) = 2 T_m T_k - T_(m-k): as many again at a time, in few loops
        last = len(rows) - 1
        more = min(last, count - len(rows))
        rows = jnp.concatenate([rows, 2 * rows[last] * rows[1 : more + 1] - rows[last - more : last][::-1]])
    return jnp.tensordot(jnp.asarray(_to_coefficients(count).T, x.dtype), rows[:count], 1)


def _to_coefficients(count: int) -> np.ndarray:
    """What takes values at the nodes to coefficients of T_k, (count, count)."""
    k = np.arange(count)
    matrix = np.cos(np.outer(k, np.pi * (k + 0.5) / count)) * (2 / count)
    matrix[0] /= 2
    return matrix
