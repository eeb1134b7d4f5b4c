"""A file as two tables, of theta_h and theta_d and of theta_i and theta_o: the fit of last resort.

Microfacet and diffraction models are functions of theta_h and theta_d (HP17 Section 3), but for masking, for what the
apparatus loses at grazing angles, and for bodies, which are functions of theta_i and theta_o. The sum of a table of the
first two angles, which is what a half-vector projection of the file keeps, and of a smooth one of the others, in which
light and viewer may be exchanged, explains nothing, and has hundreds of numbers. What it leaves of a file is noise,
sparkle and what depends on all angles at once; what a model leaves beyond that, another model could gain.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import KDTree

from ...merl_io.grid import MerlGrid
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from .problem import energy

SPLINES = 28, 8  # of scattered samples: along the rank of theta_h, along cos(theta_d)
COSINES = 6  # splines along cos(theta_i) and cos(theta_o)
LEAST = 8  # samples for each number of a channel
FAR = 0.1  # from the nearest sample, in shares of the ranks of theta_h and of a right angle: nothing is known there
RIDGE = 1e-7  # of the mean square of a column: where directions are few
ROWS = 10  # of theta_h at a time


class Tabulated(NamedTuple):
    """Tables fitted to samples.

    Attributes:
        cost: what they leave of the weighted energy. numbers: how many they have, of all channels.
        predicted: of the samples, in the shape of their values (1/sr).
        on: the same on a grid of MERL's bins, (C, H, D, P); of samples on a grid, on theirs alone. NaN where nothing
            near was measured.
    """

    cost: float
    numbers: int
    predicted: np.ndarray
    on: Callable[[MerlGrid], np.ndarray]


def tabulated(samples: Samples | ScatteredSamples) -> Tabulated | None:
    """The tables by weighted least squares: of a grid every theta_h and theta_d, of scattered samples cubic splines.

    None where there is no light in a channel, or fewer than `LEAST` samples for each of its numbers: a table would pass
    through their noise.
    """
    lit = np.sum(samples.weight * samples.value**2, tuple(range(1, samples.weight.ndim))) > 0
    if isinstance(samples, ScatteredSamples):
        enough = len(samples.theta_h) >= LEAST * (math.prod(SPLINES) + _count(COSINES))
        return _of_scattered(samples) if enough and lit.all() else None
    enough = samples.value.shape[-1] >= LEAST
    return _of_grid(samples) if enough and lit.all() else None


def _of_grid(samples: Samples) -> Tabulated:
    """A table of every theta_h and theta_d, eliminated from the normal equations of the other (Frisch & Waugh 1933)."""
    channels, rows = len(samples.value), [slice(k, k + ROWS) for k in range(0, len(samples.theta_h), ROWS)]
    total = samples.weight.sum(-1)
    safe = np.where(total > 0, total, 1.0)

    def mean(x: np.ndarray, some: slice) -> np.ndarray:
        """Over azimuths, (C, H, D, ...)."""
        over = np.einsum("chdp,chdp...->chd...", samples.weight[:, some], x)
        return over / safe[:, some].reshape(*over.shape[:3], *(1,) * (over.ndim - 3))

    gram, projected = np.zeros((channels, _count(COSINES), _count(COSINES))), np.zeros((channels, _count(COSINES)))
    for some in rows:
        columns = _symmetric(samples.cos_i[some], samples.cos_o[some])
        for c in range(channels):
            own = samples.weight[c, some, :, :, None]
            away = columns - (own * columns).sum(-2, keepdims=True) / safe[c, some, :, None, None]
            flat = (own * away).reshape(-1, _count(COSINES))
            gram[c] += flat.T @ away.reshape(-1, _count(COSINES))
            projected[c] += flat.T @ samples.value[c, some].ravel()
    body = np.stack([_solved(g, p) for g, p in zip(gram, projected, strict=True)])

    def of_cosines(cos_i: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
        return np.einsum("...j,cj->c...", _symmetric(cos_i, cos_o), body)

    beside = np.concatenate([of_cosines(samples.cos_i[some], samples.cos_o[some]) for some in rows], 1)
    lobe = mean(samples.value - beside, slice(None))
    predicted = np.maximum(lobe[..., None] + beside, 0.0)

    def on(grid: MerlGrid) -> np.ndarray:
        parts = [of_cosines(grid.cos_i[some], grid.cos_o[some]) for some in rows]
        drawn = np.maximum(lobe[..., None] + np.concatenate(parts, 1), 0.0)
        return np.where((total > 0)[..., None], drawn, np.nan)

    return _left(samples, predicted, int((total > 0).sum()) + body.size, on)


def _of_scattered(samples: ScatteredSamples) -> Tabulated:
    """Tensors of cubic splines, along the rank of theta_h: as fine as the directions are."""
    ordered = np.sort(samples.theta_h)
    ranks = (np.arange(len(ordered)) + 0.5) / len(ordered)

    def ranks_of(theta_h: np.ndarray) -> np.ndarray:
        return np.interp(theta_h, ordered, ranks)

    def columns(theta_h: np.ndarray, theta_d: np.ndarray, cos_i: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
        along = _basis(ranks_of(theta_h), SPLINES[0]), _basis(np.cos(theta_d), SPLINES[1])
        lobe = (along[0][:, :, None] * along[1][:, None, :]).reshape(len(theta_h), -1)
        return np.concatenate([lobe, _symmetric(cos_i, cos_o)], 1)

    own = columns(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
    weighed = (np.sqrt(weight)[:, None] * own for weight in samples.weight)
    found = np.stack(
        [
            _solved(x.T @ x, x.T @ (np.sqrt(weight) * value))
            for x, weight, value in zip(weighed, samples.weight, samples.value, strict=True)
        ]
    )

    used = np.all(samples.weight > 0, 0)
    measured = KDTree(np.stack([ranks_of(samples.theta_h), samples.theta_d / np.pi * 2], -1)[used])

    def on(grid: MerlGrid) -> np.ndarray:
        parts = []
        for k, theta_h in enumerate(grid.theta_h):
            cos_i, cos_o = grid.cos_i[k], grid.cos_o[k]
            theta_d = np.broadcast_to(grid.theta_d[:, None], cos_i.shape).ravel()
            rank = np.full(len(grid.theta_d), ranks_of(np.array(theta_h)))
            near = measured.query(np.stack([rank, grid.theta_d / np.pi * 2], -1))[0] < FAR
            own = columns(np.full(theta_d.shape, theta_h), theta_d, cos_i.ravel(), cos_o.ravel())
            drawn = np.maximum((found @ own.T).reshape(-1, *cos_i.shape), 0.0)
            parts.append(np.where(near[:, None], drawn, np.nan))
        return np.stack(parts, 1)

    return _left(samples, np.maximum(found @ own.T, 0.0), found.size, on)


def _left(
    samples: Samples | ScatteredSamples, predicted: np.ndarray, numbers: int, on: Callable[[MerlGrid], np.ndarray]
) -> Tabulated:
    left = float(np.sum(samples.weight * (samples.value - predicted) ** 2))
    return Tabulated(left / energy(samples), numbers, predicted, on)


def _solved(gram: np.ndarray, projected: np.ndarray) -> np.ndarray:
    return np.linalg.solve(gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), projected)


def _count(splines: int) -> int:
    """Of products that stay the same when both factors are exchanged."""
    return splines * (splines + 1) // 2


def _symmetric(cos_i: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
    """Products of splines of both cosines (...), in which light and viewer may be exchanged, (..., J)."""
    one, other = (_basis(x.ravel(), COSINES).reshape(*x.shape, COSINES) for x in (cos_i, cos_o))
    j, k = np.triu_indices(COSINES)
    return one[..., j] * other[..., k] + one[..., k] * other[..., j]


def _basis(x: np.ndarray, count: int) -> np.ndarray:
    """So many cubic B-splines over [0, 1] at the places ``x``."""
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    return BSpline.design_matrix(np.clip(x, 0, 1 - 1e-9), knots, 3).toarray()
