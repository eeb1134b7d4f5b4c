"""Interpolation between even nodes by polynomials through the nearest ones: tables of functions of many directions."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np

from .numerics import Real

NEAREST = 8  # nodes that a cell's polynomial goes through


@lru_cache
def _cells(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Per cell the nodes it looks at, and what takes their values to coefficients of t in [-1/2, 1/2].

    Shapes (cells, `NEAREST`) and (cells, coefficients, `NEAREST`).
    """
    cells = np.arange(size - 1)
    first = np.clip(cells - NEAREST // 2 + 1, 0, size - NEAREST)
    near = first[:, None] + np.arange(NEAREST)
    powers = (near - cells[:, None] - 0.5)[..., None] ** np.arange(NEAREST)
    return near, np.linalg.inv(powers)


def interpolate(values: Real, position: Real) -> Real:
    """Polynomials of degree seven through the values at 0, 1 .. N - 1, at ``position``; beyond the ends, the ends'.

    Args:
        values: shape (..., N). position: any shape, in units of the nodes' distance.

    Returns:
        shape (..., *position.shape).
    """
    size = values.shape[-1]
    near, rule = _cells(size)
    powers = jnp.einsum("cpk,...ck->p...c", jnp.asarray(rule, values.dtype), values[..., near])
    position = jnp.clip(position, 0.0, size - 1.0)
    cell = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, size - 2)
    t = position - cell - 0.5
    polynomial = powers[-1][..., cell]
    for power in powers[-2::-1]:
        polynomial = polynomial * t + power[..., cell]
    return polynomial
