"""Which rows are kept: by brute force, and where parameters are read from."""

from dataclasses import replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.problem import energy, make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline import run
from merlfit.fitting.posterior.coreset import COLUMNS, ROWS, Rows, few_rows, runs
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.two_scale import TwoScale

LAYOUT = layout_of(TwoScale("lambert", "off"))
OPTICS = {"eta": np.full(3, 1.5), "albedo": np.full(3, 0.05)}


@pytest.mark.parametrize("seed", range(5))
def test_runs_hold_as_even_shares_as_can_be(seed):
    shares = np.random.default_rng(seed).gamma(0.5, size=9)
    found = runs(shares, 4)
    assert len(found) == 4
    assert sum(found) == 9
    uneven = [
        sum(np.sum(part) ** 2 for part in np.split(shares, edges)) for edges in combinations(range(1, 9), 3)
    ]  # fmt: skip
    assert sum(np.sum(p) ** 2 for p in np.split(shares, np.cumsum(found)[:-1])) == pytest.approx(min(uneven))


def test_a_row_with_all_there_is_stands_alone():
    shares = np.full(90, 1e-3)
    shares[[30, 31]] = 1.0
    found = np.cumsum(runs(shares, ROWS))
    assert {30, 31, 32} <= set(found.tolist())


def sharp(width_deg):
    """A lobe with an edge: samples and free coordinates."""
    grid = merl_grid()
    blank = fold(grid, np.ones((3, 90, 90, 180)), np.where(grid.above, 1.0, 0.0) * np.ones((3, 1, 1, 1)))
    z = LAYOUT.free({"beta": np.tan(np.radians(width_deg)), "p": 3.0, **OPTICS})
    value = run.predict_samples(LAYOUT, z, blank)
    return replace(blank, value=value, weight=blank.weight * blank.cos_i * blank.cos_o / np.maximum(value, 1e-3)), z


def even_rows(samples, runs):
    """The rows that runs of equal length leave, whatever they say about parameters."""
    return Rows.of(LAYOUT, thin(samples, runs), energy(samples))


def edge_rows(rows, width_deg):
    """How many kept rows lie about the edge."""
    theta_h = np.degrees(np.asarray(rows.part.directions.geometry.theta_h).ravel())
    assert len(theta_h) == ROWS
    assert np.all(np.diff(theta_h) > 0)
    return int(np.sum((theta_h > 0.6 * width_deg) & (theta_h < 1.4 * width_deg)))


def test_rows_are_kept_where_the_lobe_has_its_edge():
    for width in (2.0, 20.0):
        samples, z = sharp(width)
        assert edge_rows(few_rows(LAYOUT, samples, z, 1e-4), width) >= 3
    samples, z = sharp(2.0)
    even = even_rows(samples, (90 // ROWS, COLUMNS, 1))
    assert edge_rows(even, 2.0) <= 1


def test_kept_rows_determine_parameters_as_all_bins_do():
    samples, z = sharp(2.0)
    rows = few_rows(LAYOUT, samples, z, 1e-4)
    _, jacobian = rows.tangent(z)
    whole = np.asarray(Objective(LAYOUT, make_problem(samples)).normal_equations(jnp.asarray(z))).sum(0)[:-1, :-1]
    for found in np.linalg.eigvals(np.linalg.solve(whole + 1e-4 * np.eye(len(z)), jacobian.T @ jacobian)).real:
        assert found < 1.5
    name = LAYOUT.coordinates.index("p")
    assert np.linalg.inv(jacobian.T @ jacobian)[name, name] < 1.5 * np.linalg.inv(whole)[name, name]
    even = even_rows(samples, (90 // ROWS, COLUMNS, 1)).tangent(z)[1]
    assert np.linalg.inv(even.T @ even)[name, name] > 2 * np.linalg.inv(whole)[name, name]


def test_predictions_and_target_are_those_of_the_thinned_problem():
    samples, z = sharp(20.0)
    rows = even_rows(samples, (5, COLUMNS, 1))
    away = z + 0.1
    found = np.sum((rows.predicted(away[None])[0] - rows.target) ** 2)
    expected = float(np.sum(Objective(LAYOUT, make_problem(samples)).costs(LAYOUT.values(jnp.asarray(away)))))
    assert found == pytest.approx(expected, rel=0.2)
