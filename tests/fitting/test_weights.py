"""The weights of Eq. 56 and what the highlight counts for under them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.weights import (
    DARK_QUANTILE,
    compressive_weight,
    cos_weighted_median,
    half_width,
    weighted_samples,
)
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold

WIDTH = 0.02  # tan(theta_h) where the lobe has fallen to half
BODY = np.array([0.3, 0.05, 0.002])  # 1/sr: the darker, the more the highlight counts for


def lobe(tangent, width=WIDTH):
    """Beckmann's, one at its peak."""
    return np.exp(-np.log(2) * (tangent / width) ** 2)


def made(peak):
    """A highlight on a body, every bin above the horizon."""
    grid = merl_grid()
    shape = (3, *grid.above.shape)
    values = BODY[:, None, None, None] + peak * lobe(np.tan(grid.theta_h))[:, None, None] * np.ones(shape)
    return Measurement(Path("made"), np.where(grid.above, values, np.nan), grid.above, 0, 0, 0, "", "")


@pytest.fixture(scope="module")
def glossy():
    return made(20.0)


def plainly(measurement):
    """Eq. 56-58 as printed: a bin's share of the measure times w_C, channel by channel."""
    grid = merl_grid()
    used = measurement.valid & grid.above & (grid.weight > 0)
    weight = np.zeros(measurement.values.shape)
    for plane, found in zip(measurement.values, weight, strict=True):
        value, cos_i = plane[used], np.maximum(grid.cos_i[used], 0)
        order = np.argsort(value)
        middle = value[order][np.searchsorted(np.cumsum(cos_i[order]), cos_i.sum() / 2)]
        x = value / middle
        found[used] = grid.weight[used] * ((1 - 2.0**-x) / (x * np.log(2))) ** 1.4
    return weight


def bright(samples):
    """Rows within the half width of the lobe."""
    width = half_width(samples.theta_h, samples.theta_d, samples.value, samples.weight > 0)
    return np.tan(samples.theta_h) <= width


def shares(samples):
    """Of each channel's weighted energy, what is within the half width."""
    rows = np.sum(samples.weight * samples.value**2, (2, 3))
    return rows[:, bright(samples)].sum(1) / rows.sum(1)


def test_the_compressive_weight_is_that_of_the_paper():
    value = np.array([0.0, 1.0, 100.0])
    weight = compressive_weight(value, np.asarray(1.0))
    x = value[1:]
    expected = (((1 - np.exp(-np.log(2) * x)) / np.log(2)) / x) ** 1.4  # HP17 Eq. 57-58
    np.testing.assert_allclose(weight[1:], expected)
    assert weight[0] == pytest.approx(1)
    np.testing.assert_allclose(compressive_weight(7 * value, np.asarray(7.0)), weight)


def test_the_median_is_weighted_by_cosines():
    assert cos_weighted_median(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.1, 1.0])) == 3.0
    assert cos_weighted_median(np.array([3.0, 1.0, 2.0]), np.array([0.1, 1.0, 0.1])) == 1.0
    assert cos_weighted_median(np.arange(9.0), np.ones(9)) == 4.0


def test_without_a_floor_the_weights_are_the_paper_s(glossy):
    found = weighted_samples(glossy, 0.0)
    expected = fold(merl_grid(), np.nan_to_num(glossy.values), plainly(glossy))
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-9)
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-12)
    assert found.scatter == pytest.approx(expected.scatter, abs=1e-9)


@pytest.mark.parametrize("least", [0.05, 0.1, 0.5, 0.9])
def test_the_highlight_carries_what_was_asked_in_every_channel(glossy, least):
    printed, found = weighted_samples(glossy, 0.0), weighted_samples(glossy, least)
    before, after = shares(printed), shares(found)
    assert np.any(before < least)
    np.testing.assert_allclose(after, np.maximum(before, least), rtol=1e-9)
    np.testing.assert_allclose(found.value, printed.value, rtol=1e-12)
    within = bright(printed)
    np.testing.assert_array_equal(found.weight[:, ~within], printed.weight[:, ~within])
    for channel in range(3):  # all of them alike, and none is lowered
        used = printed.weight[channel, within] > 0
        raised = found.weight[channel, within][used] / printed.weight[channel, within][used]
        assert np.ptp(raised) < 1e-9 * raised.max()
        assert (raised.min() > 1 + 1e-9) == (before[channel] < least)


