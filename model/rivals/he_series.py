"""The series of He et al. 1991, Eq. 78: in full, and looked up in a table where many directions ask for it.

Per direction and wavelength the sum takes 20 to 112 terms, a microsecond with its derivatives. It is a function of two
variables alone, g and e, the same for every material: a table that a process makes once, in a second, serves all fits,
a tenth of the time or less.
"""

import math
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics import TINY

LEAST_TERMS, TERMS = 20, 112  # of the series: see `full`
STIRLING = 8  # from this m on factorials are those of Stirling's series, to 6e-12
HALF_LOG_2_PI = math.log(2 * math.pi) / 2
BELOW, ABOVE = 7.0, 8.0  # widths of the summand kept on either side of its largest term; exp(-7^2 / 2) = 2e-11
FEW = 4096  # directions and wavelengths up to which the series is summed: a table takes as long as a million sums
STEP = 0.05  # between nodes, of both coordinates of the table
LEAST_LOG_G, LARGEST_LOG_G = math.log(1e-8), math.log(4e5)
LARGEST_DECAY = 60.0  # e / (1 + g) at the table's end: there the series is below exp(-30) of its largest value
BEND, INCLINE = 0.05, 0.3  # of the table's second coordinate, INCLINE decay + log(1 + decay / BEND)
Sums = tuple[Array, Array, Array]
Pair = tuple[Array, Array]


def lambert_w(x: Array) -> Array:
    """Lambert's W, ``w e^w = x``, for 0 <= x <= 1e250; relative accuracy 1e-15, exact first derivative in x.

    Halley's iteration without derivative, then one Newton step that carries it.
    """
    fixed = jax.lax.stop_gradient(x)
    w = jnp.log1p(fixed)
    for _ in range(6):
        residual = w - fixed * jnp.exp(-w)
        w = w - residual / (w + 1 - (w + 2) * residual / (2 * w + 2))
    w = jax.lax.stop_gradient(w)
    return w - (w - x * jnp.exp(-w)) / (1 + w)


@jax.custom_jvp
def full(g: Array, e: Array) -> Array:
    """``Sum_{m>=1} g^(m-1) exp(-g - e/m) / (m! m)``, each term formed as a logarithm; g reaches 300 000.

    The largest term stands near ``m* = g y``, ``y^2 log y^2 = 2 e / g^2``, and the terms fall off round it as a
    Gaussian of variance ``1 / (1/m* + 2 e/m*^3)``. Where that takes no more than ``TERMS`` terms they are the terms
    themselves; where it takes more, the sum is its own integral to exp(-2 pi^2 width^2), and the trapezoid rule with
    ``TERMS`` nodes has the same kind of error. Accuracy 1e-9, which is what log(m!) leaves at g = 60 000.
    """
    return _sums(g, e)[0]


@full.defjvp
def _full_jvp(primals: Pair, tangents: Pair) -> Pair:
    """The derivative of the same terms: d/dg multiplies each by (m - 1)/g - 1, d/de by -1/m."""
    value, by_g, by_e = _sums(*primals)
    return value, by_g * tangents[0] + by_e * tangents[1]


def _sums(g: Array, e: Array) -> Sums:
    """The series and its derivatives by g and e."""
    tilt = jnp.minimum(2 * e / jnp.maximum(g, TINY ** (1 / 2)) ** 2, 1e250)
    largest = jnp.maximum(g * jnp.exp(lambert_w(tilt) / 2), 1.0)
    width = 1 / jnp.sqrt(1 / largest + 2 * e / largest**3)
    first = jnp.maximum(jnp.floor(largest - BELOW * width), float(STIRLING))
    step = jnp.maximum((largest + ABOVE * width - first) / (TERMS - 1), 1.0)
    log_g = jnp.log(jnp.maximum(g, TINY))

    def with_term(sums: Sums, m: Array | float, log_factorial: Array | float, log_m: Array | float) -> Sums:
        term = jnp.exp((m - 1) * log_g - g - log_factorial - log_m - e / m)
        return sums[0] + term, sums[1] + (m - 1) * term, sums[2] + term / m

    def add(k: Array, sums: Sums) -> Sums:
        m = first + k * step
        log_m, inverse = jnp.log(m), 1 / m
        square = inverse**2
        series = inverse * (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square / 1680)))
        return with_term(sums, m, (m + 0.5) * log_m - m + HALF_LOG_2_PI + series, log_m)

    zero = jnp.zeros_like(g * e)
    # the most that one of them takes
    count = jnp.ceil(jnp.max((largest + ABOVE * width - first) / step)).astype(int) + 1
    sums = jax.lax.fori_loop(0, jnp.clip(count, LEAST_TERMS, TERMS), add, (zero, zero, zero))
    value, moment, shrunk = (step * x for x in sums)
    for m in map(float, range(1, STIRLING)):  # whose factorials Stirling's series does not give to ten digits
        value, moment, shrunk = with_term((value, moment, shrunk), m, math.lgamma(m + 1), math.log(m))
    return value, moment / jnp.maximum(g, TINY) - value, -shrunk


