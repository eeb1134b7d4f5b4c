"""The weights of HP17 Eq. 56, with a floor under what the highlight counts for.

A bin weighs its share of the fitting measure times the compressive weight w_C of its measured value. Under w_C a narrow
highlight is all but invisible: the bins that are at least half as bright as its peak carry 0.1 to 0.5 % of a glossy
plastic's weighted energy, and the global minimum of Eq. 56 as printed gives the highlight up for a better fit of the
rest (white-marble: an RMSE of 0.22 where 0.05 can be had). So their weights are raised until they carry a fifth at the
least (docs/fitting.md has the comparison); 0 is Eq. 56 as printed.
"""

from dataclasses import replace

import numpy as np

from ..merl_io.binary import Measurement
from ..merl_io.grid import merl_grid
from ..merl_io.samples import Samples, fold
from .threads import side_by_side

BEND = 1.4  # exponent of the compressive weight, HP17 after Eq. 58
HIGHLIGHT = 0.2  # of a channel's weighted energy, at the least, in bins within the half width of the lobe
DARK_QUANTILE = 0.1  # of the bins away from the lobe: taken for the body


def compressive_weight(value: np.ndarray, median: np.ndarray) -> np.ndarray:
    """w_C of HP17 Eq. 57-58, dimensionless in (0, 1]: 1 for dark bins, falling as the power 1.4 of bright ones.

    Args:
        value: measured BRDF >= 0. median: the cos-weighted median to compare with (broadcasts).
    """
    x = np.maximum(value / median, 1e-12)
    return (-np.expm1(-np.log(2.0) * x) / (np.log(2.0) * x)) ** BEND


def cos_weighted_median(value: np.ndarray, cos_i: np.ndarray) -> float:
    """Median of a channel's values with weights cos_i (HP17 after Eq. 58)."""
    order = np.argsort(value)
    cumulated = np.cumsum(cos_i[order])
    return float(value[order][np.searchsorted(cumulated, cumulated[-1] / 2)])


def half_width(theta_h: np.ndarray, theta_d: np.ndarray, value: np.ndarray, used: np.ndarray) -> float:
    """tan(theta_h) where the lobe at small theta_d, averaged over azimuth and channels, has fallen to half.

    Args:
        value: (C, H, D, P), 1/sr. used: which of them count, the same shape.
    """
    columns = slice(0, max(1, len(theta_d) // 6))
    counted = used[:, :, columns]
    lobe = np.where(counted, value[:, :, columns], 0.0).sum((2, 3)) / np.maximum(counted.sum((2, 3)), 1)
    away = used[0] & (theta_h > 0.6)[:, None, None] & (theta_d < 0.9)[None, :, None]
    away = away if away.any() else used[0]
    dark = np.array([np.quantile(plane[away], DARK_QUANTILE) if away.any() else 0.0 for plane in value])
    brightness = np.maximum(lobe - dark[:, None], 0.0).mean(0)
    below = np.flatnonzero(brightness < brightness[:2].max() / 2)
    tangent = np.tan(np.minimum(theta_h, 1.5))
    return float(np.clip(tangent[below[0]] if len(below) and below[0] > 0 else tangent[0], 2e-3, 2.0))


def weighted_samples(measurement: Measurement, highlight: float = HIGHLIGHT) -> Samples:
    """Folded samples of a file with their weights.

    Bins that the horizon cuts with their centre below it are left out: the model is 0 there. Each channel is compared
    with its own median, so that no channel is fitted at the expense of another.

    Args:
        highlight: share of a channel's weighted energy that bins within the half width of the lobe carry at the least.
    """
    grid = merl_grid()
    used = measurement.valid & grid.above & (grid.weight > 0)
    bin_weight, cos_i = grid.weight[used], np.maximum(grid.cos_i[used], 0.0)
    values = measurement.values
    width = half_width(grid.theta_h, grid.theta_d, values, np.broadcast_to(used, values.shape))
    bright = np.tan(grid.theta_h) <= width
    bright[0] = True

    def channel(plane: np.ndarray) -> Samples:
        weight = np.zeros((1, *plane.shape))
        if used.any():
            median = max(cos_weighted_median(plane[used], cos_i), 1e-9)
            weight[0, used] = bin_weight * compressive_weight(plane[used], np.asarray(median))
            rows = np.sum(weight[0] * np.where(used, plane, 0.0) ** 2, (1, 2))
            weight[0, bright] *= _raised(float(rows[bright].sum()), float(rows[~bright].sum()), highlight)
        return fold(grid, plane[None], weight)

    red, green, blue = side_by_side(channel, values)
    value, weight = (
        np.concatenate([getattr(each, name) for each in (red, green, blue)]) for name in ("value", "weight")
    )
    return replace(red, value=value, weight=weight, scatter=red.scatter + green.scatter + blue.scatter)


def _raised(bright: float, rest: float, least: float) -> float:
    """What the energy of bright bins is multiplied by, one at the least, to be this share of all."""
    return max(1.0, least / (1 - least) * rest / bright) if bright > 0 else 1.0
