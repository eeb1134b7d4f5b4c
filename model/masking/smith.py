"""Smith masking of the exponential power distribution by a one-dimensional integral.

HP17 Eq. 36-38. Eq. 36 prints the inner integral from 0; it runs over the whole line (HP15 Eq. 4). With that the double
integral collapses, for tau = beta tan(theta) and P22 taken at beta = 1, to

    Lambda(tau) = 2 Int_{s > 1/tau} s P22(s^2) [sqrt(s^2 tau^2 - 1) - arccos(1/(s tau))] ds.

With w = s tau, E = (w / tau)^(2p) = E0 + x and E0 = tau^(-2p) this is

    Lambda = e^(-E0) / (pi Gamma(1/p)) Int_0^inf e^(-x) (E0 + x)^(1/p - 1) h(w) dx,
    h = z - arctan z, z = sqrt(w^2 - 1),

a trapezoid rule in log x, whose error falls exponentially with the number of nodes.
"""

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jax.typing import ArrayLike

from .. import chebyshev, piecewise
from ..numerics import Real, Scalar, floats, safe_divide, safe_sqrt, softplus, total
from .smith_numeric import excess

# log x runs over q in [-11, 4.7] at spacing 0.2. The integrand's narrowest peak is x^a e^(-x), a = 3/(2 p), at
# p = 0.12, for which the trapezoid rule errs by 2 |Gamma(a + 2 pi i/0.2)| / Gamma(a) = 2e-11; what lies outside is
# below 1e-9 of the integral for p in [0.12, 5]. Above p = 4, where log x is stretched most, the rule errs by more.
NODES = np.arange(-11.0, 4.7, 0.2)
BEND = 3.0  # where the left tail begins to be stretched for p > 1/2
LARGEST_EXPONENT = 650.0  # e^-650 = 1e-282: masking is 1 to the last digit long before
TABLE_SIZE = 321  # nodes of the interpolation table
LEAST_P, LARGEST_P, EXPONENTS = 0.12, 5.0, 40  # tables of so many exponents in between make that of any


def smith_lambda(tau: ArrayLike, p: ArrayLike) -> Real:
    """Smith's Lambda of the EPD (HP17 Eq. 36-37 with the corrected limits), >= 0.

    Args:
        tau: ``beta tan(theta) >= 0``, any shape; infinite gives infinity.
        p: kurtosis exponent of the EPD, a scalar.

    Accuracy, relative, wherever Lambda > 1e-12: 1e-9 for p in [0.12, 4], 1.4e-8 up to p = 5 (tau around 5;
    ``tests/model/test_masking.py``); at p = 1 it is Beckmann's closed form.
    Gradient: finite for finite tau, zero at tau = 0.
    """
    tau, p = floats(tau, p)
    log_tau = jnp.log(jnp.where(tau > 0, tau, 1.0))
    log_e0 = jnp.minimum(-2 * p * log_tau, math.log(LARGEST_EXPONENT))
    masked = (tau > 0) & (-2 * p * log_tau < math.log(LARGEST_EXPONENT))
    # the left tail falls as x^(3 / 2p) when tau is large: stretch it by max(1, 2p), smoothly
    stretch = jax.nn.softplus(4 * (2 * p - 1)) / 4
    q = jnp.asarray(NODES, tau.dtype)
    log_x = q - stretch * jax.nn.softplus(-(q + BEND))
    dlog_x = 1 + stretch * jax.nn.sigmoid(-(q + BEND))
    log_growth = softplus(log_x - log_e0[..., None])  # of the exponent from E0 to E0 + x
    w_minus_1 = jnp.expm1(log_growth / (2 * p))
    # e^(-E0) belongs in the exponent: in float32 it may underflow where (E0 + x)^(1/p - 1)/Gamma(1/p) is large
    log_rest = log_x - jnp.exp(log_x) + (1 / p - 1) * (log_e0[..., None] + log_growth) - gammaln(1 / p)
    log_rest = log_rest - jnp.exp(log_e0)[..., None]
    value = total(jnp.exp(log_rest) * excess(w_minus_1) * dlog_x) * float(NODES[1] - NODES[0]) / jnp.pi
    return jnp.where(masked, value, 0.0)


