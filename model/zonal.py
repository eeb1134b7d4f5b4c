"""(S * D)(theta_h) by zonal harmonics, as HP17 Appendix A computes it: quick, and wrong for sharp lobes.

Both functions are symmetric about an axis, so that their convolution is a product of coefficients (Eq. 61-64). In terms
of plain moments, f_l = Int_0^{pi/2} f(theta) P_l(cos theta) sin(theta) dtheta, Eq. 64 reads

    (S * D)(theta_h) = pi sum_{l=0}^{order} (2 l + 1) S_l D_l P_l(cos theta_h).

Degrees up to ``order`` tell apart angles no smaller than about 1/order, whatever the parameters. A narrower lobe is cut
off at the top and rings around its foot, into negative values; :func:`convolve` says where the sum can be trusted.

The moments are taken at one fixed set of nodes that serves every width: their Legendre polynomials are numbers known
before anything is compiled, and a moment of every lobe is one product of matrices.
"""

import math
from functools import lru_cache
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from . import convolution
from .ndf.epd import epd
from .numerics import Real, Scalar
from .quadrature import gauss_legendre

CHUNK = 512  # lobes whose moments are taken at a time: at order 100, 512 x 960 nodes x 8 bytes = 4 MB
NODES = 10  # Gauss nodes of a panel
STEP = 0.3  # longest panel in log tan(theta): the edge of D is 1/(2 p) >= 0.1 wide there
SMALLEST, LARGEST = 1e-5, 1e5  # tangents between which panels are geometric: beta, 1/B >= 1e-3 and p >= 0.2


