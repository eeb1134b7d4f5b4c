"""Functions whose values and gradients stay finite at the edge of their domain.

Rule: substitute before computing, mask after (a double ``where``). Nothing else in the package may call ``sqrt``,
``arccos`` or a real power on a base that can reach the edge.
"""

import math
from types import ModuleType

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

Real = Float[Array, "..."]  # of any shape; float64 by default, float32 where the caller's arrays are
Scalar = Float[Array, ""]
Numbers = Float[Array | np.ndarray, "..."] | np.floating  # of NumPy or JAX (:func:`namespace_of`)

TINY = 1e-300  # smallest substitute; far below any square of an angle or reflectance in float64


def namespace_of(x: ArrayLike) -> ModuleType:
    """JAX for what it traces, otherwise NumPy.

    What is small and computed by itself needs no program then, which would take longer to load than it runs.
    """
    return jnp if isinstance(x, Tracer) else np


def floats(*numbers: ArrayLike) -> tuple[Array, ...]:
    """Arrays of floating-point numbers, shapes kept: integers in the precision of those that are no integers.

    That is the default precision where all are integers; floating-point numbers keep their own.
    """
    arrays = [jnp.asarray(x) for x in numbers]
    precision = jnp.result_type(*(x for x in arrays if jnp.issubdtype(x.dtype, jnp.floating)), 0.0)
    return tuple(x if jnp.issubdtype(x.dtype, jnp.floating) else x.astype(precision) for x in arrays)


def safe_sqrt(x: Real) -> Real:
    """Square root, 0 with zero gradient where ``x <= 0``."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def safe_acos(x: Real) -> Real:
    """Arc cosine (rad) clipped to [0, pi], with zero gradient where ``|x| >= 1``."""
    inside = jnp.abs(x) < 1
    return jnp.where(inside, jnp.arccos(jnp.where(inside, x, 0.0)), jnp.where(x > 0, 0.0, jnp.pi))


def total(x: Real) -> Real:
    """Sum over the last axis in the precision of ``x``, accumulated in float64."""
    return jnp.sum(x, -1, dtype=jnp.float64).astype(x.dtype)


def safe_divide(numerator: Real | float, denominator: Real) -> Real:
    """Quotient, 0 with zero gradient where the denominator is 0."""
    nonzero = denominator != 0
    return jnp.where(nonzero, numerator / jnp.where(nonzero, denominator, 1.0), 0.0)


def expm1_over(x: Real) -> Real:
    """(e^x - 1) / x, 1 at 0."""
    small = jnp.abs(x) < 1e-4
    kept = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 + x / 2 * (1 + x / 3), jnp.expm1(kept) / kept)


def softplus(x: Real) -> Real:
    """log(1 + e^x); four times as fast as ``jax.nn.softplus`` on a CPU, which also cares for infinite ``x``."""
    return jnp.maximum(x, 0.0) + jnp.log1p(jnp.exp(-jnp.abs(x)))


def sin_quarter(x: Real) -> Real:
    """Sine on [0, pi/2] by its series, to the last digit: XLA has no vectorised sine on a CPU (11 ns against 2 ns)."""
    square, value = x * x, jnp.zeros_like(x)
    for k in reversed(range(11)):
        value = value * square + (-1) ** k / math.factorial(2 * k + 1)
    return x * value
