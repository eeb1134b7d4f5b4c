"""The best table of theta_h and theta_d, which no function of these two angles is better than.

Microfacet and diffraction models are, but for masking and bodies, functions of theta_h and theta_d (HP17 Section 3).
What a smooth table of these leaves of a file is noise, sparkle, and light that depends on the azimuth as well; what a
model leaves beyond that, another model of these two angles could gain. A table has hundreds of numbers, and explains
nothing.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from .problem import energy

SPLINES = 28, 8  # of scattered samples: along the rank of theta_h, along cos(theta_d)
LEAST = 8  # samples for each number of a channel
RIDGE = 1e-7  # of the mean square of a column: where directions are few


class Tabulated(NamedTuple):
    """A table fitted to samples.

    Attributes:
        cost: what it leaves of the weighted energy. numbers: how many it has, of all channels.
    """

    cost: float
    numbers: int


def tabulated(samples: Samples | ScatteredSamples) -> Tabulated | None:
    """Every theta_h and theta_d of a grid, or cubic splines through scattered samples, by weighted least squares.

    None where there are fewer than `LEAST` samples a number: a table would pass through their noise.
    """
    scattered = isinstance(samples, ScatteredSamples)
    if scattered and len(samples.theta_h) < LEAST * math.prod(SPLINES):
        return None
    left, numbers = _splines(samples) if scattered else _means(samples.weight, samples.value)
    return Tabulated(float(left / energy(samples)), numbers)


def _means(weight: np.ndarray, value: np.ndarray) -> tuple[float, int]:
    """What the weighted mean over azimuths leaves, (C, H, D, P), and how many means there are."""
    total = weight.sum(-1)
    mean = (weight * value).sum(-1) / np.where(total > 0, total, 1.0)
    return float(np.sum(weight * (value - mean[..., None]) ** 2)), int((total > 0).sum())


def _splines(samples: ScatteredSamples) -> tuple[float, int]:
    rank = (np.argsort(np.argsort(samples.theta_h)) + 0.5) / len(samples.theta_h)
    along = [_basis(x, count) for x, count in zip((rank, np.cos(samples.theta_d)), SPLINES, strict=True)]
    columns = (along[0][:, :, None] * along[1][:, None, :]).reshape(len(rank), -1)
    left = 0.0
    for weight, value in zip(samples.weight, samples.value, strict=True):
        root = np.sqrt(weight)
        weighed, target = columns * root[:, None], root * value
        gram = weighed.T @ weighed
        gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        left += float(np.sum((target - weighed @ np.linalg.solve(gram, weighed.T @ target)) ** 2))
    return left, columns.shape[1] * len(samples.value)


def _basis(x: np.ndarray, count: int) -> np.ndarray:
    """So many cubic B-splines over [0, 1] at the places ``x``."""
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    return BSpline.design_matrix(np.clip(x, 0, 1 - 1e-9), knots, 3).toarray()
