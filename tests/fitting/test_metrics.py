"""What residuals are worth: effective counts against the scatter they stand for, and the criterion built on them."""

import numpy as np
import pytest
from merlfit.fitting.metrics import correlation_length, effective_count, errors
from merlfit.fitting.selection import bic
from merlfit.merl_io.grid import merl_grid

SHAPE = (60, 12, 9)


def autoregressive(rng, coefficient, shape=SHAPE):
    """Unit-variance residuals with correlation coefficient^lag along the first axis."""
    field = rng.normal(size=shape)
    for k in range(1, shape[0]):
        field[k] = coefficient * field[k - 1] + np.sqrt(1 - coefficient**2) * field[k]
    return field


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.8])
def test_effective_count_is_that_of_the_chi_square_of_the_sum_of_squares(coefficient):
    """A sum of squares of N independent residuals scatters by sqrt(2/N) of itself: N read off 1500 draws."""
    rng = np.random.default_rng(0)
    used = np.ones(SHAPE, bool)
    sums = np.array([np.sum(autoregressive(rng, coefficient) ** 2) for _ in range(1500)])
    seen = 2 * (sums.mean() / sums.std()) ** 2
    estimated = np.mean([effective_count(autoregressive(rng, coefficient), used) for _ in range(10)])
    assert estimated == pytest.approx(seen, rel=0.15)
    if coefficient:
        assert np.prod(SHAPE) > 1.4 * estimated  # to count bins would be wrong


def test_correlation_length_is_bartletts_and_only_along_the_axis():
    field, used = autoregressive(np.random.default_rng(1), 0.7, (200, 20, 20)), np.ones((200, 20, 20), bool)
    assert correlation_length(field, used, 0) == pytest.approx((1 + 0.49) / (1 - 0.49), rel=0.05)
    assert correlation_length(field, used, 1) == pytest.approx(1, abs=0.02)
    assert correlation_length(np.ones((30, 2, 2)), np.ones((30, 2, 2), bool), 0) == pytest.approx(30, rel=0.1)


def test_masked_bins_do_not_count():
    rng = np.random.default_rng(2)
    field, used = autoregressive(rng, 0.5), rng.uniform(size=SHAPE) < 0.5
    spoiled = np.where(used, field, 1e6)
    assert effective_count(spoiled, used) == effective_count(field, used)
    everywhere = effective_count(field, np.ones(SHAPE, bool))
    assert effective_count(field, used) == pytest.approx(used.mean() * everywhere, rel=0.15)


def test_a_few_bins_that_carry_the_cost_are_what_counts():
    rng = np.random.default_rng(3)
    field = rng.normal(size=SHAPE)
    field[:, 0] *= 100  # one column of twelve
    assert effective_count(field, np.ones(SHAPE, bool)) == pytest.approx(60 * 9, rel=0.2)


def test_bic_is_schwarz_with_the_scale_profiled_out():
    counts = np.array([100.0, 50.0, 10.0])
    base = bic(np.array([0.1, 0.2, 0.3]), counts, 8)
    assert bic(np.array([0.1, 0.2, 0.3]), counts, 9) - base == pytest.approx(np.log(160.0))
    assert base - bic(np.array([0.05, 0.2, 0.3]), counts, 8) == pytest.approx(100 * np.log(2))
    assert bic(np.array([0.099, 0.2, 0.3]), counts, 9) > base  # 1 % in one channel is not worth a parameter


def test_errors_are_those_of_the_definitions():
    rng = np.random.default_rng(4)
    grid = merl_grid()
    shape = (2, *grid.cos_i.shape)
    measured, predicted = rng.uniform(0.1, 1, shape), rng.uniform(0.1, 1, shape)
    predicted[..., :90] += 1  # light and viewer do not weigh alike
    valid = rng.uniform(size=grid.cos_i.shape) < 0.5
    found = errors(np.where(valid, measured, np.nan), predicted, valid, grid)
    squares = weights = shares = bins = 0.0
    widths = np.gradient(grid.theta_h)
    for h, d in np.ndindex(90, 90):
        for i in np.flatnonzero(valid[h, d]):
            light, viewer = np.arccos(np.clip([grid.cos_i[h, d, i], grid.cos_o[h, d, i]], -1, 1))
            if max(light, viewer) < 1.4:
                w = np.cos(grid.theta_d[d]) * np.sin(grid.theta_d[d]) * np.sin(grid.theta_h[h]) * widths[h]
                w *= np.cos(light) ** 2 / max(np.sin(light), 0.02)
                m, p = measured[:, h, d, i], predicted[:, h, d, i]
                squares, weights = squares + w * np.sum((m - p) ** 2), weights + 2 * w
                shares, bins = shares + np.sum(np.abs(m - p) / (m + p)), bins + 2
    assert found.rmse == pytest.approx(np.sqrt(squares / weights), rel=1e-9)
    assert found.smape == pytest.approx(shares / bins, rel=1e-9)
    swapped = errors(measured[..., ::-1], predicted[..., ::-1], valid[..., ::-1], grid)
    assert swapped.rmse != pytest.approx(found.rmse, rel=0.05)
    assert np.isnan(errors(measured, measured, np.zeros_like(valid), grid).rmse)
