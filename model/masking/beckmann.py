"""Smith's masking of Beckmann's distribution, in closed form."""

import jax.numpy as jnp
from jax.scipy.special import erfc

from ..numerics import Real, Scalar, safe_sqrt

LARGEST = 26.0  # of the argument: beyond it nothing is masked, to the last digit


def G1(cos: Real, roughness: Scalar) -> Real:
    """Smith's masking of one direction whose cosine with the normal is ``cos`` > 0 (Smith 1967; Heitz 2014).

    1 / (1 + Lambda), Lambda = exp(-a^2) / (2 a sqrt(pi)) - erfc(a) / 2, a = cot(theta) / m.
    """
    sin = safe_sqrt((1 - cos) * (1 + cos))
    tilted = LARGEST * roughness * sin > cos
    a = jnp.where(tilted, cos / (roughness * jnp.where(tilted, sin, 1.0)), LARGEST)
    return jnp.where(tilted, 1 / (1 + jnp.exp(-(a**2)) / (2 * a * jnp.sqrt(jnp.pi)) - erfc(a) / 2), 1.0)
