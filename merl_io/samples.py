"""Samples with weights on the half of MERL's bins that a reciprocal model can tell apart, and thinned sets of them."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from .bands import MERL, Bands
from .binary import DIMS, Measurement
from .grid import MerlGrid


@dataclass(frozen=True)
class Samples:
    """Folded measurements on a product grid of angles.

    Attributes:
        theta_h, theta_d, phi_d: axes (rad), shapes (H,), (D,), (P,), phi_d below pi/2.
        cos_i, cos_o: cosines of light and viewer, shape (H, D, P).
        value: mean measured BRDF (1/sr), shape (C, H, D, P); 0 where no datum is valid.
        weight: sum of the weights that stand behind a value, shape (C, H, D, P); 0 where no datum is valid.
        scatter: sum of w (m - mean)^2 over all folded pairs: what no reciprocal model can explain.
        bands: of the C planes.
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    phi_d: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    scatter: float
    bands: Bands = MERL


def fold(grid: MerlGrid, value: np.ndarray, weight: np.ndarray) -> Samples:
    """Average bins phi_d and pi - phi_d, which hold the same pair of directions with light and viewer exchanged.

    A weighted sum of squares against one prediction splits exactly: w1 (m1-p)^2 + w2 (m2-p)^2 =
    (w1+w2) (m-p)^2 + w1 w2/(w1+w2) (m1-m2)^2 with m the weighted mean. Nothing is resampled.

    Args:
        value: BRDF (1/sr), shape (C, H, D, P); anything where the weight is 0.
        weight: shape (C, H, D, P), 0 where there is no datum.
    """
    half = len(grid.phi_d) // 2
    value = np.where(weight > 0, value, 0.0)
    w1, w2 = weight[..., :half], weight[..., : half - 1 : -1]
    m1, m2 = value[..., :half], value[..., : half - 1 : -1]
    total = w1 + w2
    safe = np.where(total > 0, total, 1.0)
    scatter = float(np.sum(w1 * w2 / safe * (m1 - m2) ** 2))
    return Samples(
        grid.theta_h, grid.theta_d, grid.phi_d[:half], grid.cos_i[..., :half], grid.cos_o[..., :half],
        (w1 * m1 + w2 * m2) / safe, total, scatter,
    )  # fmt: skip


def folded(measured: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Values (3, H, D, P/2), bins at phi_d and pi - phi_d taken together, equal but for noise; and which are data."""
    half = measured.valid.shape[-1] // 2
    valid = measured.valid[..., :half], measured.valid[..., : half - 1 : -1]
    values = measured.values[..., :half], measured.values[..., : half - 1 : -1]
    total = np.where(valid[0], values[0], 0.0) + np.where(valid[1], values[1], 0.0)
    return total / np.maximum(valid[0].astype(int) + valid[1], 1), valid[0] | valid[1]


Runs = int | tuple[int, ...]


def runs_for(samples: Samples, runs: tuple[Runs, Runs, Runs]) -> tuple[Runs, Runs, Runs]:
    """Runs for MERL's 90 x 90 x 90 folded bins, where there are others: runs of single rows stay, others scale."""
    h, d, p = (_scaled(r, n) for r, n in zip(runs, samples.cos_i.shape, strict=True))
    return h, d, p


def _scaled(runs: Runs, count: int) -> Runs:
    folded = DIMS[0]
    if count == folded:
        return runs
    lengths = (runs,) * (folded // runs) if isinstance(runs, int) else runs
    if isinstance(runs, int) and runs == 1:
        return 1
    single = min(next((k for k, length in enumerate(lengths) if length > 1), len(lengths)), count)
    edges = np.round(np.cumsum(lengths) * (count / folded)).astype(int)
    kept = np.unique(np.concatenate([np.arange(single + 1), edges[edges > single], [count]]))
    return tuple(np.diff(kept).tolist())


def thin(samples: Samples, runs: tuple[Runs, Runs, Runs]) -> Samples:
    """One row for each run of neighbouring rows along every axis: its middle one, standing for as many as it replaces.

    Values are not averaged; weights are multiplied by the lengths of the runs.

    Args:
        runs: along theta_h, theta_d, phi_d: the length of all runs, or the lengths one by one. They must fill the axis,
            so that shapes do not depend on the file.

    Raises:
        ValueError: the runs do not fill an axis.
    """
    shape = samples.cos_i.shape
    lengths = [(r,) * (n // r) if isinstance(r, int) else r for n, r in zip(shape, runs, strict=True)]
    if any(sum(each) != n for n, each in zip(shape, lengths, strict=True)):
        raise ValueError(f"runs {runs} must fill the grid {shape}")
    h, d, p = (np.cumsum(each) - np.asarray(each) + np.asarray(each) // 2 for each in lengths)
    rows, multiplicity = np.ix_(h, d, p), reduce(np.multiply, np.ix_(*lengths))
    return replace(
        samples, theta_h=samples.theta_h[h], theta_d=samples.theta_d[d], phi_d=samples.phi_d[p],
        cos_i=samples.cos_i[rows], cos_o=samples.cos_o[rows],
        value=samples.value[:, *rows], weight=samples.weight[:, *rows] * multiplicity,
    )  # fmt: skip
