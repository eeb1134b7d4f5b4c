"""The weights of HP17 Eq. 56, and what may be put in the place of its compressive weight.

A bin weighs its share of the fitting measure times a weight of its measured value m. With x = m / median and
f(x) = (1 - 2^-x) / ln 2, HP17 Eq. 57-58 take w = (f(x)/x)^1.4. The exponent decides who is served: with 0 (``none``) a
glossy highlight is nearly all that counts, with 1.4 (``compressive``) the dark bins nearly are. ``log`` has the weight
of the error of log(1 + m cos_i), (cos_i / (1 + m cos_i))^2, to first order in the residual (Loew et al. 2012).

Directions beyond ``theta_max`` have no weight: past 80 degrees the apparatus fails, every published metric leaves those
bins out, and they would carry most of the cost.

Least squares with weights w is the likelihood of residuals of variance tau^2 / w: so HP17's weight states how a model's
error grows with the value. Where a file states standard uncertainties s, noise of variance s^2 is added to that, and
the weight that belongs to the sum is

    1 / (1/w + s^2 / tau^2),

w where the model errs by much more than the noise, and the inverse variance of the noise where it errs by much less.
tau is found with the fit (`model_error`), as two laboratories' hidden difference is (Paule & Mandel 1982).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import overload

import numpy as np
from scipy.optimize import root_scalar

from ...merl_io.binary import Measurement
from ...merl_io.grid import MerlGrid, merl_grid
from ...merl_io.inputs import Input
from ...merl_io.samples import Samples, fold
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples, scattered
from ..support.choices import EXPONENT, THETA_MAX, Exponent
from ..support.threads import side_by_side

FIRST_SHARE = 0.01  # of the weighted energy: what a model is taken to leave before any fit has shown it
LEAST_ERROR = 0.1  # of a model, in typical uncertainties: less than that changes no weight by more than a hundredth
TOLD, HALF_NORMAL = 5.0, 0.6745  # standard deviations of noise; the median of what is below zero, in one of them


def compressive_weight(value: np.ndarray, median: np.ndarray, exponent: float = EXPONENT) -> np.ndarray:
    """w_C of HP17 Eq. 57-58, dimensionless in (0, 1]: 1 for dark bins, of bright ones a power.

    Args:
        value: measured BRDF >= 0. median: the cos-weighted median to compare with (broadcasts). exponent: of the power
            with which it falls.
    """
    x = np.maximum(value / median, 1e-12)
    return (-np.expm1(-np.log(2.0) * x) / (np.log(2.0) * x)) ** exponent


def noise_floor(value: np.ndarray) -> float:
    """Values below it are not told from zero, as negative ones show: they weigh alike.

    A weight that falls with the noise of its own value counts what is by chance too dark for more than what is by
    chance too bright, and so makes the fit too dark. Of values spread evenly from zero on, noise of a deviation s takes
    s / sqrt(2 pi) times their density below zero, and `TOLD` s times it lie within the floor: `TOLD` sqrt(2 pi) for
    each negative one. No more are taken to be within it, so that a few negative ones say nothing of the others.
    """
    negative = value[value < 0]
    if not negative.size:
        return 0.0
    within_it = min(TOLD * np.sqrt(2 * np.pi) * negative.size / value.size, 1.0)
    return min(TOLD * float(np.median(-negative)) / HALF_NORMAL, float(np.quantile(np.abs(value), within_it)))


def cos_weighted_median(value: np.ndarray, cos_i: np.ndarray) -> float:
    """Median of a channel's values with weights cos_i (HP17 after Eq. 58)."""
    order = np.argsort(value)
    cumulated = np.cumsum(cos_i[order])
    return float(value[order][np.searchsorted(cumulated, cumulated[-1] / 2)])


def within(grid: MerlGrid, theta_max: float) -> np.ndarray:
    """Bins with both directions above the horizon and not beyond ``theta_max``, (H, D, P)."""
    return grid.above & (np.minimum(grid.cos_i, grid.cos_o) > np.cos(theta_max))


@overload
def weighted_samples(
    measurement: Measurement,
    exponent: Exponent = EXPONENT,
    theta_max: float = THETA_MAX,
    model_error: float | None = None,
) -> Samples: ...


@overload
def weighted_samples(
    measurement: Input, exponent: Exponent = EXPONENT, theta_max: float = THETA_MAX, model_error: float | None = None
) -> Samples | ScatteredSamples: ...