def masking_direct(cos_theta: Real, beta: Scalar, p: Scalar) -> Real:
    """Smith's G1 = 1 / (1 + Lambda(beta tan theta)) (HP17 Eq. 38), by quadrature at every point."""
    above = cos_theta > 0
    cos = jnp.where(above, cos_theta, 1.0)
    tau = beta * safe_sqrt((1 - cos) * (1 + cos)) / cos
    return jnp.where(above, 1 / (1 + smith_lambda(tau, p)), 0.0)


def height_correlated(masking_i: Real, masking_o: Real) -> Real:
    """Smith's joint masking and shadowing 1 / (1 + Lambda_i + Lambda_o) (Heitz 2014 Eq. 99) of the two G1.

    Never below their product: a facet low on the surface is hidden from both sides at once. 0 where both are 0.
    """
    return safe_divide(masking_i * masking_o, masking_i + masking_o - masking_i * masking_o)


def _mean_slope(p: Scalar) -> Real:
    """Mean slope of the EPD at beta = 1, Gamma(3 / 2p) / Gamma(1/p); Lambda tends to its product with tau / pi."""
    return jnp.exp(gammaln(1.5 / p) - gammaln(1 / p))


def _masking_of_x(x: Real, p: Scalar) -> Real:
    """G1 as a function of x = 1 / (1 + sqrt(tau mean slope)); it starts as a multiple of x^2, with slope 0."""
    inside = x > 0
    x = jnp.where(inside, x, 1.0)
    return jnp.where(inside, 1 / (1 + smith_lambda(((1 - x) / x) ** 2 / _mean_slope(p), p)), 0.0)


@cache
def _tables() -> np.ndarray:
    """`masking_table` at Chebyshev nodes of log p, (EXPONENTS, TABLE_SIZE), once a process."""
    x = np.linspace(0.0, 1.0, TABLE_SIZE)
    with jax.ensure_compile_time_eval():
        nodes = jnp.asarray(LEAST_P * (LARGEST_P / LEAST_P) ** chebyshev.nodes(EXPONENTS))
        return np.asarray(jax.jit(jax.vmap(lambda p: _masking_of_x(jnp.asarray(x), p)))(nodes))


def masking_table(p: Scalar) -> Real:
    """G1 at even steps of x = 1 / (1 + sqrt(tau mean slope)) from 0 to 1, (TABLE_SIZE,): what `masking` looks up.

    A polynomial in log p through tables made once: 4e-12 for p in [0.12, 5], its derivative 1e-8. Beyond, it soon stays
    what it is at the end (`chebyshev.weights`): 6e-5 off at p = 5.2, 1e-3 at p = 8, 4e-3 at p = 0.11.
    """
    position = jnp.log(p / LEAST_P) / math.log(LARGEST_P / LEAST_P)
    return chebyshev.weights(position, EXPONENTS) @ jnp.asarray(_tables(), p.dtype)


def masking(cos_theta: Real, beta: Scalar, p: Scalar, table: Real | None = None) -> Real:
    """Smith's G1 (HP17 Eq. 38) in [0, 1]; 0 below the horizon.

    Many directions share one parameter set, so G1 is tabulated in ``x = 1 / (1 + sqrt(tau mean slope))``, in which it
    does not depend on beta and is smooth at both ends, and interpolated (`piecewise.interpolate`), for one direction as
    for many.

    Args:
        cos_theta: cosine between normal and direction, any shape.
        beta: width of the EPD. p: its exponent.
        table: `masking_table` of p, if it is known already.

    Accuracy: 1e-9 for p in [0.12, 4] and any beta, 3.3e-9 up to p = 5; the table adds less than 1e-9
    (``tests/model/test_masking.py``, ``tests/hard_cases/cases.toml``). Beyond p = 5, the bound of fits, the table is
    that of 5: 1e-3 off at p = 8, where `masking_direct` is good to 1e-6. Float32 is kept, to 1e-6.
    """
    table = masking_table(p) if table is None else table
    above = cos_theta > 0
    cos = jnp.where(above, cos_theta, 1.0)
    root_cos = jnp.sqrt(cos)
    root_tan = safe_sqrt(beta * _mean_slope(p) * safe_sqrt((1 - cos) * (1 + cos)))
    position = root_cos / (root_cos + root_tan) * (TABLE_SIZE - 1)
    return jnp.where(above, piecewise.interpolate(table, position), 0.0)
