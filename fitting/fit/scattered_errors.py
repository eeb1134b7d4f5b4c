"""How far a prediction is from scattered samples, and how many independent samples the difference is worth.

Every mean is over samples, each with the share of the measure that it stands for. There is no grid to render a sphere
from: the error of pictures is not a number. Negative values count as they are in RMSE and sMAPE; to the eye (cube roots
and logarithms) they are black.
"""

import numpy as np

from ...merl_io.scattered import ScatteredSamples
from .error_metrics import HIGHLIGHT_THETA_D, Errors, correlation_length

LEAST_CELLS = 8  # of samples, to speak of how their means scatter


def errors(samples: ScatteredSamples, predicted: np.ndarray) -> Errors:
    """All errors of a prediction (C, S) but that of pictures; samples that were fitted.

    RMSE is weighted with cos_i, as HP17 Table 2 has it beside the measure of Eq. 56; the highlight is that of the
    brightest sample at theta_d < 60 degrees, channels summed.
    """
    used, m = samples.weight > 0, samples.value
    share = np.where(used, samples.share, 0.0)
    seen, drawn = (np.maximum(x, 0.0) * samples.cos_i for x in (m, predicted))
    total = np.abs(m) + np.abs(predicted)
    return Errors(
        rmse=np.sqrt(_mean((m - predicted) ** 2, share * samples.cos_i)),
        smape=_mean(np.abs(m - predicted) / np.where(total > 0, total, 1.0), used.astype(float)),
        cube_root=np.sqrt(_mean((np.cbrt(seen) - np.cbrt(drawn)) ** 2, share)),
        log=np.sqrt(_mean((np.log1p(seen) - np.log1p(drawn)) ** 2, share)),
        highlight=_highlight(samples, predicted),
        picture=float("nan"),
    )


def cube_root_error(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    """That of `errors` alone."""
    share = np.where(samples.weight > 0, samples.share, 0.0)
    seen, drawn = (np.cbrt(np.maximum(x, 0.0) * samples.cos_i) for x in (samples.value, predicted))
    return float(np.sqrt(_mean((seen - drawn) ** 2, share)))


def _mean(x: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sum(weight * x) / max(np.sum(weight), 1e-300))


def _highlight(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    whole = np.all(samples.weight > 0, axis=0) & (samples.theta_d < HIGHLIGHT_THETA_D)
    if not whole.any():
        return float("nan")
    m, p = (np.where(whole, np.sum(x, 0), 0.0).max() for x in (samples.value, predicted))
    return float(p / m) if m > 0 else float("nan")


def effective_count(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    """As `error_metrics.effective_count`: participation over the correlation length among neighbours and over channels.

    Along no grid, that of neighbours is found by blocking (Flyvbjerg & Petersen 1989): the mean over a box of n samples
    scatters as that of n / length independent ones; of boxes of all sizes (`merl_io.scattered.order`) the largest.
    """
    used = samples.weight > 0
    field = np.where(used, np.sqrt(samples.weight) * (samples.value - predicted), 0.0)
    largest = np.max(np.abs(field), initial=0.0)
    if largest == 0:
        return float(used.sum())
    field = field / largest
    e2 = field[used] ** 2
    participation = min(3 * e2.sum() ** 2 / np.sum(e2**2), e2.size)
    lengths = blocking_length(field) * correlation_length(field, used, 0)
    return float(max(participation / lengths, 1.0))


def blocking_length(field: np.ndarray) -> float:
    """How many neighbours of (C, S) err alike; 1 where they are independent."""
    length, size, variance = 1.0, 2, float(np.mean(field**2))
    while field.shape[1] // size >= LEAST_CELLS:
        whole = field[:, : field.shape[1] // size * size].reshape(len(field), -1, size)
        length = max(length, size * float(np.mean(whole.mean(-1) ** 2)) / variance)
        size *= 2
    return length
