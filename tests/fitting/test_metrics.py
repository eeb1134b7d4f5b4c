"""What residuals are worth: effective counts against the scatter they stand for, and the criterion built on them."""

from dataclasses import astuple

import numpy as np
import pytest
from merlfit.fitting.fit.error_metrics import Errors, correlation_length, effective_count, errors
from merlfit.fitting.fit.weights import within
from merlfit.merl_io.grid import merl_grid
from merlfit.scene.spheres import distances

SHAPE = (3, 60, 12, 9)  # channels, theta_h, theta_d, phi_d
EVERYWHERE = np.ones(SHAPE, bool)


def autoregressive(rng, coefficient, axis=1, shape=SHAPE):
    """Unit-variance residuals with correlation coefficient^lag along an axis."""
    field = np.moveaxis(rng.normal(size=shape), axis, 0)
    for k in range(1, len(field)):
        field[k] = coefficient * field[k - 1] + np.sqrt(1 - coefficient**2) * field[k]
    return np.moveaxis(field, 0, axis)


def test_correlation_length_is_the_integrated_one_and_only_along_the_axis():
    field, used = autoregressive(np.random.default_rng(1), 0.7, 0, (200, 40, 40)), np.ones((200, 40, 40), bool)
    assert correlation_length(field, used, 0) == pytest.approx((1 + 0.7) / (1 - 0.7), rel=0.05)
    assert correlation_length(field, used, 1) == pytest.approx(1, abs=0.05)
    assert correlation_length(np.ones((30, 5, 5)), np.ones((30, 5, 5), bool), 0) == pytest.approx(30, rel=0.01)
    there_and_back = np.where(np.arange(30) % 2, 1.0, -1.0)[:, None] * np.ones(5)
    assert correlation_length(there_and_back, np.ones((30, 5), bool), 0) == 1  # and not less


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.8])
def test_effective_count_is_that_of_the_variance_of_a_smooth_mean(coefficient):
    """Sum u e of n residuals, u smooth, scatters by sqrt(n/N) times what independent ones would: 1500 draws."""
    rng = np.random.default_rng(0)
    smooth = (1 + np.cos(np.linspace(0, np.pi, SHAPE[1])))[:, None, None] * np.linspace(1, 2, SHAPE[2])[:, None]
    sums = np.array([np.sum(smooth * autoregressive(rng, coefficient)) for _ in range(1500)])
    seen = SHAPE[0] ** 2 * np.sum(smooth**2 * np.ones(SHAPE[1:])) * np.prod(SHAPE[1:]) / sums.var()
    estimated = np.mean([effective_count(autoregressive(rng, coefficient), EVERYWHERE) for _ in range(20)])
    assert estimated == pytest.approx(seen, rel=0.15)
    if coefficient:
        assert np.prod(SHAPE) > 2 * estimated  # to count bins would be wrong


def test_channels_that_are_copies_count_once_and_independent_ones_thrice():
    field = autoregressive(np.random.default_rng(5), 0.8)
    alone = effective_count(field[:1], EVERYWHERE[:1])
    assert effective_count(field[:1] * np.ones((3, 1, 1, 1)), EVERYWHERE) == pytest.approx(alone)
    each = [effective_count(field[k : k + 1], EVERYWHERE[:1]) for k in range(3)]
    assert effective_count(field, EVERYWHERE) == pytest.approx(sum(each), rel=0.15)


def test_what_is_not_used_does_not_matter():
    rng = np.random.default_rng(2)
    field, used = autoregressive(rng, 0.5), rng.uniform(size=SHAPE) < 0.5
    spoiled = np.where(used, field, 1e6)
    assert effective_count(spoiled, used) == effective_count(field, used)
    assert effective_count(np.where(used, field, np.nan), used) == effective_count(field, used)


def test_half_of_the_azimuths_count_half():
    field, used = autoregressive(np.random.default_rng(2), 0.8, shape=(3, 60, 12, 36)), np.ones((3, 60, 12, 36), bool)
    everywhere = effective_count(field, used)
    used[..., 18:] = False
    assert effective_count(field, used) == pytest.approx(everywhere / 2, rel=0.15)
    assert effective_count(field, used) == pytest.approx(effective_count(field[..., :18], used[..., :18]))


@pytest.mark.parametrize("axis", [1, 2])
def test_every_other_row_of_a_smooth_field_says_as_much_as_all(axis):
    shape = (3, 60, 60, 9)
    used, field = np.ones(shape, bool), autoregressive(np.random.default_rng(6), 0.9, axis, shape)
    everywhere = effective_count(field, used)
    np.moveaxis(used, axis, 0)[::2] = False
    assert effective_count(field, used) == pytest.approx(everywhere, rel=0.1)


def test_a_few_bins_that_carry_the_cost_are_what_counts():
    rng = np.random.default_rng(3)
    field = rng.normal(size=SHAPE)
    field[:, :, 0] *= 100  # one column of twelve
    assert effective_count(field, EVERYWHERE) == pytest.approx(3 * 60 * 9, rel=0.25)


def test_extreme_fields_are_worth_a_finite_number():
    assert effective_count(np.zeros(SHAPE), EVERYWHERE) == np.prod(SHAPE)
    assert effective_count(np.ones(SHAPE), EVERYWHERE) == pytest.approx(1, abs=0.5)
    one = np.zeros(SHAPE)
    one[0, 3, 4, 5] = 1e-200
    assert 1 <= effective_count(one, EVERYWHERE) <= 3


