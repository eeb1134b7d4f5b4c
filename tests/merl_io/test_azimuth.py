"""Rows of azimuths gathered into nodes: the same sum of squares as over all bins."""

from dataclasses import replace

import numpy as np
import pytest
from merlfit.merl_io.azimuth import gather, nodes_of
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin


@pytest.fixture(scope="module")
def samples():
    """Noise with weights of all sizes, a tenth of the bins invalid, some rows with one bin or none."""
    rng = np.random.default_rng(5)
    grid = merl_grid()
    shape = (2, *grid.above.shape)
    valid = grid.above & (rng.uniform(size=grid.above.shape) < 0.9)
    valid[35] &= rng.uniform(size=valid[35].shape) < 0.01
    valid[65] = False
    weight = np.where(valid, 10 ** rng.uniform(-6, 0, size=shape), 0.0)
    return thin(fold(grid, rng.uniform(size=shape), weight), (10, 6, 1))


def squares(samples, predicted):
    """The sum that is wanted, per channel: over all bins."""
    return np.sum(samples.weight * (samples.value - predicted) ** 2, (1, 2, 3))


def gathered_squares(rows, at_nodes):
    """The sum that is taken, per channel: over the nodes."""
    residual = rows.target - np.einsum("chdjk,chdk->chdj", rows.root, at_nodes)
    return np.sum(residual**2, (1, 2, 3)) + rows.rest


def cos2_phi(theta_h, theta_d, cos_i, cos_o):
    """cos^2 phi_d of directions."""
    odd = np.sin(theta_h)[:, None, None] * np.sin(theta_d)[:, None]
    return ((cos_o - cos_i) / 2 / odd) ** 2


def distance(samples_or_rows):
    """s, in which a row is gathered: root of the distance to the horizon, or to phi_d = 0."""
    r = samples_or_rows
    horizon = np.minimum((1 / np.tan(r.theta_h)[:, None] / np.tan(r.theta_d)) ** 2, 1.0)[..., None]
    return np.sqrt(np.maximum(1 - cos2_phi(r.theta_h, r.theta_d, r.cos_i, r.cos_o) / horizon, 0.0))


@pytest.mark.parametrize("nodes", [3, 8])
def test_squares_of_a_polynomial_are_exact(samples, nodes):
    rng = np.random.default_rng(nodes)
    coefficients = rng.normal(size=(nodes, *samples.value.shape[:3], 1))

    def polynomial(s, degrees=nodes):
        return sum(coefficients[k] * s**k for k in range(degrees))

    rows = gather(samples, nodes)
    assert rows.cos_i.shape == (9, 15, nodes)
    expected = squares(samples, polynomial(distance(samples)))
    np.testing.assert_allclose(gathered_squares(rows, polynomial(distance(rows))), expected, rtol=1e-9)
    few = gather(samples, nodes - 1)  # that is one degree too many for
    assert gathered_squares(few, polynomial(distance(few)))[0] != pytest.approx(expected[0], rel=1e-6)
    without_rest = gathered_squares(replace(rows, rest=0 * rows.rest), polynomial(distance(rows)))
    assert without_rest[0] < 0.99 * expected[0]


def test_nodes_are_above_the_horizon_and_everything_is_finite(samples):
    rows = gather(samples, 8)
    assert np.minimum(rows.cos_i, rows.cos_o).min() > 0
    for array in (rows.root, rows.target, rows.rest):
        assert np.all(np.isfinite(array))
    assert not np.any(rows.root[:, 6])  # the row without a valid bin
    np.testing.assert_array_equal(rows.root, np.triu(rows.root))


def test_many_nodes_do_no_harm(samples):
    rows = gather(samples, 60)  # more than most rows have valid bins
    predicted = np.stack([distance(rows) ** 2] * 2)
    expected = squares(samples, distance(samples) ** 2)
    np.testing.assert_allclose(gathered_squares(rows, predicted), expected, rtol=1e-6)


def test_rows_of_few_bins_stay_as_they_are(samples):
    few = thin(samples, (1, 1, 45))
    rows = gather(few, 8)
    predicted = np.random.default_rng(0).uniform(size=few.value.shape)
    np.testing.assert_allclose(gathered_squares(rows, predicted), squares(few, predicted), rtol=1e-13)
    assert not np.any(rows.rest)


@pytest.mark.parametrize("nodes", [3, 8])
def test_a_polynomial_at_the_nodes_is_known_at_every_bin(samples, nodes):
    coefficients = np.random.default_rng(nodes).normal(size=(nodes, 2, *samples.value.shape[1:3], 1))

    def polynomial(s):
        return sum(coefficients[k] * s**k for k in range(nodes))

    given = nodes_of(samples.theta_h, samples.theta_d, samples.phi_d, nodes)
    at_nodes = polynomial(distance(replace(samples, cos_i=given.cos_i, cos_o=given.cos_o)))
    above = samples.cos_i > 1e-6
    above &= above.sum(-1, keepdims=True) > 1  # a bin that is alone in its row has a value of its neighbourhood
    found, expected = given.at_bins(at_nodes)[:, above], polynomial(distance(samples))[:, above]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    few = nodes_of(samples.theta_h, samples.theta_d, samples.phi_d, nodes - 1)
    at_few = polynomial(distance(replace(samples, cos_i=few.cos_i, cos_o=few.cos_o)))
    assert np.abs(few.at_bins(at_few)[:, above] - expected).max() > 1e-5