def test_channels_that_need_no_floor_are_left_as_they_are(glossy):
    """Each by itself: the darker the body, the more the highlight counts for anyway."""
    printed = weighted_samples(glossy, 0.0)
    before = shares(printed)
    assert before[0] < before[1] < before[2]
    found = weighted_samples(glossy, float(before[1:].mean()))
    np.testing.assert_array_equal(found.weight[2], printed.weight[2])
    assert np.all(shares(found)[:2] > before[:2])


def test_pairs_that_differ_scatter_by_the_raised_weights(glossy):
    """Weights are raised before folding: what that cannot explain is of the same unit as the cost."""
    uneven = replace(glossy, values=np.where(np.arange(180) < 90, 1.2, 1.0) * glossy.values)
    low, high = (weighted_samples(uneven, least) for least in (0.0, 0.5))
    factor = np.where(bright(low), (high.weight / np.where(low.weight > 0, low.weight, np.inf)).max((2, 3)), 1.0)
    expected = fold(merl_grid(), np.nan_to_num(uneven.values), plainly(uneven) * factor[..., None, None])
    assert high.scatter == pytest.approx(expected.scatter, rel=1e-9)
    assert high.scatter > 1.2 * low.scatter > 0
    np.testing.assert_allclose(high.weight, expected.weight, rtol=1e-9)


def test_a_file_without_bins_or_without_light_has_weights():
    grid = merl_grid()
    nothing = Measurement(
        Path("none"), np.full((3, *grid.above.shape), np.nan), np.zeros_like(grid.above), 0, 0, 0, "", ""
    )
    assert not np.any(weighted_samples(nothing).weight)
    black = replace(nothing, values=np.zeros((3, *grid.above.shape)), valid=grid.above)
    assert np.all(np.isfinite(weighted_samples(black).weight))
    away = grid.above & (grid.theta_h > 0.5)[:, None, None]
    assert np.all(np.isfinite(weighted_samples(replace(made(20.0), valid=away)).weight))


@pytest.mark.parametrize("width", [0.02, 0.08, 0.3, 1.0])
def test_the_half_width_is_that_of_a_known_lobe(width):
    grid = merl_grid()
    tangent = np.tan(grid.theta_h)
    value = (0.2 + 5 * lobe(tangent, width))[None, :, None, None] * np.ones((3, 1, 90, 90))
    used = np.broadcast_to(grid.above[..., :90], value.shape)
    found = half_width(grid.theta_h, grid.theta_d, value, used)
    row = np.searchsorted(tangent, width)  # the first that is darker than half
    assert tangent[row - 1] <= found <= tangent[row + 1]
    np.testing.assert_allclose(half_width(grid.theta_h, grid.theta_d, 1e3 * value, used), found)


def test_the_half_width_looks_at_small_theta_d_and_at_what_counts():
    grid = merl_grid()
    value = (0.2 + 5 * lobe(np.tan(grid.theta_h)))[None, :, None, None] * np.ones((3, 1, 90, 90))
    used = np.broadcast_to(grid.above[..., :90], value.shape)
    expected = half_width(grid.theta_h, grid.theta_d, value, used)
    elsewhere = np.where(grid.theta_d[:, None] > 1.0, 1e4, value)
    assert half_width(grid.theta_h, grid.theta_d, elsewhere, used) == expected
    spoiled, without = value.copy(), used.copy()
    spoiled[:, 60:, :3, :10], without[:, 60:, :3, :10] = 1e6, False
    assert half_width(grid.theta_h, grid.theta_d, spoiled, without) == expected
    assert 0 < DARK_QUANTILE < 1


def test_the_half_width_of_nothing_is_a_number():
    grid = merl_grid()
    value, used = np.zeros((3, 90, 90, 90)), np.broadcast_to(grid.above[..., :90], (3, 90, 90, 90))
    for nothing in (used, np.zeros_like(used)):
        assert 0 < half_width(grid.theta_h, grid.theta_d, value, nothing) <= 2
