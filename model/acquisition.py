"""What the MERL apparatus does to a BRDF at grazing angles (HP17 Section 5, Fig. 10); never part of a material.

A pixel of the photographed sphere averages over a footprint of normals whose width grows as 1/cos(theta). It blurs the
distribution of normals and lowers its peak. HP17 approximate the loss by p(i, o) = p1(theta_i) p1(theta_o) with
p1 = (1 - 4 theta^2/pi^2)^k, k in [0, 1] (Eq. 59-60).
"""

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import i0e

from .geometry import Geometry
from .numerics import Real, Scalar, safe_pow

FOOTPRINT_RAD = 0.005  # a sphere about 400 pixels across: 1 pixel is 1/200 rad of its normal
FIT_ANGLES_RAD = np.radians(np.arange(10.0, 81.0, 5.0))  # where the power law is matched to the loss
LOG_RADII = np.arange(-9.0, 4.5, 0.15)  # of r / beta^..., trapezoid in log r


def grazing_log_base(geometry: Geometry) -> Real:
    """log of (1 - 4 theta_i^2/pi^2)(1 - 4 theta_o^2/pi^2); times the exponent, the log of the loss (Eq. 59-60)."""
    base = [1 - (2 * theta / jnp.pi) ** 2 for theta in (geometry.theta_i, geometry.theta_o)]
    positive = (base[0] > 0) & (base[1] > 0)
    return jnp.where(positive, jnp.log(jnp.where(positive, base[0] * base[1], 1.0)), -jnp.inf)


def grazing(geometry: Geometry, exponent: Scalar) -> Real:
    """p(i, o) in [0, 1], HP17 Eq. 59-60, for an exponent k in [0, 1]."""
    base = (1 - (2 * geometry.theta_i / jnp.pi) ** 2) * (1 - (2 * geometry.theta_o / jnp.pi) ** 2)
    return safe_pow(base, exponent)


def blurred_peak(theta: Real, beta: Scalar, p: Scalar, footprint_rad: float) -> Real:
    """Peak of P22 under a Gaussian footprint of widths w/cos(theta) and w, relative to no blur; in (0, 1].

    The footprint is foreshortened along one meridian only. Integrated over rings of slope r: the mean of a Gaussian of
    widths (s1, s2) over a ring is exp(-r^2 (1/s1^2 + 1/s2^2)/4) I0(r^2 (1/s2^2 - 1/s1^2)/4) / (2 pi s1 s2).
    """
    s1, s2 = footprint_rad / jnp.cos(theta)[..., None], footprint_rad
    log_scale = jnp.log(jnp.minimum(s1, beta))
    r = jnp.exp(log_scale + LOG_RADII * jnp.maximum(1.0, 1 / (2 * p)))
    z = r**2 * (1 / s2**2 - 1 / s1**2) / 4
    ring = jnp.exp(-(r**2) / (2 * s1**2)) * i0e(z) / (s1 * s2)
    shape = jnp.exp(-((r / beta) ** (2 * p)))
    step = (LOG_RADII[1] - LOG_RADII[0]) * jnp.maximum(1.0, 1 / (2 * p))
    return jnp.sum(ring * shape * r**2, -1) * step


def derived_exponent(beta: Scalar, p: Scalar, footprint_rad: float = FOOTPRINT_RAD) -> Real:
    """The exponent k(beta, p) in [0, 1] that the footprint implies (HP17 Eq. 60).

    Least squares of log loss(theta) against log(1 - 4 theta^2/pi^2) over 10 to 80 degrees, the loss being that of the
    blurred peak relative to normal incidence. Near 1 for lobes narrower than the footprint, near 0 for wide ones.

    Args:
        beta, p: the EPD. footprint_rad: standard deviation of a pixel's footprint on the sphere at normal incidence.
    """
    log_base = np.log(1 - (2 * FIT_ANGLES_RAD / np.pi) ** 2)
    loss = jnp.log(blurred_peak(jnp.asarray(FIT_ANGLES_RAD), beta, p, footprint_rad))
    loss = loss - jnp.log(blurred_peak(jnp.zeros(()), beta, p, footprint_rad))
    return jnp.clip(jnp.sum(loss * log_base) / np.sum(log_base**2), 0.0, 1.0)
