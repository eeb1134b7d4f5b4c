"""(S * D)(theta_h) as a lobe of the same kind with another height and width, HP17 Eq. 39-41: the cheapest blur.

    (S * D)(theta_h) ~ s (1 + 4 g^2 sin^2 theta_h)^(-(c+1)/2) cos^2 theta_h,      s, g functions of (u, c, beta, p),

u = (b/lambda) cos_d = B/2. The paper prints no cos^2, though its S has one (Eq. 33): without it the form cannot even
give S back when D is a Dirac. Here it does: s = 1 and g = u for beta = 0.

Instead of g the table holds q = log(1 + 4 g^2), for 1 + 4 g^2 sin^2 = cos^2 + e^q sin^2 has a meaning for every real
q. It is negative, and g imaginary, where facets tilt so far that the blurred lobe is wider than cos^2 allows.

s and q are fitted by least squares to :func:`merlfit.model.convolution.convolve` at Chebyshev nodes of four smooth
coordinates and interpolated by their polynomial, which has all its derivatives. The table is computed at first use,
in memory, and kept where :func:`keep_by` says. What it does not cover is left to the quadrature.
"""

import math
import threading
from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from . import chebyshev, convolution
from .numerics import Real, Scalar


class Range(NamedTuple):
    """What the table covers: lowest and highest value of each variable."""

    u: tuple[float, float]
    c: tuple[float, float]
    beta: tuple[float, float]  # and never above `widest_beta(p)`
    p: tuple[float, float]


RANGE = Range(u=(0.0, 455.0), c=(1.01, 6.0), beta=(1e-3, 1.0), p=(0.2, 5.0))
"""What the priors of a fit allow (:mod:`merlfit.model.parameters`), at MERL's wavelengths and any angle; but of
long-tailed distributions of normals, p < 0.6, only those narrower than :func:`widest_beta`."""

NODES = (28, 9, 12, 9)  # of u, c, beta, p
FEW = 0.25  # u below which the lobe is hardly there: log u above, u^2 below
ANGLES = 36  # at which a lobe is fitted
ORDER = 24  # of the quadrature that is fitted: 5e-5, far below what the form itself misses
FLOOR = 1e-2  # of the peak: relative residuals above, absolute ones below
PRIOR = 1e-4  # weight of the unblurred q, for lobes so flat that any width fits
ROUNDING = 1e-6  # relative, by which a variable may lie outside and is taken for the end of the range


def widest_beta(p: Real | np.ndarray) -> Real | np.ndarray:
    """The beta at which half of the surface is tilted by 45 to 55 degrees or more; for short tails 1.05.

    Beyond, D piles up at the horizon, where the form is 0. The authors' table, too, ends at a beta_max(p).
    """
    return 1.05 / (1 + (0.4 / p) ** 5.5)


def covers(B: Real, c: Scalar, beta: Scalar, p: Scalar) -> Array:
    """Whether the table covers these parameters and all of ``B``: boolean scalar, False for NaN."""
    # a parameter at its bound may have been rounded past it
    low, high = np.array(RANGE).T * [[1 - ROUNDING], [1 + ROUNDING]]
    ends = jnp.stack([jnp.min(B) / 2, jnp.max(B) / 2])
    surface = jnp.stack([c, beta, p])
    return (
        jnp.all((ends >= low[0]) & (ends <= high[0]))
        & jnp.all((surface >= low[1:]) & (surface <= high[1:]))
        & (beta <= widest_beta(p) * (1 + ROUNDING))
    )


def _coordinates(B: Real, c: Real, beta: Real, p: Real) -> tuple[Real, Real, Real, Real]:
    """The four coordinates, each in [0, 1] inside the range; that of B is smooth in B^2 at 0, as (S * D) is."""
    return (
        jnp.log1p((B / (2 * FEW)) ** 2) / math.log1p((RANGE.u[1] / FEW) ** 2),
        jnp.log((c - 1) / (RANGE.c[0] - 1)) / math.log((RANGE.c[1] - 1) / (RANGE.c[0] - 1)),
        jnp.log(beta / RANGE.beta[0]) / jnp.log(widest_beta(p) / RANGE.beta[0]),
        jnp.log(p / RANGE.p[0]) / math.log(RANGE.p[1] / RANGE.p[0]),
    )


