"""Beckmann's distribution of microfacet normals, and Smith's masking of it."""

import jax.numpy as jnp
from jax.scipy.special import erfc

from ..numerics import Real, Scalar, safe_sqrt

UNMASKED = 26.0  # cot(theta) / m beyond which nothing is masked, to the last digit


def D(theta_h: Real, roughness: Scalar) -> Real:
    """``exp(-tan^2(theta_h) / m^2) / (pi m^2 cos^4 theta_h)`` (1/sr); its integral of D cos over the hemisphere is 1.

    0 at the horizon, where the exponential beats every power. ``m`` is the root mean square slope.
    """
    tan2 = jnp.tan(theta_h) ** 2
    return jnp.exp(-tan2 / roughness**2 + 2 * jnp.log1p(tan2)) / (jnp.pi * roughness**2)


def G1(cos: Real, roughness: Scalar) -> Real:
    """Smith's masking of one direction whose cosine with the normal is ``cos`` > 0 (Smith 1967; Heitz 2014).

    1 / (1 + Lambda), Lambda = exp(-a^2) / (2 a sqrt(pi)) - erfc(a) / 2, a = cot(theta) / m.
    """
    sin = safe_sqrt((1 - cos) * (1 + cos))
    tilted = UNMASKED * roughness * sin > cos
    a = jnp.where(tilted, cos / (roughness * jnp.where(tilted, sin, 1.0)), UNMASKED)
    return jnp.where(tilted, 1 / (1 + jnp.exp(-(a**2)) / (2 * a * jnp.sqrt(jnp.pi)) - erfc(a) / 2), 1.0)
