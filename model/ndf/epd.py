"""Distribution of microfacet normals: the exponential power distribution (EPD) of HP17 Section 4.3."""

import math

import jax.numpy as jnp
from jax.scipy.special import gammaln

from ..numerics import Real, Scalar

HORIZON_COS = 1e-15  # below this cosine the distribution is taken as 0; it decays faster than any power there
HALF = math.log(math.log(2.0)) / 2  # tan(theta) is beta exp(HALF / p) where P22 has fallen to half
LARGEST_LOG_EXPONENT = 8.0  # exp(-e^8) is 0, and its derivative too, where the power itself would overflow in float32


def log_p22_peak(beta: Scalar, p: Scalar) -> Real:
    """Logarithm of P22(0) = p / (pi beta^2 Gamma(1/p)), HP17 Eq. 35."""
    return jnp.log(p) - math.log(math.pi) - 2 * jnp.log(beta) - gammaln(1 / p)


def epd(theta: Real, beta: Scalar, p: Scalar) -> Real:
    """Exponential power distribution D (1/sr), HP17 Eq. 34-35; its integral of D cos over the hemisphere is 1.

    ``tan`` is formed from the angle, not from ``1 - cos^2``, which would lose all digits in MERL's first bins.

    Args:
        theta: angle between microfacet and surface normal (rad).
        beta: width (tangent of an angle), > 0. ``p = 1`` is a Beckmann distribution of roughness beta.
        p: kurtosis exponent, > 0.

    Gradient: finite everywhere; at ``theta = 0`` the derivative in beta and p is that of the peak value.
    """
    cos = jnp.cos(theta)
    above = cos > HORIZON_COS
    cos = jnp.where(above, cos, 1.0)
    tan = jnp.where(above, jnp.tan(jnp.where(above, theta, 0.0)), 0.0)
    off = tan > 0
    log_ratio = jnp.log(jnp.where(off, tan, 1.0) / beta)
    exponent = jnp.where(off, jnp.exp(jnp.minimum(2 * p * log_ratio, LARGEST_LOG_EXPONENT)), 0.0)
    return jnp.where(above, jnp.exp(log_p22_peak(beta, p) - exponent - 4 * jnp.log(cos)), 0.0)
