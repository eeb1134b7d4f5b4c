"""What the MERL apparatus does to a BRDF at grazing angles (HP17 Section 5, Fig. 10); never part of a material.

A sphere is photographed; a pixel averages over the normals under its footprint, a Gaussian of width w in sphere radii.
Camera and light are far away, so the half vector h is the same for all pixels and a ring of normals at angle theta_h
around h shares one value of D. In the pixel whose normal is h the footprint covers angles w/cos(theta) along the plane
of incidence, foreshortened by the camera, and w across it. Lobes narrower than that lose height, and more of it towards
grazing angles: for the narrowest the loss is cos(theta), relative to normal incidence. HP17 approximate it by

    p(i, o) = p1(theta_i) p1(theta_o),    p1 = (1 - 4 theta^2/pi^2)^k,    k in [0, 1]        (Eq. 59-60)

In the mirror direction theta_i = theta_o, so p = p1^2. Since 1 - 4 theta^2/pi^2 is nearly cos(theta), a footprint gives
k of 0.57 at the most; HP17's "k near 1 for a specular material" takes a loss of cos^2(theta), a footprint widened both
ways. A lamp of finite size does nearly that: its spread a moves h by a/2 in that plane, by a/(2 cos(theta)) across it.
"""

import math
from functools import lru_cache

import jax.numpy as jnp
import numpy as np

from .apparatus import Apparatus
from .geometry import Geometry
from .numerics import Real, Scalar

LOG_NOTHING = -80.0  # log of the base of the loss at the horizon; finite in float32, too
FIT_ANGLES_RAD = np.radians(np.arange(10.0, 81.0, 5.0))  # where the power law is matched to the loss
LOG_STEP = 0.05  # of theta_h: trapezoid error 3e-9 at p = 5, whose edge exp(-x^10) is the sharpest in the fit's bounds
# From 1e-4 of the narrowest lobe of the fit's bounds (its share is the square of that) to just short of the horizon.
RINGS_RAD = np.exp(np.arange(np.log(1e-7), np.log(1.5), LOG_STEP))
RING_AZIMUTHS = (
    1024  # of a ring of normals: a footprint's width is 1/40 of the largest radius it reaches, at 80 degrees
)


def grazing_log_base(geometry: Geometry) -> Real:
    """log of (1 - 4 theta_i^2/pi^2)(1 - 4 theta_o^2/pi^2); times the exponent, the log of the loss (Eq. 59-60).

    At the horizon a number so low that nothing is left, and not minus infinity, which times an exponent of 0 is NaN.
    """
    base = [1 - (2 * theta / jnp.pi) ** 2 for theta in (geometry.theta_i, geometry.theta_o)]
    positive = (base[0] > 0) & (base[1] > 0)
    return jnp.where(positive, jnp.log(jnp.where(positive, base[0] * base[1], 1.0)), LOG_NOTHING)


def stretch(theta: float, apparatus: Apparatus) -> tuple[float, float]:
    """How much farther n moves from h under a step in the image than with camera and lamp at infinity, (along, across).

    To first order in the step. The picture's scale is that of the plane through the sphere's centre; a step that
    moves the point also turns the directions to camera and lamp against n, and h by half of both, divided by cos(theta)
    across the plane of incidence.
    """
    nearness = apparatus.camera_nearness
    cos = math.cos(theta)
    cos_view = math.sqrt(1 - (nearness * math.sin(theta)) ** 2)  # of the angle between the ray and the camera's axis
    scale = cos_view - nearness * cos  # distance of the point over that of the centre
    turn = (nearness / scale + apparatus.lamp_nearness) / 2
    return scale * cos_view**2 * (1 + turn * cos), scale * cos_view * (1 + turn / cos)


