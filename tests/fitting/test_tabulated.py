"""Tables of two pairs of angles: of functions of these nothing is left, of noise and azimuth what they add."""

import dataclasses

import numpy as np
import pytest
from merlfit.fitting.fit.tabulated import tabulated
from merlfit.merl_io.bands import Bands
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.merl_io.scattered import ScatteredSamples
from merlfit.model.geometry import Geometry


@pytest.fixture(scope="module")
def grid():
    whole = merl_grid()
    weight = np.where(whole.above, whole.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(whole, np.ones_like(weight), weight), (5, 5, 10))


def of_angles(theta_h, theta_d):
    return np.exp(-((theta_h / 0.3) ** 2)) * (1 + np.sin(3 * theta_d)) + 0.1


def of_cosines(cos_i, cos_o):
    """Smooth, and the same when light and viewer are exchanged."""
    return 0.2 * (1 - (1 - cos_i) ** 3) * (1 - (1 - cos_o) ** 3)


def both(grid):
    lobe = of_angles(grid.theta_h[:, None, None], grid.theta_d[None, :, None])
    return np.where(grid.cos_i > 0, lobe + of_cosines(grid.cos_i, grid.cos_o), 0.0)


def test_a_function_of_either_pair_of_angles_is_left_nothing_of(grid):
    value = both(grid) * np.ones_like(grid.value)
    found = tabulated(dataclasses.replace(grid, value=value))
    assert found.cost < 1e-10
    # of bins that were not among the samples: azimuths beyond a right angle, where light and viewer are exchanged
    whole = merl_grid()
    other = dataclasses.replace(
        whole, theta_h=grid.theta_h, cos_i=whole.cos_i[2::5, 2::5, 150:], cos_o=whole.cos_o[2::5, 2::5, 150:]
    )
    drawn = found.on(other)
    expected = of_angles(whole.theta_h[2::5, None, None], whole.theta_d[2::5][None, :, None])
    expected = expected + of_cosines(other.cos_i, other.cos_o)
    assert drawn.shape == (3, 18, 18, 30)
    seen = whole.above[2::5, 2::5, 150:] & (grid.weight[0, :, :, :1] > 0)
    near = np.abs(drawn - expected)[:, seen] / expected[seen]
    assert np.median(near) < 0.02  # thinned rows stand for the mean of five
    odd = value * (1 + 0.1 * (-1.0) ** np.arange(value.shape[-1]))
    assert 1e-3 < tabulated(dataclasses.replace(grid, value=odd)).cost < 0.011


def test_smooth_tables_pass_through_scattered_samples_and_not_through_noise():
    rng = np.random.default_rng(4)
    theta_i, theta_o, phi = rng.uniform(0, 1.4, 3000), rng.uniform(0, 1.4, 3000), rng.uniform(0, np.pi, 3000)
    i = np.stack([np.sin(theta_i), 0 * phi, np.cos(theta_i)], -1)
    o = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], -1)
    g = Geometry.from_vectors(i, o)
    theta_h, theta_d = np.asarray(g.theta_h), np.asarray(g.theta_d)
    cos_i, cos_o = np.cos(theta_i), np.cos(theta_o)
    value = np.stack([of_angles(theta_h, theta_d) + of_cosines(cos_i, cos_o)] * 2)
    one, weight = np.ones(3000), rng.uniform(0.5, 1.0, value.shape)
    bands = Bands(("a", "b"), (0.5, 0.6))
    samples = ScatteredSamples(theta_h, theta_d, cos_i, cos_o, value, weight, one, bands)
    found = tabulated(samples)
    assert found.cost < 1e-3
    assert found.numbers == 2 * (28 * 8 + 21)
    grid = merl_grid((30, 30, 60))
    drawn, inside = found.on(grid)[0], grid.above & (np.minimum(grid.cos_i, grid.cos_o) > 0.2)
    expected = of_angles(grid.theta_h[:, None, None], grid.theta_d[None, :, None]) + of_cosines(grid.cos_i, grid.cos_o)
    assert np.median(np.abs(drawn / expected - 1)[inside]) < 0.02
    noise = rng.normal(size=value.shape) * 0.1
    expected = np.sum(weight * (noise * value) ** 2) / np.sum(weight * value**2)
    found = tabulated(dataclasses.replace(samples, value=value * (1 + noise)))
    assert 0.85 * expected < found.cost < expected
    assert tabulated(samples.taken(np.arange(500))) is None


def test_nothing_is_known_far_from_what_was_measured(grid):
    some = grid.theta_d < np.radians(45)
    weight = np.where(some[:, None], grid.weight, 0.0)
    found = tabulated(dataclasses.replace(grid, value=both(grid) * np.ones_like(grid.value), weight=weight))
    drawn = found.on(dataclasses.replace(merl_grid(), cos_i=grid.cos_i, cos_o=grid.cos_o))
    known = np.any(weight[0] > 0, -1)
    assert np.isfinite(drawn[:, known]).all()
    assert np.isnan(drawn[:, ~known]).all()


def test_there_is_no_table_of_few_azimuths_or_of_the_dark(grid):
    few = fold(merl_grid((30, 30, 8)), np.ones((3, 30, 30, 8)), np.ones((3, 30, 30, 8)))
    assert tabulated(few) is None
    value = np.ones_like(grid.value) * np.array([1.0, 0.0, 1.0])[:, None, None, None]
    assert tabulated(dataclasses.replace(grid, value=value)) is None
