"""The weights of Eq. 56, what may take their place, and the directions that have none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.fit.weights import (
    _compressive,
    compressive_weight,
    cos_weighted_median,
    noise_floor,
    weighted_samples,
    within,
)
from merlfit.fitting.support.choices import THETA_MAX, WEIGHT_SCHEDULES
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold

WIDTH = 0.02  # tan(theta_h) where the lobe has fallen to half
BODY = np.array([0.3, 0.05, 0.002])  # 1/sr: the darker, the more the highlight counts for
LADDER = WEIGHT_SCHEDULES["adaptive"]
EVERY_BEND = [1.4, 0.7, 0.0, "log"]


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


def plainly(measurement, exponent=1.4, theta_max=1.4):
    """A bin's share of the measure times its weight, channel by channel, where neither light nor viewer is too low."""
    grid = merl_grid()
    lowest = np.arccos(np.clip(np.minimum(grid.cos_i, grid.cos_o), -1, 1))
    used = measurement.valid & grid.above & (lowest < theta_max) & (grid.weight > 0)
    weight = np.zeros(measurement.values.shape)
    for plane, found in zip(measurement.values, weight, strict=True):
        value, cos_i = plane[used], np.maximum(grid.cos_i[used], 0)
        if exponent == "log":
            found[used] = grid.weight[used] * (cos_i / (1 + value * cos_i)) ** 2
            continue
        order = np.argsort(value)
        middle = value[order][np.searchsorted(np.cumsum(cos_i[order]), cos_i.sum() / 2)]
        x = value / middle
        found[used] = grid.weight[used] * ((1 - 2.0**-x) / (x * np.log(2))) ** exponent
    return weight


def test_the_compressive_weight_is_that_of_the_paper():
    value = np.array([0.0, 1.0, 100.0])
    weight = compressive_weight(value, np.asarray(1.0))
    x = value[1:]
    expected = (((1 - np.exp(-np.log(2) * x)) / np.log(2)) / x) ** 1.4  # HP17 Eq. 57-58
    np.testing.assert_allclose(weight[1:], expected)
    assert weight[0] == pytest.approx(1)
    np.testing.assert_allclose(compressive_weight(7 * value, np.asarray(7.0)), weight)


def test_the_exponent_bends_the_weight_of_what_is_bright():
    value = np.geomspace(1e-3, 1e3, 30)
    weights = np.array([compressive_weight(value, np.asarray(1.0), exponent) for exponent in LADDER])
    assert sorted(LADDER, reverse=True) == list(LADDER)
    assert np.all(np.diff(weights, axis=0) >= 0)
    assert np.all(np.diff(weights[:-1], axis=1) < 0)
    np.testing.assert_array_equal(weights[-1], 1.0)
    np.testing.assert_allclose(weights[1], weights[0] ** (LADDER[1] / LADDER[0]))


def test_the_median_is_weighted_by_cosines():
    assert cos_weighted_median(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.1, 1.0])) == 3.0
    assert cos_weighted_median(np.array([3.0, 1.0, 2.0]), np.array([0.1, 1.0, 0.1])) == 1.0
    assert cos_weighted_median(np.arange(9.0), np.ones(9)) == 4.0


@pytest.mark.parametrize("theta_max", [1.0, 1.4, np.pi / 2])
@pytest.mark.parametrize("exponent", EVERY_BEND)
def test_the_weights_are_those_of_the_definitions(glossy, exponent, theta_max):
    found = weighted_samples(glossy, exponent, theta_max)
    expected = fold(merl_grid(), np.nan_to_num(glossy.values), plainly(glossy, exponent, theta_max))
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-9)
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-12)
    assert found.scatter == pytest.approx(expected.scatter, abs=1e-9)


def test_as_if_nothing_were_said_they_are_the_paper_s(glossy):
    found, printed = weighted_samples(glossy), weighted_samples(glossy, 1.4, 1.4)
    np.testing.assert_array_equal(found.weight, printed.weight)
    assert THETA_MAX == 1.4
    assert {name: exponents[-1] for name, exponents in WEIGHT_SCHEDULES.items()} == {
        "compressive": 1.4,
        "log": "log",
        "none": 0,
        "adaptive": 0,
    }
    assert {name for name, exponents in WEIGHT_SCHEDULES.items() if exponents[0] != 1.4} == {"none"}, (
        "which searches for itself"
    )
    for other in (0.7, 0.0, "log"):
        assert np.max(np.abs(weighted_samples(glossy, other).weight - printed.weight)) > 0.1 * printed.weight.max()


@pytest.mark.parametrize("exponent", EVERY_BEND)
def test_light_or_viewer_beyond_theta_max_count_for_nothing(glossy, exponent):
    """Bins of either direction too low, and no others; whatever is measured there makes no difference."""
    grid = merl_grid()
    samples, all_of_them = weighted_samples(glossy, exponent), weighted_samples(glossy, exponent, np.pi / 2)
    lowest = np.arccos(np.minimum(samples.cos_i, samples.cos_o))
    assert not np.any(samples.weight[:, lowest > 1.4])
    counted = all_of_them.weight > 0
    assert np.array_equal(samples.weight > 0, counted & (lowest < 1.4))
    assert 0.05 < np.mean(lowest[counted[0]] > 1.4) < 0.5
    past = ~within(grid, 1.4)
    spoiled = replace(glossy, values=np.where(past, 1e3 * glossy.values, glossy.values))
    np.testing.assert_array_equal(weighted_samples(spoiled, exponent).weight, samples.weight)
    assert (
        not np.array_equal(weighted_samples(spoiled, exponent, np.pi / 2).weight, all_of_them.weight) or exponent == 0.0
    )


