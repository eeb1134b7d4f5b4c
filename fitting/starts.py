"""Deterministic starting points read off the data: lobe width, reflectance at normal incidence, dark directions.

A few dozen combinations of what the data do not say at a glance (kurtosis, nano-geometry, kind of index) around what
they do say are handed to the caller, who screens them by cost.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..merl_io.samples import Samples
from ..model.effects import Effects
from ..model.parameters import WAVELENGTHS_UM
from .transforms import layout_of

KURTOSES = (0.4, 1.0)
NANO = ((0.4, 1.5), (2.0, 1.5), (10.0, 1.5), (2.0, 3.0))  # (b um, c)
PHASES = (0.15, 1.5)  # (4 pi sigma_s / lambda)^2: a little and most of the light diffracted at normal incidence
DARK_QUANTILE = 0.1  # of the bins away from the lobe: taken for the body


@dataclass(frozen=True)
class Clues:
    """What is read off the data.

    Attributes:
        half_height: tan(theta_h) where the lobe at small theta_d has fallen to half.
        f0: reflectance of the lobe at normal incidence per channel, (C,). dark: BRDF away from the lobe, (C,).
        rise: lobe at grazing theta_d over lobe at small theta_d.
    """

    half_height: float
    f0: np.ndarray
    dark: np.ndarray
    rise: float


def read_clues(samples: Samples) -> Clues:
    """Profiles over theta_h at small and at grazing theta_d, averaged over azimuth."""
    weight = (samples.weight > 0).astype(float)

    def profile(columns: slice) -> np.ndarray:
        w = weight[:, :, columns]
        return (w * samples.value[:, :, columns]).sum((2, 3)) / np.maximum(w.sum((2, 3)), 1e-9)

    count = len(samples.theta_d)
    steep, grazing = profile(slice(0, max(1, count // 6))), profile(slice(int(count * 0.75), int(count * 0.85) + 1))
    away = (samples.theta_h > 0.6)[:, None, None] & (samples.theta_d < 0.9)[None, :, None] & (weight[0] > 0)
    fallback = np.median(samples.value[0][weight[0] > 0]) if weight.any() else 0.1
    dark = np.array([np.quantile(v[away], DARK_QUANTILE) if away.any() else fallback for v in samples.value])
    lobe = np.maximum(steep - dark[:, None], 0.0)
    brightness = lobe.mean(0)
    peak = brightness[:2].max() if brightness.size else 0.0
    below = np.flatnonzero(brightness < peak / 2)
    tangent = np.tan(np.minimum(samples.theta_h, 1.5))
    half_height = tangent[below[0]] if len(below) and below[0] > 0 else tangent[0]
    # rho = F0 D / (4 cos^2 theta_h) at theta_d = 0 and the integral of D cos over the hemisphere is 1
    measure = 2 * np.pi * np.sin(samples.theta_h) * np.cos(samples.theta_h) ** 3 * np.gradient(samples.theta_h)
    f0 = np.clip((4 * lobe * measure).sum(1), 2e-3, 0.98)
    first = grazing[:, 0] - dark
    rise = float(np.clip(first.mean() / max(peak, 1e-9), 1.0, 50.0))
    return Clues(float(np.clip(half_height, 2e-3, 2.0)), f0, np.maximum(dark, 1e-5), rise)


def starting_points(effects: Effects, samples: Samples) -> np.ndarray:
    """Starting points in free coordinates, shape (S, P); the same for the same file, whatever the machine or seed."""
    clues = read_clues(samples)
    middle = WAVELENGTHS_UM[len(WAVELENGTHS_UM) // 2]
    points = []
    for p, (b, c), phase, (n, k, eta) in product(KURTOSES, NANO, PHASES, _indices(effects, clues)):
        points.append(
            {
                "beta": clues.half_height / np.log(2.0) ** (1 / (2 * p)),
                "p": p,
                "b": b,
                "c": c,
                "sigma_s": np.sqrt(phase) * middle / (4 * np.pi),
                "grazing_exponent": 0.5,
                "n": n,
                "k": k,
                "eta": eta,
                "albedo": np.clip(np.pi * clues.dark, 1e-4, 0.98),
            }
        )
    if effects.diffraction == "off":
        points = [q for q in points if (q["b"], q["c"]) == NANO[0] and q["sigma_s"] == points[0]["sigma_s"]]
    return np.array([layout_of(effects).free(q) for q in points])


def _indices(effects: Effects, clues: Clues) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(n, k, eta) that give F0: a metal's with n = 1, and where F rises towards grazing angles a dielectric's."""
    root = np.sqrt(clues.f0)
    dielectric = (1 + root) / (1 - root)
    metal = (np.ones_like(root), 2 * root / np.sqrt(1 - clues.f0), dielectric)
    if effects.body != "none":
        return [metal]  # only eta is used
    return [metal, (np.minimum(dielectric, 5.0), np.full_like(root, 0.3), dielectric)][: 2 if clues.rise > 1.5 else 1]
