"""Dupuy & Jakob 2018 as renderers evaluate it: a direction is warped back to the unit square, S interpolated there.

Written from the paper's definitions. A file is a dict of arrays by the names of its fields. Between incidences the
densities are interpolated after each was normalised, and so is S, as Mitsuba's plugin `measured` does.
"""

import math

import numpy as np


def share_up_to(heights, x):
    """Integral from 0 to x, over that to 1, of the piecewise linear function with these values at even knots."""
    knots = np.linspace(0, 1, len(heights))
    inside = np.append(knots[knots < x], x)
    return np.trapezoid(np.interp(inside, knots, heights), inside) / np.trapezoid(heights, knots)


def lerp(rows, at):
    """Between the rows of an array, at a place in [0, 1]."""
    place = min(max(at, 0.0), 1.0) * (len(rows) - 1)
    k = min(int(place), len(rows) - 2)
    return (1 - (place - k)) * rows[k] + (place - k) * rows[k + 1]


def bilinear(table, x, y):
    """x along the columns, y along the rows."""
    return lerp(lerp(table, y), x)


def back(density, u, v):
    """The point (s, t) of the unit square that goes to (u, v)."""
    rows = np.trapezoid(density, np.linspace(0, 1, density.shape[1]), axis=1)
    return share_up_to(lerp(density, v), u), share_up_to(rows, v)


def forth(density, s, t):
    """Where (s, t) goes, by bisection."""
    rows = np.trapezoid(density, np.linspace(0, 1, density.shape[1]), axis=1)
    v = _bisect(lambda x: share_up_to(rows, x), t)
    line = lerp(density, v)
    return _bisect(lambda x: share_up_to(line, x), s), v


def _bisect(rises, value):
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rises(middle) < value else (low, middle)
    return (low + high) / 2


def normalised(density):
    """With an integral of 1."""
    knots = [np.linspace(0, 1, n) for n in density.shape]
    return density / np.trapezoid(np.trapezoid(density, knots[1], axis=1), knots[0])


def between(knots, x):
    """(index, weight) of the two knots beside x; the last one's beyond them."""
    if len(knots) == 1:
        return [(0, 1.0)]
    k = int(np.clip(np.searchsorted(knots, x) - 1, 0, len(knots) - 2))
    w = float(np.clip((x - knots[k]) / (knots[k + 1] - knots[k]), 0, 1))
    return [(k, 1 - w), (k + 1, w)]


def to_square(theta, phi):
    """Of an angle to the normal and an azimuth: (u, v)."""
    return math.sqrt(2 * theta / math.pi), (phi + math.pi) / (2 * math.pi)


def angles(w):
    """theta, phi of a unit vector."""
    return math.atan2(math.hypot(w[0], w[1]), w[2]), math.atan2(w[1], w[0])


def evaluate(file, i, o, channel=None, nm=None):
    """f(i, o) cos(theta_o) of an isotropic file, of a channel (RGB) or at a wavelength (nm)."""
    theta_i, phi_i = angles(i)
    theta_m, phi_m = angles((i + o) / np.linalg.norm(i + o))
    u, v = to_square(theta_m, phi_m - phi_i)
    v -= math.floor(v)
    light = [(p, t, a * b) for p, a in between(file["phi_i"], phi_i) for t, b in between(file["theta_i"], theta_i)]
    s = back(sum(w * normalised(file["vndf"][p, t].astype(float)) for p, t, w in light), u, v)
    colours = [(channel, 1.0)] if nm is None else between(file["wavelengths"], nm)
    spectra = file["rgb" if nm is None else "spectra"]
    value = sum(w * x * bilinear(spectra[p, t, c].astype(float), *s) for p, t, w in light for c, x in colours)
    if file["jacobian"][0]:
        value *= bilinear(file["ndf"].astype(float), u, v)
        value /= 4 * bilinear(file["sigma"].astype(float), *to_square(theta_i, phi_i))
    return value
