"""Diffraction by nano-geometry: K-correlation lobe, its renormalisation and the energy split (HP17 Section 3.2)."""

import jax.numpy as jnp
import numpy as np

from .numerics import Real, safe_sqrt, total
from .quadrature import gauss_legendre

RENORMALISATION_ORDER = 48  # 1e-9 for b/lambda in [1e-3, 1e4] (tests/model/test_diffraction.py)


def lobe_amplitude(b_over_lambda: Real, c: Real) -> Real:
    """Peak of the K-correlation lobe before renormalisation, (c-1)/(2 pi) (b/lambda)^2, in 1/sr.

    HP17 Eq. 16 prints sigma_s^2 and no 1/lambda^2: that is the height spectrum. As a lobe (Eq. 6, 22) it must integrate
    to one over the projected disc, and cos_o domega_o = lambda^2 df, hence this form.
    """
    return (c - 1) / (2 * jnp.pi) * b_over_lambda**2


def renormalisation(sin_theta: Real, b_over_lambda: Real, c: Real) -> Real:
    """sigma_rel^2 / sigma_s^2 (HP17 Eq. 17-19): the part of the lobe that falls on directions that exist, in (0, 1].

    The lobe lives on the plane of projected directions, centred at distance ``sin_theta`` from the centre of the unit
    disc. Mass within radius r of its centre is 1 - (1 + (b r/lambda)^2)^(-(c-1)/2). The inner disc of radius
    1 - sin_theta is complete; on radii up to 1 + sin_theta the disc holds the fraction alpha/pi of each circle, with
    tan^2(alpha/2) = (1-r+s)(1+r-s) / ((r+s-1)(r+s+1)). The integral over radii runs in t = asinh(b r/lambda), which
    resolves narrow and wide lobes alike, with nodes crowded at both ends where alpha has square-root singularities.

    In the two-scale model the facet meets the light at theta_d, so ``sin_theta = sin(theta_d)``; in the unconvolved
    model it is sin(theta_i).

    Accuracy: 1e-9 for b/lambda in [1e-3, 1e4], c in [1.001, 8].
    """
    s = sin_theta[..., None]
    bl = b_over_lambda[..., None]
    nodes, weights = gauss_legendre(RENORMALISATION_ORDER)
    low, high = jnp.arcsinh(bl * (1 - s)), jnp.arcsinh(bl * (1 + s))
    t = low + (high - low) * jnp.asarray((1 - np.cos(np.pi * nodes)) / 2, bl.dtype)
    dt = (high - low) * jnp.asarray(weights * np.pi / 2 * np.sin(np.pi * nodes), bl.dtype)
    r = jnp.sinh(t) / bl
    opposite = safe_sqrt((1 + s - r) * ((1 - s) + r))
    adjacent = safe_sqrt((r - (1 - s)) * (r + s + 1))
    inside = 2 * jnp.arctan2(opposite, jnp.where(adjacent > 0, adjacent, 1e-18)) / jnp.pi
    ring = total((c[..., None] - 1) * jnp.sinh(t) * jnp.exp(-c[..., None] * jnp.log(jnp.cosh(t))) * inside * dt)
    disc = -jnp.expm1(-(c - 1) / 2 * jnp.log1p((b_over_lambda * (1 - sin_theta)) ** 2))
    return disc + ring


def phase_variance(sigma_rel_squared: Real, cos_d: Real, wavelength_um: Real) -> Real:
    """(4 pi sigma_rel cos_d / lambda)^2, variance of the phase that nano-geometry adds on reflection (HP17 Eq. 25)."""
    return sigma_rel_squared * (4 * jnp.pi * cos_d / wavelength_um) ** 2
