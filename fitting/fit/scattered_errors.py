"""How far a prediction is from scattered samples, and how many independent samples the difference is worth.

Every mean is over samples, each with the share of the measure that it stands for. Negative values count as they are in
RMSE and sMAPE; to the eye (cube roots and logarithms) they are black. Spheres are rendered from what lies between the
samples (`scene.gridded`), where these cover enough of what a sphere shows.
"""

import numpy as np

from ...merl_io.grid import merl_grid
from ...merl_io.scattered import ScatteredSamples
from ...scene.colour import coloured
from ...scene.gridded import GRID, drawn, gridded
from ...scene.spheres import distances, shown
from ..support.choices import THETA_MAX
from .error_metrics import HIGHLIGHT_THETA_D, Errors, correlation_length
from .weights import within

LEAST_SHOWN = 0.7  # of what a sphere shows, the share that samples have to cover; the rest is black in both pictures
LEAST_CELLS = 8  # of samples, to speak of how their means scatter


def errors(samples: ScatteredSamples, predicted: np.ndarray) -> Errors:
    """All errors of a prediction (C, S) of samples that were fitted.

    RMSE is weighted with cos_i, as HP17 Table 2 has it beside the measure of Eq. 56; the highlight is that of the
    brightest sample at theta_d < 60 degrees, channels summed.
    """
    used, m = samples.weight > 0, samples.value
    share = np.where(used, samples.share, 0.0)
    seen, drawn = (np.maximum(x, 0.0) * samples.cos_i for x in (m, predicted))
    total = np.abs(m) + np.abs(predicted)
    picture, lamp, environment = pictures(samples, predicted)
    return Errors(
        rmse=np.sqrt(_mean((m - predicted) ** 2, share * samples.cos_i)),
        smape=_mean(np.abs(m - predicted) / np.where(total > 0, total, 1.0), used.astype(float)),
        cube_root=np.sqrt(_mean((np.cbrt(seen) - np.cbrt(drawn)) ** 2, share)),
        log=np.sqrt(_mean((np.log1p(seen) - np.log1p(drawn)) ** 2, share)),
        highlight=highlight(samples, predicted),
        picture=picture,
        lamp=lamp,
        environment=environment,
    )


def pictures(samples: ScatteredSamples, predicted: np.ndarray) -> tuple[float, float, float]:
    """CIELAB distances of spheres as in `error_metrics.Errors`, of samples and of predictions in the same directions.

    Both are interpolated between the samples alike, so that a fit that is right differs by nothing. They are no numbers
    where the samples cover less than `LEAST_SHOWN` of what a sphere shows.
    """
    both = np.concatenate([coloured(x, samples.bands) for x in (samples.value, predicted)])
    whole = np.all(samples.weight > 0, axis=0)
    if samples.between is not None:
        values, covered = drawn(samples.between, np.where(whole, both, np.nan))
    else:
        theta_h, theta_d, phi_d = (x[whole] for x in (samples.theta_h, samples.theta_d, samples.phi_d))
        values, covered = gridded(theta_h, theta_d, phi_d, both[:, whole])
    if shown_by(covered) < LEAST_SHOWN:
        return float("nan"), float("nan"), float("nan")
    file, fit = np.split(np.nan_to_num(values), 2)
    return distances(file, fit, covered)


def shown_by(covered: np.ndarray, theta_max: float = THETA_MAX) -> float:
    """The share of what a sphere shows below ``theta_max`` that some of the bins of `GRID` are, (H, D, P/2)."""
    return shown(covered, within(merl_grid(GRID), theta_max)[..., : covered.shape[-1]])


def cube_root_error(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    """That of `errors` alone."""
    share = np.where(samples.weight > 0, samples.share, 0.0)
    seen, drawn = (np.cbrt(np.maximum(x, 0.0) * samples.cos_i) for x in (samples.value, predicted))
    return float(np.sqrt(_mean((seen - drawn) ** 2, share)))


def _mean(x: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sum(weight * x) / max(np.sum(weight), 1e-300))


def highlight(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    """That of `errors` alone."""
    whole = np.all(samples.weight > 0, axis=0) & (samples.theta_d < HIGHLIGHT_THETA_D)
    if not whole.any():
        return float("nan")
    m, p = (np.where(whole, np.sum(x, 0), 0.0).max() for x in (samples.value, predicted))
    return float(p / m) if m > 0 else float("nan")


def effective_count(samples: ScatteredSamples, predicted: np.ndarray) -> float:
    """As `error_metrics.effective_count`: participation over the correlation length among neighbours and over channels.

    Along no grid, that of neighbours is found by blocking (Flyvbjerg & Petersen 1989): the mean over a box of n samples
    scatters as that of n / length independent ones; of boxes of all sizes (`merl_io.scattered.order`) the largest.

    With N of them a residual of weight 1 has the variance S/N. No N leaves it less than what the file states, or what
    repeated directions show: a fit of few samples may lie nearer to them than they are to the truth.
    """
    used = samples.weight > 0
    field = np.where(used, np.sqrt(samples.weight) * (samples.value - predicted), 0.0)
    largest = np.max(np.abs(field), initial=0.0)
    if largest == 0:
        return float(used.sum())
    noise, cost = max(samples.model_error or 0.0, np.sqrt(samples.repeatability)), float(np.sum(field**2))
    field = field / largest
    e2 = field[used] ** 2
    participation = min(3 * e2.sum() ** 2 / np.sum(e2**2), e2.size)
    lengths = blocking_length(field) * correlation_length(field, used, 0)
    known = cost / noise**2 if noise > 0 else np.inf
    return float(max(min(participation / lengths, known), 1.0))


def blocking_length(field: np.ndarray) -> float:
    """How many neighbours of (C, S) err alike; 1 where they are independent."""
    length, size, variance = 1.0, 2, float(np.mean(field**2))
    while field.shape[1] // size >= LEAST_CELLS:
        whole = field[:, : field.shape[1] // size * size].reshape(len(field), -1, size)
        length = max(length, size * float(np.mean(whole.mean(-1) ** 2)) / variance)
        size *= 2
    return length
