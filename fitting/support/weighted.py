"""Weighted draws: their quantiles, and as many that are equally likely."""

import numpy as np


def quantiles(values: np.ndarray, weights: np.ndarray, levels: tuple[float, ...] = (0.05, 0.5, 0.95)) -> np.ndarray:
    """Weighted quantiles of values (n, ...) along the first axis, (levels, ...)."""
    flat = values.reshape(len(values), -1)
    found = [np.quantile(x, levels, weights=weights, method="inverted_cdf") for x in flat.T]
    return np.array(found).T.reshape(len(levels), *values.shape[1:])


def resampled(weights: np.ndarray, count: int) -> np.ndarray:
    """Indices of equally likely draws, so many of them, by systematic resampling."""
    places = (np.arange(count) + 0.5) / count
    return np.searchsorted(np.cumsum(weights) / weights.sum(), places).clip(max=len(weights) - 1)
