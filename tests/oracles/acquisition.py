"""A photographed sphere, pixel by pixel: what HP17 Section 5 and Fig. 10 say of the MERL apparatus, simulated.

A sphere of radius 1 is seen from +z. A pixel at (x, y) of the image averages the radiance around it with a Gaussian
response of standard deviation `footprint` (in sphere radii). With camera and light far away the half vector h is one
and the same for all pixels; what changes under the footprint is the normal, n = (x, y, sqrt(1 - x^2 - y^2)), and with
it theta_i, theta_o and theta_h. The pixel that sees the mirror reflection is the one whose normal is h.

Nothing is linearised: the sphere curves under the footprint, and the footprint reaches beyond the sphere's limb and
into its shadow. Integrals are trapezoid rules in polar coordinates (log radius, azimuth) of the image plane around the
image of the point whose normal is h, where both the lobe and, without a light of finite size, the response are centred.
"""

import numpy as np
from scipy.special import erf, gamma

ANGLES_RAD = np.radians(np.arange(10.0, 81.0, 5.0))


def epd(cross, dot, beta, p):
    """D (1/sr, HP17 Eq. 34-35) of the angle whose sine and cosine are given; 0 below the horizon of the facet."""
    above = dot > 1e-9
    tan, cos = cross / np.where(above, dot, 1.0), np.where(above, dot, 1.0)
    exponent = np.minimum((tan / beta) ** (2 * p), 700.0)
    return np.where(above, p / (np.pi * beta**2 * gamma(1 / p)) * np.exp(-exponent) / cos**4, 0.0)


def beckmann_g1(cos, beta):
    """Smith's masking of one direction for p = 1 (HP17 Eq. 38)."""
    a = cos / (np.sqrt(np.maximum(1 - cos**2, 1e-30)) * beta)
    return 1 / (1 + (erf(a) - 1) / 2 + np.exp(-np.minimum(a**2, 700.0)) / (2 * a * np.sqrt(np.pi)))


def seen_point(x, y, camera):
    """Normal (= point) of the sphere on the ray through the image point (x, y), and whether there is one.

    `camera` is its distance from the centre in radii. The image's scale is that of the plane through the centre.
    """
    if np.isinf(camera):
        inside = x**2 + y**2 < 1
        return np.stack([x, y, np.sqrt(np.where(inside, 1 - x**2 - y**2, 0.0))], -1), inside
    slope = np.stack([x, y, np.full_like(x, -camera)], -1)
    ray = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
    start = np.array([0.0, 0.0, camera])
    along = ray @ start
    root = along**2 - (camera**2 - 1)
    inside = root > 0
    return start + (-along - np.sqrt(np.where(inside, root, 0.0)))[..., None] * ray, inside


def image_point(normal, camera):
    """Where the image shows the sphere's point of this normal."""
    return normal[:2] if np.isinf(camera) else normal[:2] * camera / (camera - normal[2])


def mirror_setting(theta, camera):
    """Normal and directions to light and camera at the point of the sphere that reflects at `theta`."""
    along = theta if np.isinf(camera) else theta - np.arcsin(np.sin(theta) / camera)
    normal = np.array([np.sin(along), 0.0, np.cos(along)])
    to_camera = np.array([0.0, 0.0, 1.0]) if np.isinf(camera) else unit(np.array([0.0, 0.0, camera]) - normal)
    return normal, 2 * (normal @ to_camera) * normal - to_camera, to_camera


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def radiance(x, y, to_light, beta, p, camera, lamp, masked):
    """Image of the lobe, without its constant: D, or D G/cos_o of a Beckmann surface (Cook-Torrance, F = 1).

    `to_light` is the direction of a distant light, or the place of one at a finite distance (`lamp`), in radii.
    """
    n, inside = seen_point(x, y, camera)
    i = unit(to_light - n) if lamp else to_light
    o = np.array([0.0, 0.0, 1.0]) if np.isinf(camera) else unit(np.array([0.0, 0.0, camera]) - n)
    h = unit(i + o)
    cos_i, cos_o = np.sum(n * i, -1), np.sum(n * o, -1)
    lit = inside & (cos_i > 0) & (cos_o > 0)
    value = epd(np.linalg.norm(np.cross(n, h), axis=-1), np.sum(n * h, -1), beta, p)
    if masked:
        cos_i, cos_o = np.where(lit, cos_i, 1.0), np.where(lit, cos_o, 1.0)
        value = value * beckmann_g1(cos_i, beta) * beckmann_g1(cos_o, beta) / cos_o
    return np.where(lit, value, 0.0)


