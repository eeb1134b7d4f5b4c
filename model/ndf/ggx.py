"""The GGX distribution of microfacet normals (Walter et al. 2007; Trowbridge & Reitz 1975), and its masking."""

import jax.numpy as jnp

from ..numerics import Real, Scalar


def D(theta_h: Real, alpha: Scalar) -> Real:
    """Distribution of normals (1/sr), alpha^2 / (pi cos^4 (alpha^2 + tan^2)^2) (Walter et al. 2007, Eq. 33).

    Args:
        theta_h: angle between microfacet and surface normal (rad). alpha: width (tangent of an angle), > 0.

    Its integral of D cos over the hemisphere is 1 to 1e-6 (``tests/rivals/test_microfacets.py``).
    """
    sin, cos = jnp.sin(theta_h), jnp.cos(theta_h)
    return alpha**2 / (jnp.pi * (alpha**2 * cos**2 + sin**2) ** 2)


def G1(cos: Real, alpha: Scalar) -> Real:
    """Smith's masking of one direction whose cosine with the normal is ``cos`` > 0 (Walter et al. 2007, Eq. 34)."""
    return 2 * cos / (cos + jnp.sqrt(alpha**2 + (1 - alpha**2) * cos**2))