def test_directions_are_within_as_both_are():
    grid = merl_grid()
    light, viewer = (np.arccos(np.clip(cos, -1, 1)) for cos in (grid.cos_i, grid.cos_o))
    for theta_max in (0.7, 1.4):
        expected = (light < theta_max) & (viewer < theta_max)
        assert np.array_equal(within(grid, theta_max), expected)
        assert np.any((light < theta_max) & ~expected)
        assert np.any((viewer < theta_max) & ~expected)
    assert np.array_equal(within(grid, np.pi / 2), grid.above & (np.minimum(grid.cos_i, grid.cos_o) > 6e-17))


def test_every_channel_is_compared_with_its_own_median(glossy):
    """A channel that is brighter everywhere weighs as the others do: the weights know no unit."""
    brighter = replace(glossy, values=glossy.values * np.array([1.0, 7.0, 1.0])[:, None, None, None])
    before, after = weighted_samples(glossy), weighted_samples(brighter)
    np.testing.assert_allclose(after.weight, before.weight, rtol=1e-9)
    assert not np.allclose(weighted_samples(brighter, "log").weight[1], weighted_samples(glossy, "log").weight[1])


def test_the_log_weight_is_that_of_small_errors_of_the_logarithm():
    """d log(1 + m cos_i) = cos_i / (1 + m cos_i) dm."""
    grid, measurement = merl_grid(), made(20.0)
    one = replace(measurement, valid=grid.above & (grid.theta_d < 0.2)[:, None])
    found = weighted_samples(one, "log")
    less, more = (
        np.log1p(np.nan_to_num(one.values) * scale * np.maximum(grid.cos_i, 0)) for scale in (1 - 1e-5, 1 + 1e-5)
    )
    slope = (more - less) / (2e-5 * np.nan_to_num(one.values, nan=1.0))
    expected = fold(
        grid, np.nan_to_num(one.values), np.where(one.valid & within(grid, 1.4), grid.weight * slope**2, 0.0)
    )
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-7)


def test_pairs_that_differ_scatter_by_their_weights(glossy):
    uneven = replace(glossy, values=np.where(np.arange(180) < 90, 1.2, 1.0) * glossy.values)
    for exponent in EVERY_BEND:
        found = weighted_samples(uneven, exponent)
        expected = fold(merl_grid(), np.nan_to_num(uneven.values), plainly(uneven, exponent))
        assert found.scatter == pytest.approx(expected.scatter, rel=1e-9)
        assert found.scatter > 0


@pytest.mark.parametrize("exponent", EVERY_BEND)
def test_a_file_without_bins_or_without_light_has_weights(exponent):
    grid = merl_grid()
    nothing = Measurement(
        Path("none"), np.full((3, *grid.above.shape), np.nan), np.zeros_like(grid.above), 0, 0, 0, "", ""
    )
    assert not np.any(weighted_samples(nothing, exponent).weight)
    black = replace(nothing, values=np.zeros((3, *grid.above.shape)), valid=grid.above)
    assert np.all(np.isfinite(weighted_samples(black, exponent).weight))
    away = grid.above & (grid.theta_h > 0.5)[:, None, None]
    assert np.all(np.isfinite(weighted_samples(replace(made(20.0), valid=away), exponent).weight))
    past = grid.above & ~within(grid, 1.4)
    assert not np.any(weighted_samples(replace(made(20.0), valid=past), exponent).weight)


def test_noise_below_the_floor_does_not_weigh(tmp_path):
    """What is by chance too dark counts as what is by chance too bright: the weighted mean is the mean."""
    rng = np.random.default_rng(0)
    value, cos_i = 1e-3 * (1 + rng.standard_normal(4000)), np.full(4000, 0.7)
    weight = _compressive(1.4)(value, cos_i)
    assert np.average(value, weights=weight) == pytest.approx(1e-3, rel=0.05)
    bare = compressive_weight(value, np.asarray(1e-3))
    assert np.average(value, weights=bare) < 0.75e-3
    bright = np.abs(value)
    np.testing.assert_array_equal(
        _compressive(1.4)(bright, cos_i), compressive_weight(bright, np.asarray(cos_weighted_median(bright, cos_i)))
    )


def test_a_few_negative_values_say_nothing_of_the_others():
    value = np.concatenate([np.linspace(0.01, 0.09, 2000), [-0.5]])
    assert noise_floor(value) == pytest.approx(0.0105, rel=0.02)
    evenly = np.random.default_rng(0).uniform(0, 1, 100_000) + 0.01 * np.random.default_rng(1).standard_normal(100_000)
    assert noise_floor(evenly) == pytest.approx(0.035, rel=0.1)


def test_a_channel_whose_values_are_mostly_negative_still_weighs():
    """As blue does of a yellow film in RGB: its median is no unit, and its highlight still counts."""
    value = np.concatenate([np.full(800, -0.01), np.full(150, 0.02), np.full(50, 30.0)])
    weight = _compressive(1.4)(value, np.full(1000, 0.7))
    np.testing.assert_allclose(weight[:950], 1 / (2 * np.log(2)) ** 1.4, rtol=1e-12)
    assert 1e-4 < weight[-1] < 1e-2