@lru_cache(maxsize=16)
def ring_weights(apparatus: Apparatus, angles: tuple[float, ...]) -> np.ndarray:
    """Weight of D(RINGS_RAD) in the mirror pixel at ``angles`` (rad), shape (angles, rings), trapezoid rule included.

    signal(theta) = sum of weight * D is the pixel's mean of D. The sphere is exact: a ring's normals are projected on
    the image, without those beyond its limb or in its shadow. The lamp's spread and finite distances are of first
    order, as Gaussian widths.
    """
    azimuth = (np.arange(RING_AZIMUTHS // 2) + 0.5) * 2 * np.pi / RING_AZIMUTHS  # the other half mirrors it
    sin, cos = np.sin(RINGS_RAD)[:, None], np.cos(RINGS_RAD)[:, None]
    versine = 2 * np.sin(RINGS_RAD / 2)[:, None] ** 2  # 1 - cos, with all its digits
    weights = []
    for theta in angles:
        sin_t, cos_t = math.sin(theta), math.cos(theta)
        along, across = sin * np.cos(azimuth) * cos_t - versine * sin_t, sin * np.sin(azimuth)  # of n - h, projected
        cos_o = cos * cos_t - sin * np.cos(azimuth) * sin_t
        cos_i = cos * cos_t + sin * np.cos(azimuth) * sin_t
        stretch_along, stretch_across = stretch(theta, apparatus)
        half_lamp = apparatus.lamp_sigma_rad / 2
        width_along = math.hypot(apparatus.footprint_rad * stretch_along, half_lamp * cos_t)
        width_across = math.hypot(apparatus.footprint_rad * stretch_across, half_lamp / cos_t)
        response = np.exp(-((along / width_along) ** 2 + (across / width_across) ** 2) / 2)
        response *= np.maximum(cos_o, 0.0) * (cos_i > 0) / (2 * np.pi * width_along * width_across)
        weights.append(2 * np.sum(response, 1) * 2 * np.pi / RING_AZIMUTHS)
    return np.stack(weights) * (sin[:, 0] * RINGS_RAD * LOG_STEP)


def epd_of_rings(beta: Scalar, p: Scalar) -> Real:
    """D over its peak at RINGS_RAD."""
    # exp(-e^8) is 0, and its derivative too, where the power itself would overflow
    exponent = jnp.exp(jnp.minimum(2 * p * (np.log(np.tan(RINGS_RAD)) - jnp.log(beta)), 8.0))
    return jnp.exp(-exponent) / np.cos(RINGS_RAD) ** 4


def loss_of_lobe(theta: tuple[float, ...], lobe: Real, apparatus: Apparatus) -> Real:
    """Height of a lobe's peak in the picture of the sphere, over its height at normal incidence, shape (N,).

    Args:
        theta: angles of incidence (rad), static. lobe: a function of theta_h at RINGS_RAD, of any unit.

    Accuracy, of the lobe D: 1e-4 of a simulation in the image plane, 2e-3 with distances of 8 radii or more or a lamp
    of 0.01 rad (``tests/model/test_acquisition.py``). Gradient in beta and p finite everywhere.
    """
    signal = jnp.asarray(ring_weights(apparatus, (0.0, *theta))) @ lobe
    return signal[1:] / signal[0]


def exponent_of_lobe(lobe: Real, apparatus: Apparatus) -> Real:
    """The exponent k in [0, 1] that the apparatus implies (HP17 Eq. 60) for a lobe given at RINGS_RAD, of any unit.

    Least squares of log loss against log p1(theta)^2 = 2 k log(1 - 4 theta^2/pi^2) over 10 to 80 degrees. Near 0 for
    lobes wider than the footprint; for much narrower ones 0.57 with a point lamp, and 0.86 with one of twice the
    footprint's spread, which blurs h as much as the footprint blurs n.

    Accuracy, of the lobe D: 3e-4 of the simulated apparatus (``test_exponent_to_3e_4``); computed in float64. The
    masking of facets is left out: with Beckmann's k differs by less than 0.006. The law itself misses the loss by up to
    0.13 where the lobe is a few footprints wide, whose loss sets in abruptly; least squares on the loss instead of its
    logarithm would give k lower by up to 0.03 there.
    """
    log_base = 2 * np.log(1 - (2 * FIT_ANGLES_RAD / np.pi) ** 2)
    loss = jnp.log(loss_of_lobe(tuple(FIT_ANGLES_RAD.tolist()), lobe, apparatus))
    # a wide, flat lobe with D growing as 1/cos^4 would give -0.0003
    return jnp.clip(jnp.sum(loss * log_base) / np.sum(log_base**2), 0.0, 1.0)
