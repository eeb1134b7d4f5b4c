"""How far a prediction is from a measurement, and how many independent bins the difference is worth."""

from dataclasses import dataclass

import numpy as np

from ..merl_io.grid import MerlGrid
from .threads import side_by_side

THETA_MAX_RAD = 1.4  # HP15 Eq. 31 and HP17 Table 2 leave out directions closer to the horizon
LEAST_PAIRS = 10  # of bins, to speak of a correlation between them
SIN_FLOOR = 0.02  # of theta_i in the RMSE weight, as the reference evaluation of the published parameters has it


@dataclass(frozen=True)
class Errors:
    """RMSE (1/sr, cos^2-weighted, HP17 Table 2) and sMAPE (dimensionless, 0 to 1) of a prediction."""

    rmse: float
    smape: float


def errors(measured: np.ndarray, predicted: np.ndarray, valid: np.ndarray, grid: MerlGrid) -> Errors:
    """RMSE and sMAPE over all valid bins with both directions at theta < 1.4.

    RMSE = sqrt(sum w d^2 / C), w proportional to cos_d sin_d sin_h dtheta_h cos_i^2 / sin_i and summing to one: HP17
    Table 2 integrated over incidence. sMAPE = mean of |m - p| / (m + p) over bins and channels, unweighted.

    Args:
        measured, predicted: (C, H, D, P), 1/sr; measured is anything where not valid. valid: (H, D, P).
        grid: angles of these bins, phi_d over the whole of [0, pi): light and viewer do not weigh alike.
    """
    inside = valid & (np.minimum(grid.cos_i, grid.cos_o) > np.cos(THETA_MAX_RAD))
    if not inside.any():
        return Errors(float("nan"), float("nan"))
    measure = (np.sin(grid.theta_h) * np.gradient(grid.theta_h))[:, None, None] * np.sin(2 * grid.theta_d)[:, None]
    sin_i = np.sqrt(np.clip(1 - grid.cos_i**2, 0, 1))
    weight = np.where(inside, measure * grid.cos_i**2 / np.maximum(sin_i, SIN_FLOOR), 0.0)[inside]
    squares = share = 0.0
    for m, p in zip(measured, predicted, strict=True):
        difference, total = np.abs(m[inside] - p[inside]), np.abs(m[inside]) + np.abs(p[inside])
        squares += np.sum(weight * difference**2) / weight.sum()
        share += np.mean(difference / np.where(total > 0, total, 1.0))
    return Errors(float(np.sqrt(squares / len(measured))), float(share / len(measured)))


def correlation_length(field: np.ndarray, used: np.ndarray, axis: int) -> float:
    """Integrated correlation length of a zero-mean field along one axis, in bins: 1 + 2 sum of correlations.

    It says how many bins are worth one for a quantity that hardly changes over that length: the mean of n of them
    scatters as that of n / length independent ones. The sum ends before the first lag whose correlation is not positive
    (Geyer's initial positive sequence): beyond it there is but noise. 1 for independent bins, n for a constant field.
    Slices without any datum are passed over.
    """
    field, used = (np.moveaxis(x, axis, 0) for x in (field, used))
    kept = used.reshape(len(used), -1).any(1)
    rows, counted = np.where(used, field, 0.0)[kept].reshape(kept.sum(), -1), used[kept].reshape(kept.sum(), -1)
    counted = counted.astype(np.float32)  # exact sums up to 2^24 pairs of rows
    products, pairs = rows @ rows.T, counted @ counted.T  # every pair of rows; those at one lag are a diagonal
    variance = np.trace(products) / np.trace(pairs, dtype=float)
    length = 1.0
    for lag in range(1, len(rows)):
        count = np.trace(pairs, lag, dtype=float)
        covariance = np.trace(products, lag) / count if count >= LEAST_PAIRS else 0.0
        if covariance <= 0:
            break
        length += 2 * (1 - lag / len(rows)) * min(covariance / variance, 1.0)
    return float(length)


def effective_count(field: np.ndarray, used: np.ndarray) -> float:
    """N: how many independent equal residuals those of all channels are worth.

    Two things make them fewer than the bins: a few may carry most of the cost (participation, 3 (sum e^2)^2 / sum e^4,
    which is their number for equal Gaussian ones), and they err alike (the product of correlation lengths along the
    three angles and over the channels).

    Args:
        field: weighted residuals sqrt(w) (m - p), (C, H, D, P). used: which of them count, the same shape.
    """
    largest = np.max(np.abs(field[used]), initial=0.0)
    if largest == 0:
        return float(used.sum())
    field = field / largest  # its square may be no number otherwise
    e2 = field[used] ** 2
    participation = min(3 * e2.sum() ** 2 / np.sum(e2**2), e2.size)
    lengths = side_by_side(lambda axis: correlation_length(field, used, axis), range(field.ndim))
    return float(max(participation / np.prod(lengths), 1.0))
