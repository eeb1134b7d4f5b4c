"""Distribution of microfacet normals: the exponential power distribution (EPD) of HP17 Section 4.3."""

import jax.numpy as jnp
from jax.scipy.special import gammaln

from .numerics import Real, Scalar, safe_pow

HORIZON_COS = 1e-15  # below this cosine the distribution is taken as 0; it decays faster than any power there


def log_p22_peak(beta: Scalar, p: Scalar) -> Real:
    """Logarithm of P22(0) = p / (pi beta^2 Gamma(1/p)), HP17 Eq. 35."""
    return jnp.log(p) - jnp.log(jnp.pi) - 2 * jnp.log(beta) - gammaln(1 / p)


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
    exponent = safe_pow(jnp.where(above, jnp.tan(jnp.where(above, theta, 0.0)), 0.0) / beta, 2 * p)
    return jnp.where(above, jnp.exp(log_p22_peak(beta, p) - exponent - 4 * jnp.log(cos)), 0.0)