def _parameters(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:
    """B, c, beta, p at these coordinates: the inverse of `_coordinates`."""
    p = RANGE.p[0] * (RANGE.p[1] / RANGE.p[0]) ** t
    return (
        2 * FEW * np.sqrt(np.expm1(x * math.log1p((RANGE.u[1] / FEW) ** 2))),
        1 + (RANGE.c[0] - 1) * ((RANGE.c[1] - 1) / (RANGE.c[0] - 1)) ** y,
        RANGE.beta[0] * (np.asarray(widest_beta(p)) / RANGE.beta[0]) ** z,
        p,
    )


def scaled_lobe(theta_h: Real, log_s: Real, q: Real, c: Scalar, squared_cosine: bool = True) -> Real:
    """s (1 + 4 g^2 sin^2 theta_h)^(-(c+1)/2) cos^2 theta_h (HP17 Eq. 39-41, times cos^2)."""
    form = jnp.exp(log_s - (c + 1) / 2 * jnp.log1p(jnp.expm1(q) * jnp.sin(theta_h) ** 2))
    return form * jnp.cos(theta_h) ** 2 if squared_cosine else form


def fit(B: Scalar, c: Scalar, beta: Scalar, p: Scalar, squared_cosine: bool = True) -> tuple[Scalar, Scalar]:
    """log s and q of one lobe: s is (S * D)(0), and q fitted by least squares over theta_h.

    Residual: (form - truth) / (truth + `FLOOR` (S * D)(0)), that is relative down to 1e-2 of the peak and absolute
    below. Angles are equidistant in log theta_h, from a quarter of the lobe's half width to the horizon. With s free
    the fit gives up the peak for the tail, or not, and the result jumps from one to the other; with s fixed it is a
    smooth function of the parameters, but for a few long-tailed lobes.

    Args:
        squared_cosine: the form with cos^2, or as printed.
    """
    half_width = jnp.hypot(beta, jnp.sqrt((2 ** (2 / (c + 1)) - 1) / (1 + B * B)))
    low = jnp.log(half_width) - 1.4
    theta = jnp.exp(low + (math.log(math.pi / 2) - low) * (np.arange(ANGLES) + 0.5) / ANGLES)
    truth = convolution.convolve(jnp.append(theta, 0.0), B, c, beta, p, ORDER)
    peak, truth = truth[-1], truth[:-1]

    def loss(q: Real) -> Real:
        form = scaled_lobe(theta, jnp.log(peak), q, c, squared_cosine)
        misfit = jnp.mean(((form - truth) / (truth + FLOOR * peak)) ** 2)
        return misfit + PRIOR * (q - jnp.log1p(B * B)) ** 2

    def shrink(_: Array, bracket: tuple[Real, Real]) -> tuple[Real, Real]:
        left, right = bracket
        step = (right - left) * (3 - 5**0.5) / 2  # golden section
        lower = loss(left + step) < loss(right - step)
        return jnp.where(lower, left, left + step), jnp.where(lower, right - step, right)

    grid = jnp.arange(-6.0, 15.0, 0.5)
    start = grid[jnp.argmin(jax.vmap(loss)(grid))]
    left, right = jax.lax.fori_loop(0, 36, shrink, (start - 0.5, start + 0.5))
    return jnp.log(peak), (left + right) / 2


@partial(jax.jit, static_argnums=4)
def fit_all(B: Real, c: Real, beta: Real, p: Real, squared_cosine: bool = True) -> tuple[Real, Real]:
    """:func:`fit` of many lobes, one after another: all arguments of shape ``(N,)``."""
    return jax.lax.map(lambda x: fit(*x, squared_cosine=squared_cosine), (B, c, beta, p))


def _build() -> np.ndarray:
    """log s and q - log(1 + B^2) at the nodes, shape ``(2, *NODES)``."""
    axes = np.meshgrid(*(chebyshev.nodes(n) for n in NODES), indexing="ij")
    B, c, beta, p = _parameters(*(x.ravel() for x in axes))
    with jax.ensure_compile_time_eval():  # the first use may be inside a program that is being traced
        log_s, q = map(np.asarray, fit_all(*map(jnp.asarray, (B, c, beta, p))))
    return np.stack([log_s, q - np.log1p(B**2)]).reshape(2, *NODES)


Keep = Callable[[Callable[[], np.ndarray]], np.ndarray]
_keep: Keep | None = None
_ONE_AT_A_TIME = threading.Lock()  # two programs that are traced at once wait for one table


def keep_by(keep: Keep | None) -> None:
    """Let ``keep``, which is given what computes the table, fetch it from where it is kept; None: memory only."""
    global _keep
    _keep = keep
    _table.cache_clear()


def table() -> np.ndarray:
    """log s and q - log(1 + B^2) at the Chebyshev nodes of the four coordinates, shape ``(2, *NODES)``.

    From memory, else from where :func:`keep_by` says, else computed: 17 s on two cores, 0.44 MB.
    """
    with _ONE_AT_A_TIME:
        return _table()


@lru_cache(maxsize=1)
def _table() -> np.ndarray:
    values = _build() if _keep is None else _keep(_build)
    values.flags.writeable = False
    return values


def height_and_width(B: Real, c: Scalar, beta: Scalar, p: Scalar) -> tuple[Real, Real]:
    """log s and q = log(1 + 4 g^2) from the table, each of the shape of ``B``: meaningless outside the range."""
    x, *others = _coordinates(B, c, beta, p)
    weights = (chebyshev.weights(y, n) for y, n in zip(others, NODES[1:], strict=True))
    rows = jnp.einsum("kucbp,c,b,p->ku", jnp.asarray(table(), B.dtype), *weights)
    log_s, shift = jnp.tensordot(rows, chebyshev.weights(x, NODES[0]), 1)
    return log_s, shift + jnp.log1p(B * B)


def convolve(theta_h: Real, B: Real, c: Scalar, beta: Scalar, p: Scalar, order: int = 32) -> Real:
    """(S * D) of HP17 Eq. 33 without the lobe's amplitude, as a scaled lobe (Eq. 39-41, times cos^2).

    s and g are looked up once per B, not once per point. Where :func:`covers` says no, all points are left to
    :func:`merlfit.model.convolution.convolve_many`, at run time: slower, and another function, so that values jump by
    what the form misses there. Under ``vmap`` over parameters both are computed.

    Args:
        theta_h: half angle (rad).
        B: 2 (b/lambda) cos_d, >= 0, dimensionless; broadcasts with ``theta_h``.
        c: falloff of the K-correlation spectrum, > 1. beta, p: the EPD. Scalars. order: of the quadrature.

    Returns:
        shape of the broadcast.

    Gradient: that of the form and of the table's polynomial, finite everywhere in the range and at its ends.

    Accuracy against the quadrature at order 96, over 1000 random lobes in the range at MERL's half angles, log-uniform
    in every parameter (``tests/model/test_scaled.py`` holds 600 to about these numbers). In percent, median, 95th
    percentile and worst: relative error where the lobe is above 1e-3 of its peak; error in units of the peak; each
    lobe's worst error in units of its peak.

    ====================  ==============  ==============  ==============
    lobes                 relative        of the peak     worst of lobe
    ====================  ==============  ==============  ==============
    all                   0.6, 65, 1300   0.06, 12, 97    2.6, 47, 97
    B beta < 0.1          0.08, 13, 100                   0.2, 20, 58
    B beta 0.1 .. 1       2.6, 44, 150                    3.3, 22, 47
    B beta > 1            21, 94, 1300                    22, 73, 97
    all, printed form     31, 99, 2400    2.4, 60, 99     35, 72, 99
    all, `fit` per lobe   0.5, 64, 1100   0.04, 12, 97    2.5, 48, 97
    ====================  ==============  ==============  ==============

    So it is good where the nano-geometry's lobe is the wider one, and no more than a rough shape where the normals
    are: no power of 1 + 4 g^2 sin^2 has the edge of an EPD. What is missed is the form's, not the table's.
    """

    def look_up() -> Real:
        return scaled_lobe(theta_h, *height_and_width(B, c, beta, p), c)

    def integrate() -> Real:
        return convolution.convolve_many(theta_h, jnp.maximum(B, 1e-6), jnp.full((), 0.5, B.dtype), c, beta, p, order)

    return jax.lax.cond(covers(B, c, beta, p), look_up, integrate)