def weighted_samples(
    measurement: Input, exponent: Exponent = EXPONENT, theta_max: float = THETA_MAX, model_error: float | None = None
) -> Samples | ScatteredSamples:
    """Folded samples of a file, or those of scattered directions, with their weights.

    Each channel is compared with its own median, so that no channel is fitted at the expense of another.

    Args:
        exponent: exponent of the compressive weight, or ``log``. theta_max: of light and viewer (rad).
        model_error: tau (1/sr), where the file states uncertainties; None before any fit.
    """
    if isinstance(measurement, ScatteredMeasurement):
        return _scattered_samples(measurement, exponent, theta_max, model_error)
    grid = merl_grid(measurement.dims)
    used = measurement.valid & within(grid, theta_max) & (grid.weight > 0)
    bin_weight, cos_i = grid.weight[used], np.maximum(grid.cos_i[used], 0.0)
    weigh = _logarithmic if exponent == "log" else _compressive(float(exponent))

    def channel(plane: np.ndarray) -> Samples:
        weight = np.zeros((1, *plane.shape))
        if used.any():
            weight[0, used] = bin_weight * weigh(plane[used], cos_i)
        return fold(grid, plane[None], weight)

    planes = side_by_side(channel, measurement.values)
    value, weight = (np.concatenate([getattr(each, name) for each in planes]) for name in ("value", "weight"))
    scatter = sum(each.scatter for each in planes)
    return replace(planes[0], value=value, weight=weight, scatter=scatter, bands=measurement.bands)


def _scattered_samples(
    measurement: ScatteredMeasurement, exponent: Exponent, theta_max: float, model_error: float | None
) -> ScatteredSamples:
    """A sample weighs its share times the weight of its value, less what its uncertainty takes from that."""
    low = np.maximum(measurement.theta_i, measurement.theta_o) > theta_max
    used = measurement.valid & ~low & (measurement.share > 0)
    weigh = _logarithmic if exponent == "log" else _compressive(float(exponent))
    weight = np.zeros(used.shape)
    for plane, counted, found in zip(measurement.values, used, weight, strict=True):
        if counted.any():
            found[counted] = measurement.share[counted] * weigh(plane[counted], np.cos(measurement.theta_i[counted]))
    if measurement.uncertainty is None or not np.any(used & np.isfinite(measurement.uncertainty)):
        return scattered(measurement, measurement.values, weight, used)
    weight /= np.mean(measurement.share[used.any(0)])
    if model_error is None:
        model_error = float(np.sqrt(FIRST_SHARE * np.mean(weight[used] * measurement.values[used] ** 2)))
    uncertainty = completed(measurement.uncertainty, measurement.values, used)
    weight[used] /= 1 + weight[used] * (uncertainty[used] / model_error) ** 2
    return scattered(measurement, measurement.values, weight, used, uncertainty, model_error)


def completed(uncertainty: np.ndarray, values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Uncertainties (C, N) of all values that are used, also where the file states none (NaN).

    There stands the larger one of the channel's median and of its median share of the value: of all channels, where one
    has none.
    """
    found = uncertainty.copy()
    stated = used & np.isfinite(uncertainty)
    for channel, own in enumerate(stated):
        those = stated if not own.any() else stated & (np.arange(len(stated)) == channel)[:, None]
        share = np.median(uncertainty[those] / np.maximum(np.abs(values[those]), 1e-300))
        usual = np.maximum(np.median(uncertainty[those]), share * np.abs(values[channel]))
        found[channel] = np.where(own, uncertainty[channel], usual)
    return found


def found_error(samples: ScatteredSamples, predicted: np.ndarray, free: int) -> float:
    """What a model errs by (1/sr) at the weight 1, after a fit: with it and the noise chi^2 is its expectation.

    Args:
        samples: with uncertainties. predicted: of them, (C, S). free: numbers that were fitted.
    """
    assert samples.uncertainty is not None
    assert samples.model_error is not None
    used = samples.weight > 0
    noise, squares = samples.uncertainty[used] ** 2, (samples.value - predicted)[used] ** 2
    of_both = 1 / samples.weight[used]
    of_model = np.maximum(of_both - noise / samples.model_error**2, 1e-12 * of_both)  # the first w's inverse, rounded
    expected = max(len(squares) - free, 1)
    least = LEAST_ERROR * float(np.sqrt(np.median(noise / of_model)))
    most = float(np.sqrt(np.sum(squares / of_model) / expected))

    def excess(log: float) -> float:
        return float(np.sum(squares / (np.exp(2 * log) * of_model + noise))) / expected - 1

    if most <= least or excess(np.log(least)) <= 0:
        return least
    return float(np.exp(root_scalar(excess, bracket=(np.log(least), np.log(most)), xtol=1e-4).root))


Weigh = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _compressive(exponent: float) -> Weigh:
    def weigh(value: np.ndarray, cos_i: np.ndarray) -> np.ndarray:
        floor = noise_floor(value)
        scale = max(cos_weighted_median(value, cos_i), floor, 1e-9)  # where most values are negative, the median is
        return compressive_weight(np.maximum(value, floor), np.asarray(scale), exponent)

    return weigh


def _logarithmic(value: np.ndarray, cos_i: np.ndarray) -> np.ndarray:
    return (cos_i / (1 + np.maximum(value, 0.0) * cos_i)) ** 2