def lights(theta, spread, width, refine):
    """Directions and weights of a lamp with a Gaussian angular spread, by the trapezoid rule.

    Symmetric in the plane of incidence y = 0: only one side is kept. A turn of the lamp by a moves h by a/2 in the
    plane and a/(2 cos) across it, under a signal no narrower than `width`: the steps resolve the product of both.
    """
    to_light = np.array([np.sin(2 * theta), 0.0, np.cos(2 * theta)])
    if spread == 0:
        return [(to_light, 1.0)]

    def rule(reach):
        step = 1.1 / refine / np.hypot(1, spread * reach / width)
        nodes = np.arange(-np.ceil(5 / step), np.ceil(5 / step) + 1) * step
        return nodes, step * np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi)

    side = np.array([0.0, 1.0, 0.0])
    ahead = np.cross(side, to_light)
    return [
        (unit(to_light + spread * (a * ahead + b * side)), wa * wb * (1.0 if b == 0 else 2.0))
        for a, wa in zip(*rule(0.5), strict=True)
        for b, wb in zip(*rule(0.5 / np.cos(theta)), strict=True)
        if b >= 0
    ]


def pixel_signal(theta, beta, p, footprint, spread=0.0, camera=np.inf, lamp=np.inf, masked=False, refine=1.0):
    """Signal of the pixel that sees the mirror reflection at `theta`, without a constant factor.

    Args:
        footprint: standard deviation of the pixel's response, in sphere radii. spread: that of the light's direction
            (rad). camera, lamp: distances in radii, from the sphere's centre and from the point seen. masked: with the
            masking and the 1/cos_o of Cook-Torrance, for p = 1. refine: divides the steps.
    """
    assert spread == 0 or (np.isinf(camera) and np.isinf(lamp)), "a light of finite size is simulated far away only"
    assert not masked or p == 1, "masking is Beckmann's"
    normal, to_light, _ = mirror_setting(theta, camera)
    centre = image_point(normal, camera)
    # the response decays over 9 sigma; below the least radius lies 1e-8 of either integral
    step = 0.04 / refine
    azimuth = (np.arange(round(192 * refine)) + 0.5) * 2 * np.pi / round(192 * refine)
    total = 0.0
    for i, weight in lights(theta, spread, np.hypot(footprint, beta), refine) if spread else [(to_light, 1.0)]:
        h = unit(i + np.array([0.0, 0.0, 1.0]))
        origin = h[:2] if spread else centre  # where the normal is h; at finite distances, that is the pixel itself
        least = 1e-4 * min(footprint, beta * np.cos(theta))
        most = 9 * footprint + np.linalg.norm(origin - centre)
        rho = np.exp(np.arange(np.log(least), np.log(most) + step, step))[:, None]
        x, y = origin[0] + rho * np.cos(azimuth), origin[1] + rho * np.sin(azimuth)
        away = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / footprint**2
        response = np.exp(-away / 2) / (2 * np.pi * footprint**2)
        place = normal + lamp * i if np.isfinite(lamp) else i
        light = radiance(x, y, place, beta, p, camera, np.isfinite(lamp), masked)
        total += weight * np.sum(response * light * rho**2) * step * 2 * np.pi / len(azimuth)
    return total


def unblurred_signal(theta, beta, p, camera=np.inf, lamp=np.inf, masked=False):
    """The same signal of an infinitely small pixel and light."""
    normal, i, _ = mirror_setting(theta, camera)
    x, y = (np.array([v]) for v in image_point(normal, camera))
    place = normal + lamp * i if np.isfinite(lamp) else i
    return float(radiance(x, y, place, beta, p, camera, np.isfinite(lamp), masked)[0])


def loss(theta, beta, p, footprint, **setting):
    """Blurred over unblurred mirror signal at `theta`, relative to the same at normal incidence."""
    exact = {k: v for k, v in setting.items() if k in ("camera", "lamp", "masked")}

    def kept(angle):
        return pixel_signal(angle, beta, p, footprint, **setting) / unblurred_signal(angle, beta, p, **exact)

    return kept(theta) / kept(0.0)


def exponent(losses, angles=ANGLES_RAD, factors=2):
    """k of HP17 Eq. 59-60 by least squares on the logarithm of the loss; in the mirror direction theta_i = theta_o."""
    base = factors * np.log(1 - (2 * angles / np.pi) ** 2)
    return float(np.linalg.lstsq(base[:, None], np.log(losses), rcond=None)[0][0])


def grazing_exponent(beta, p, footprint, angles=ANGLES_RAD, **setting):
    """k(beta, p) of the simulated apparatus."""
    return exponent(np.array([loss(t, beta, p, footprint, **setting) for t in angles]), angles)
