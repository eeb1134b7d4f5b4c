"""Smith's masking of the GGX distribution, in closed form."""

import jax.numpy as jnp

from ..numerics import Real, Scalar


def G1(cos: Real, alpha: Scalar) -> Real:
    """Smith's masking of one direction whose cosine with the normal is ``cos`` > 0 (Walter et al. 2007, Eq. 34)."""
    return 2 * cos / (cos + jnp.sqrt(alpha**2 + (1 - alpha**2) * cos**2))