def series(g: Array, e: Array) -> Array:
    """The series of :func:`full`, for any number of directions: beyond ``FEW`` it is looked up.

    Args:
        g, e: what Eq. 78 calls g and what its exponent holds, ``pi^2 v_xy^2 tau^2 / lambda^2``; shapes that broadcast.

    Computed in float64, whatever the precision of g and e.

    Accuracy: that of :func:`full`; looked up, 1e-7 of the value for g in [1e-8, 4e5] and e <= 60 (1 + g), and 2e-5 of
    it for the derivatives by log g and log e (``tests/rivals/test_rivals.py``). Beyond, the series is below exp(-30)
    of its largest value, or g so small that the lobe is black: there it only stays finite and falls.
    """
    precision = jnp.result_type(g, e)
    g, e = (x.astype(jnp.float64) for x in jnp.broadcast_arrays(g, e))
    return (full if g.size <= FEW else looked_up)(g, e).astype(precision)


def _coordinate(decay: Any, numpy: Any) -> tuple[Any, Any]:  # noqa: ANN401 - of NumPy, or of JAX
    """The table's second coordinate, a function of ``e / (1 + g)``, and its derivative."""
    return INCLINE * decay + numpy.log1p(decay / BEND), INCLINE + 1 / (BEND + decay)


@cache
def table() -> np.ndarray:
    """Logarithm of the series, its derivatives by both coordinates and the mixed one, in steps; (log g, decay, 4)."""
    log_g = np.arange(LEAST_LOG_G, LARGEST_LOG_G + STEP, STEP)
    end, _ = _coordinate(LARGEST_DECAY, np)
    wanted = np.arange(0.0, end + STEP, STEP)
    decay = np.zeros_like(wanted)
    for _ in range(60):  # Newton's iteration from the left of a concave function
        there, slope = _coordinate(decay, np)
        decay += (wanted - there) / slope
    g = np.exp(log_g)[:, None]
    with jax.ensure_compile_time_eval():
        value, by_g, by_e = (np.asarray(x) for x in jax.jit(_sums)(*jnp.broadcast_arrays(g, decay * (1 + g))))
    by_log_g = STEP * g * (by_g + decay * by_e) / value
    by_coordinate = STEP * (1 + g) / _coordinate(decay, np)[1] * by_e / value
    mixed = np.gradient(by_log_g, axis=1)
    return np.stack([np.log(value), by_log_g, by_coordinate, mixed], -1)


@jax.custom_jvp
def looked_up(g: Array, e: Array) -> Array:
    """:func:`full` from a table: bicubic Hermite polynomials of its logarithm, the interpolant's own derivatives."""
    return _looked_up(g, e)[0]


@looked_up.defjvp
def _looked_up_jvp(primals: Pair, tangents: Pair) -> Pair:
    value, by_g, by_e = _looked_up(*primals)
    return value, by_g * tangents[0] + by_e * tangents[1]


def _hermite(t: Array) -> tuple[Pair, Pair, Pair, Pair]:
    """Weights at t in [0, 1] of both ends' values and slopes; derivatives of these weights."""
    rest = 1 - t
    values, slopes = ((1 + 2 * t) * rest**2, t**2 * (3 - 2 * t)), (t * rest**2, -(t**2) * rest)
    return values, slopes, (-6 * t * rest, 6 * t * rest), (rest * (1 - 3 * t), t * (3 * t - 2))


def _looked_up(g: Array, e: Array) -> Sums:
    """The interpolant and its derivatives by g and e."""
    nodes = jnp.asarray(table())
    held = jnp.clip(g, math.exp(LEAST_LOG_G), math.exp(LARGEST_LOG_G))
    decay = e / (1 + g)
    coordinate, slope = _coordinate(decay, jnp)
    rows, columns = nodes.shape[0] - 1, nodes.shape[1] - 1
    row, column = (jnp.log(held) - LEAST_LOG_G) / STEP, coordinate / STEP
    i = jnp.clip(jnp.floor(row).astype(jnp.int32), 0, rows - 1)
    j = jnp.clip(jnp.floor(column).astype(jnp.int32), 0, columns - 1)
    s, inside = row - i, jnp.clip(column - j, 0.0, 1.0)
    beyond = column - j - inside
    down, across = _hermite(s), _hermite(inside)
    value = by_row = by_column = jnp.zeros_like(row)
    for a in (0, 1):
        for b in (0, 1):
            f, f_row, f_column, f_both = jnp.moveaxis(nodes[i + a, j + b], -1, 0)
            along = across[0][b] * f + across[1][b] * f_column
            along_slope = across[0][b] * f_row + across[1][b] * f_both
            value += down[0][a] * along + down[1][a] * along_slope
            by_row += down[2][a] * along + down[3][a] * along_slope
            by_column += down[0][a] * (across[2][b] * f + across[3][b] * f_column) + down[1][a] * (
                across[2][b] * f_row + across[3][b] * f_both
            )
    result = jnp.exp(value + by_column * beyond)
    by_decay = result * by_column * slope / STEP
    return result, result * by_row / (STEP * held) - by_decay * decay / (1 + g), by_decay / (1 + g)