def random_planes(seed=4, share=0.15):
    """Measured, predicted and valid bins; light and viewer do not weigh alike."""
    rng, grid = np.random.default_rng(seed), merl_grid()
    shape = (3, *grid.cos_i.shape)
    measured, predicted = rng.uniform(0.1, 1, shape), rng.uniform(0.1, 1, shape)
    predicted[..., :90] += 1
    return measured, predicted, rng.uniform(size=grid.cos_i.shape) < share


@pytest.mark.parametrize("theta_max", [1.4, 1.0])
def test_errors_are_those_of_the_definitions(theta_max):
    grid = merl_grid()
    measured, predicted, valid = random_planes()
    found = errors(np.where(valid, measured, np.nan), predicted, valid, grid, theta_max)
    squares = weights = shares = bins = roots = logs = pairs = 0.0
    widths = np.gradient(grid.theta_h)
    for h, d in np.ndindex(90, 90):
        for i in np.flatnonzero(valid[h, d]):
            light, viewer = np.arccos(np.clip([grid.cos_i[h, d, i], grid.cos_o[h, d, i]], -1, 1))
            if max(light, viewer) < theta_max:
                pair = np.cos(grid.theta_d[d]) * np.sin(grid.theta_d[d]) * np.sin(grid.theta_h[h]) * widths[h]
                w = pair * np.cos(light) ** 2 / max(np.sin(light), 0.02)
                m, p = measured[:, h, d, i], predicted[:, h, d, i]
                squares, weights = squares + w * np.sum((m - p) ** 2), weights + 3 * w
                shares, bins = shares + np.sum(np.abs(m - p) / (m + p)), bins + 3
                m, p = m * np.cos(light), p * np.cos(light)
                roots += pair * np.sum((m ** (1 / 3) - p ** (1 / 3)) ** 2)
                logs += pair * np.sum((np.log(1 + m) - np.log(1 + p)) ** 2)
                pairs += 3 * pair
    assert found.rmse == pytest.approx(np.sqrt(squares / weights), rel=1e-9)
    assert found.smape == pytest.approx(shares / bins, rel=1e-9)
    assert found.cube_root == pytest.approx(np.sqrt(roots / pairs), rel=1e-9)
    assert found.log == pytest.approx(np.sqrt(logs / pairs), rel=1e-9)
    swapped = errors(measured[..., ::-1], predicted[..., ::-1], valid[..., ::-1], grid, theta_max)
    assert swapped.rmse != pytest.approx(found.rmse, rel=0.05)


def test_without_bins_no_error_is_a_number():
    measured, _, valid = random_planes()
    nothing = errors(measured, measured, np.zeros_like(valid), merl_grid())
    assert all(np.isnan(x) for x in astuple(nothing))


def test_an_equal_prediction_has_no_error():
    measured, _, valid = random_planes()
    same = errors(np.where(valid, measured, np.nan), measured, valid, merl_grid())
    assert same == Errors(
        rmse=0.0, smape=0.0, cube_root=0.0, log=0.0, highlight=1.0, picture=0.0, lamp=0.0, environment=0.0
    )


def test_what_is_not_valid_or_past_theta_max_does_not_matter():
    grid = merl_grid()
    measured, predicted, valid = random_planes()
    expected = errors(measured, predicted, valid, grid)
    past = np.arccos(np.clip(np.minimum(grid.cos_i, grid.cos_o), -1, 1)) > 1.4
    for where in (past, ~valid):
        spoiled = errors(np.where(where, 1e3, measured), np.where(where, 7e3, predicted), valid, grid)
        assert astuple(spoiled) == astuple(expected)
    assert errors(measured, predicted, valid, grid, 1.5) != expected
    wide = errors(np.where(past, 1e3, measured), predicted, valid, grid, 1.5)
    assert wide.rmse > 10 * expected.rmse


def test_the_highlight_is_the_ratio_of_peaks_where_the_mirror_direction_is_seen():
    grid = merl_grid()
    measured = np.full((3, *grid.cos_i.shape), 0.1)
    predicted = measured.copy()
    measured[:, 0, 20, 90], predicted[:, 0, 31, 10] = [1.0, 2.0, 3.0], [4.0, 1.0, 1.0]  # anywhere in the row
    valid = grid.above.copy()
    assert errors(measured, predicted, valid, grid).highlight == pytest.approx(1.0)  # channels summed
    assert errors(measured, predicted / 2, valid, grid).highlight == pytest.approx(0.5)
    towards_grazing = predicted.copy()
    towards_grazing[:, 0, 65:] = 100.0  # theta_d of 60 degrees and more
    assert errors(measured, towards_grazing, valid, grid).highlight == pytest.approx(1.0)
    elsewhere = predicted.copy()
    elsewhere[:, 1] = 100.0
    assert errors(measured, elsewhere, valid, grid).highlight == pytest.approx(1.0)
    valid[0, 20, 90] = False  # what is not measured is no highlight
    assert errors(measured, predicted, valid, grid).highlight == pytest.approx(6.0 / 0.3)


def test_the_picture_is_of_the_mean_of_reciprocal_bins():
    grid = merl_grid()
    measured, predicted, _ = random_planes(share=1.0)
    inside = within(grid, 1.4)

    def folded(values):
        return (values[..., :90] + values[..., :89:-1]) / 2

    both = inside[..., :90] & inside[..., :89:-1]
    expected = distances(folded(measured), folded(predicted), both)[0]
    assert errors(measured, predicted, grid.above, grid).picture == pytest.approx(expected, rel=1e-12)
    assert expected > 1
