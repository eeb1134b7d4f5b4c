"""The best table of theta_h and theta_d: of a function of these nothing is left, of noise and azimuth what they add."""

import dataclasses

import numpy as np
import pytest
from merlfit.fitting.fit.tabulated import tabulated
from merlfit.merl_io.bands import Bands
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.merl_io.scattered import ScatteredSamples


@pytest.fixture(scope="module")
def grid():
    whole = merl_grid()
    weight = np.where(whole.above, whole.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(whole, np.ones_like(weight), weight), (5, 5, 10))


def of_angles(theta_h, theta_d):
    return np.exp(-((theta_h / 0.3) ** 2)) * (1 + np.sin(3 * theta_d)) + 0.1


def test_a_function_of_both_angles_is_left_nothing_of(grid):
    value = of_angles(grid.theta_h[:, None, None], grid.theta_d[None, :, None]) * np.ones_like(grid.value)
    assert tabulated(dataclasses.replace(grid, value=value)).cost < 1e-20
    odd = value * (1 + 0.1 * (-1.0) ** np.arange(value.shape[-1]))
    assert 1e-3 < tabulated(dataclasses.replace(grid, value=odd)).cost < 0.011


def test_smooth_tables_pass_through_scattered_samples_and_not_through_noise():
    rng = np.random.default_rng(4)
    theta_h, theta_d = rng.uniform(0, 1.2, 3000), rng.uniform(0, 1.3, 3000)
    value = np.stack([of_angles(theta_h, theta_d)] * 2)
    one, weight = np.ones(3000), rng.uniform(0.5, 1.0, value.shape)
    bands = Bands(("a", "b"), (0.5, 0.6))
    samples = ScatteredSamples(theta_h, theta_d, one, one, value, weight, one, bands)
    assert tabulated(samples).cost < 1e-3
    noise = rng.normal(size=value.shape) * 0.1
    expected = np.sum(weight * (noise * value) ** 2) / np.sum(weight * value**2)
    found = tabulated(dataclasses.replace(samples, value=value * (1 + noise)))
    assert found.numbers == 2 * 28 * 8
    assert 0.85 * expected < found.cost < expected
