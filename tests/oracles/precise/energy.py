"""The conserving split on the surface: its directional albedo, and what is left for the body under it."""

from functools import cache

import mpmath as mp

from .arithmetic import still
from .lobes import Geometry, lobes
from .quadrature import panels, split


def conserved(surface, under, at, wavelength_um, v, e):
    """Lobes and body by the conserving split; ``under`` is the body without the interface's transmittance."""
    if e.body == "none" and e.diffraction == "off" and e.masking != "none":
        return surface, under  # the mirror term alone, masked, is never in excess
    lit, seen = (_surface_albedo(mp.acos(cos), wavelength_um, v, e) for cos in (at.cos_i, at.cos_o))
    if under:
        under *= max(1 - lit, 0) * max(1 - seen, 0) / _mean_transmittance(wavelength_um, v, e)
    return surface / (max(lit, 1) * max(seen, 1)), under


@cache
def _viewers(theta_i, narrowest):
    """Viewers of light at theta_i, half of them by symmetry: (theta_h, theta_d, cos_o), measure cos_o domega_o.

    Elevations in panels geometric towards the horizon; azimuths from the mirror direction, stretched onto it.
    """
    cos_i, sin_i, nodes = mp.cos(theta_i), mp.sin(theta_i), []
    ladder = [(mp.pi / 2 - theta_i) * mp.mpf(3) ** j for j in range(-1, 12)]
    for up, weight in panels([mp.mpf(0), *(x for x in ladder if x < mp.pi / 2), mp.pi / 2], 8):
        cos_o, sin_o = mp.sin(up), mp.cos(up)
        near = mp.hypot(narrowest * (cos_i + cos_o), sin_i - sin_o)
        width = near / mp.sqrt(sin_i * sin_o)
        for s, ds in panels(split(mp.mpf(0), mp.asinh(mp.pi / width), 1.5), 6):
            half = mp.sin(width * mp.sinh(s) / 2) ** 2
            across = mp.sqrt((sin_i - sin_o) ** 2 + 4 * sin_i * sin_o * half)  # |i_p + o_p|
            theta_h = mp.atan2(across, cos_i + cos_o)
            theta_d = mp.acos(mp.hypot(across, cos_i + cos_o) / 2)
            measure = 2 * weight * ds * width * mp.cosh(s) * cos_o * sin_o
            nodes.append((Geometry(theta_h, theta_d, mp.mpf(0), cos_i, cos_o), measure))
    return nodes


def _surface_albedo(theta_i, wavelength_um, v, e):
    """Directional albedo of the lobes."""
    widths = [v.beta] if e.diffraction == "off" else [v.beta, wavelength_um / v.b / mp.cos(theta_i)]
    nodes = _viewers(theta_i, still(min(widths)))
    return mp.fsum(weight * lobes(at, wavelength_um, v, e, many=True) for at, weight in nodes)


def _mean_transmittance(wavelength_um, v, e):
    """Int (1 - min(1, E)) 2 cos sin dtheta."""
    points = [mp.radians(x) for x in (0, 50, 75, 86, 90)]
    return mp.fsum(
        weight * mp.sin(2 * theta) * max(1 - _surface_albedo(theta, wavelength_um, v, e), 0)
        for theta, weight in panels(points, 6)
    )