@lru_cache
def _rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes theta (N,) on [0, pi/2] and, (N, order + 1), P_l(cos theta) sin(theta) times their weights.

    Panels are geometric towards the normal, where lobes are narrow, and towards the horizon, where a long-tailed D
    rises as cos^-4 before it falls, and nowhere longer than 8/order, a little more than a period of P_order.
    """
    count = math.ceil(math.log(LARGEST / SMALLEST) / STEP) + 1
    ends = np.concatenate([[0.0], np.arctan(np.geomspace(SMALLEST, LARGEST, count)), [np.pi / 2]])
    pieces = [np.linspace(a, b, math.ceil((b - a) * max(order, 1) / 8) + 1)[:-1] for a, b in pairwise(ends)]
    ends = np.append(np.concatenate(pieces), np.pi / 2)
    u, w = gauss_legendre(NODES)
    lengths = np.diff(ends)[:, None]
    theta = (ends[:-1, None] + lengths * u).ravel()
    return theta, (np.sin(theta) * (lengths * w).ravel())[:, None] * _legendre(np.cos(theta), order)


def _legendre(x: np.ndarray, order: int) -> np.ndarray:
    """P_0 .. P_order, shape ``(*x.shape, order + 1)``."""
    rows = [np.ones_like(x), x]
    for k in range(1, order):
        rows.append(((2 * k + 1) * x * rows[k] - k * rows[k - 1]) / (k + 1))
    return np.stack(rows[: order + 1], -1)


def legendre(x: Real, order: int) -> Real:
    """Legendre polynomials P_0 .. P_order at x in [-1, 1], by their recurrence, shape ``(order + 1, *x.shape)``.

    In exact arithmetic the recurrence is stable on [-1, 1]; rounding of x near 1 leaves order^2 eps.
    """

    def step(last: tuple[Real, Real], k: Real) -> tuple[tuple[Real, Real], Real]:
        before, now = last
        following = ((2 * k + 1) * x * now - k * before) / (k + 1)
        return (now, following), now

    degrees = jnp.arange(order + 1, dtype=x.dtype)
    # P_(-1) does not matter: it is multiplied by 0
    return jax.lax.scan(step, (jnp.zeros_like(x), jnp.ones_like(x)), degrees)[1]


def normal_moments(beta: Scalar, p: Scalar, order: int) -> Real:
    """D_l of the EPD, l = 0 .. order (HP17 Eq. 63 without the factor sqrt(pi (2 l + 1))), shape ``(order + 1,)``.

    Accuracy: 1e-8 of the zeroth for beta in [1e-3, 1], p in [0.2, 5] (``tests/model/test_zonal.py``).
    """
    theta, polynomials = _rule(order)
    return epd(jnp.asarray(theta), beta, p) @ polynomials


def lobe_moments(B: Real, c: Scalar, order: int) -> Real:
    """S_l of the K-correlation lobe times cos^2, l = 0 .. order (HP17 Eq. 62), shape ``(order + 1, *B.shape)``.

    Accuracy: 1e-9 of the zeroth for B in [0, 1e3], c in [1.01, 6] (``tests/model/test_zonal.py``).
    """
    theta, polynomials = _rule(order)

    @jax.checkpoint  # the lobe at all nodes is dearer to keep than to compute again
    def moments(B: Real) -> Real:
        return convolution.lobe(jnp.asarray(theta, B.dtype), B, c) @ jnp.asarray(polynomials, B.dtype)

    flat = jax.lax.map(moments, B.ravel(), batch_size=CHUNK)
    return flat.T.reshape(order + 1, *B.shape)


def convolve(theta_h: Real, B: Real, c: Scalar, beta: Scalar, p: Scalar, order: int = 100) -> Real:
    """(S * D) of HP17 Eq. 33 without the lobe's amplitude, as its zonal harmonics up to degree ``order`` (Eq. 61-64).

    On a grid the moments are taken once per B, the polynomials once per theta_h, and both meet in one product of
    matrices; memory beyond the result is (order + 1) (theta_h.size + B.size) numbers.

    Args:
        theta_h: half angle (rad).
        B: 2 (b/lambda) cos_d, >= 0, dimensionless; broadcasts with ``theta_h``.
        c: falloff of the K-correlation spectrum, > 1. beta, p: the EPD. Scalars.
        order: highest degree (static), >= 0; the paper's is 100.

    Returns:
        shape of the broadcast. Negative where the truncated sum is negative: that is what the method gives.

    Gradient: that of the truncated sum, exact, finite everywhere.

    Accuracy: 1e-8 of the peak as a truncated sum. As (S * D), from 2000 random lobes with beta in [0.003, 1], p in
    [0.2, 5], c in [1.03, 5], B in [0.1, 200], at MERL's half angles (``tests/zonal_failure.py``, results/zonal.json;
    ``tests/model/test_zonal.py``):

    - Safe: order >= 12 B, that is 24 b/lambda, whatever the normals. The error stays below 0.3 % of the peak at every
      corner of beta 1e-3..1, p 0.2..5, c 1.03..8. Order 100 then serves b up to 1.8 um in blue, 2.7 um in red. At
      order 8 B it is 0.5 % of the peak over random lobes, 2 % at c = 6, beta = 1e-3, p = 5.
    - Below, it depends on the half width w of the blurred lobe (rad). Error in units of the peak at order 100, median
      and worst: order w < 1: 0.7, 0.9; 1..2: 0.4, 0.7; 2..3: 0.15, 0.3; 3..4: 0.06, 0.2; 4..5: 0.03, 0.14; 8..12:
      2e-4, 0.04. No w is safe by itself: a narrow S sees the cusp of long-tailed normals (p < 0.5) and their rise
      at the horizon, which leave up to 8 % at order 100, whatever w.
    - Over all these lobes order 100 is wrong by more than 1 % of the peak for one in six and negative at 4 % of the
      angles. In draws of 100 lobes the worst error is 37..92 % of the peak (median 70 %), the 95th percentile of the
      relative error 30..7900 %: the ringing lasts where the lobe is long gone.
    """
    degrees = np.arange(order + 1)
    both = (math.pi * (2 * degrees + 1) * normal_moments(beta, p, order)).astype(B.dtype)
    moments = lobe_moments(B, c, order)
    moments = moments * both.reshape(-1, *(1,) * B.ndim)
    # einsum, unlike a product and a sum, never spreads an operand over the axes that only the other has
    return jnp.einsum("l...,l...->...", moments, legendre(jnp.cos(theta_h), order))
