"""The likelihood on a few bins against that on all of them."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit import noise as noise_module
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.noise import noise_of
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline import run, search
from merlfit.fitting.posterior import likelihood
from merlfit.fitting.posterior.coreset import BATCH, STEP
from merlfit.fitting.posterior.likelihood import LIKELIHOOD_POWER, Likelihood, on_all, stand_in
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold
from merlfit.model.two_scale import TwoScale

from tests.support.stand_ins import uncorrelated

LAYOUT = layout_of(TwoScale("lambert", "off"))
TRUTH = {
    "beta": 0.2, "p": 0.8, "eta": np.array([1.5, 1.6, 1.7]), "albedo": np.array([0.5, 0.3, 0.1]),
}  # fmt: skip
COUNT = 100.0


@pytest.fixture(scope="module")
def fitted():
    """A fit of a material that the model does not quite meet, with noise besides; its samples and problem."""
    grid, rng = merl_grid(), np.random.default_rng(6)
    blank = fold(grid, np.ones((3, 90, 90, 180)), np.where(grid.above, 1.0, 0.0) * np.ones((3, 1, 1, 1)))
    clean = run.predict_samples(LAYOUT, LAYOUT.free(TRUTH), blank)
    wrong = 1 + 0.2 * np.cos(4 * blank.theta_h)[:, None, None] * np.cos(5 * blank.theta_d)[:, None]
    weight = blank.weight * blank.cos_i * blank.cos_o * np.sin(blank.theta_d)[:, None] / np.maximum(clean, 1e-3)
    samples = replace(blank, value=clean * wrong * np.exp(0.03 * rng.normal(size=clean.shape)), weight=weight)
    problem = make_problem(samples)
    best = solve(Objective(LAYOUT, problem), LAYOUT.free(TRUTH))
    assert best.converged
    return samples, problem, best


def near(noise, z, size):
    """Draws from the Laplace approximation."""
    return np.random.default_rng(7).multivariate_normal(z, noise.covariance, size=size, method="eigh")


def unlike(best, count, least, most):
    """The noise of residuals of which directions in turn are known so many times as well as by equal ones."""
    noise = uncorrelated(best.normal, best.cost, count)
    root = np.linalg.cholesky(noise.precision)
    times = np.where(np.arange(len(root)) % 2, most, least)
    return replace(noise, precision=root * times @ root.T)


@pytest.mark.parametrize(("least", "most"), [(1.0, 1.0), (0.6, 5.0)])
def test_near_the_fit_it_has_the_precision_of_the_noise_and_far_away_it_is_the_model_that_counts(fitted, least, most):
    _, problem, best = fitted
    noise = unlike(best, COUNT, least, most)
    whole = on_all(LAYOUT, best.z, problem, noise).log_likelihood
    steps = 0.1 / np.sqrt(np.diag(noise.precision)) * np.eye(len(best.z))
    at, *around = whole(np.concatenate([best.z[None], best.z + steps, best.z - steps]))
    curvature = -(np.array(around).reshape(2, -1).sum(0) - 2 * at) / np.diag(steps) ** 2
    np.testing.assert_allclose(curvature, np.diag(noise.precision), rtol=0.15)
    z, objective, hessian = best.z + 0.5, Objective(LAYOUT, problem), best.normal.sum(0)[:-1, :-1]
    residual = objective.weighed(z[None])[0] - objective.target
    costs = objective.costs(LAYOUT.values(jnp.asarray(z))) - problem.rest
    assert float(residual @ residual) == pytest.approx(float(jnp.sum(costs)))
    steps = STEP * np.eye(len(z))
    jacobian = (objective.weighed(best.z + steps) - objective.weighed(best.z - steps)).T / (2 * STEP)
    step = np.linalg.solve(hessian, jacobian.T @ residual)
    scale = least * COUNT / (2 * best.cost) if least < 1 else COUNT / (2 * best.cost)
    cost = scale * residual @ residual + step @ (noise.precision / 2 - scale * hessian) @ step
    assert whole(z[None])[0] == pytest.approx(-cost, rel=0.02)
    far = best.z + np.random.default_rng(3).normal(size=(200, len(z)))
    assert np.all(whole(far) < whole(best.z[None]) + 0.01), "the fit is the most likely"
    assert whole(np.full((1, len(z)), np.nan)) == -np.inf


def test_thinned_grids_see_the_mirror_direction():
    """A lobe narrower than the first kept row would be invisible, and any height of it a perfect fit."""
    for grid in (search.COARSE, search.CANDIDATES):
        assert grid[0][:2] == (1, 1)
        assert sum(grid[0]) == 90


@pytest.mark.parametrize("diffraction", ["off", "quadrature"])
def test_points_of_a_batch_are_what_they_are_one_by_one(fitted, diffraction):
    """Where predictions are made float64 in the same program, jaxlib 0.10 has wrong sums, depending on the batch."""
    samples, _, best = fitted
    layout, rng = layout_of(TwoScale("lambert", diffraction)), np.random.default_rng(8)
    z = np.concatenate([best.z, np.zeros(layout.size - len(best.z))]) if diffraction != "off" else best.z
    normal = np.stack([np.eye(len(z) + 1)] * 3)
    few = stand_in(layout, samples, replace(best, z=z, normal=normal), uncorrelated(normal, best.cost, COUNT))
    points = z + 0.3 * rng.normal(size=(2 * BATCH + 5, len(z)))
    together = few.weighed(points)
    alone = np.concatenate([few.weighed(point[None]) for point in points])
    assert together.shape == (len(points), len(few.target))
    np.testing.assert_allclose(together, alone, atol=2e-6 * np.abs(alone).max())
    assert np.all(np.ptp(together, axis=0).max() > 1e-3)
    np.testing.assert_array_equal(few.weighed(points[::-1])[::-1], together)


@pytest.mark.parametrize(("least", "most"), [(1.0, 1.0), (0.6, 5.0)])
def test_its_slope_at_the_fit_is_that_of_all_bins(fitted, least, most):
    """So that the maximum is elsewhere by little of the posterior's width."""
    samples, problem, best = fitted
    noise = unlike(best, COUNT, least, most)
    steps = 0.02 * np.sqrt(np.diag(noise.covariance)) * np.eye(len(best.z))

    def slope(likelihood):
        ahead, behind = (likelihood.log_likelihood(best.z + sign * steps) for sign in (1, -1))
        return (ahead - behind) / (2 * np.diag(steps))

    few, whole = slope(stand_in(LAYOUT, samples, best, noise)), slope(on_all(LAYOUT, best.z, problem, noise))
    apart = noise.covariance @ (few - LIKELIHOOD_POWER * whole)
    assert np.all(np.abs(apart) < 0.05 * np.sqrt(np.diag(noise.covariance)))


def test_what_is_taken_together_has_the_slopes_and_the_residuals_of_all_bins(fitted, monkeypatch):
    samples, _, best = fitted
    predicted, given = run.predict_samples(LAYOUT, best.z, samples), []
    monkeypatch.setattr(noise_module, "precision_of", lambda *seen: given.extend(seen))
    noise_of(samples, predicted, best, COUNT, partial(run.predict_samples, LAYOUT))
    jacobian, residual = (x.reshape(-1, given[1].size) for x in given[:2])
    hessian, gradient = best.normal.sum(0)[:-1, :-1], best.normal.sum(0)[:-1, -1]
    deviation = np.sqrt(np.diag(hessian))
    np.testing.assert_allclose(
        jacobian @ jacobian.T / deviation / deviation[:, None], hessian / deviation / deviation[:, None], atol=0.1
    )
    assert np.all(np.abs(jacobian @ residual[0] - gradient) < 0.05 * deviation * np.sqrt(best.cost))


@pytest.mark.parametrize(("count", "least", "most"), [(10.0, 1.0, 1.0), (1000.0, 1.0, 1.0), (COUNT, 0.6, 5.0)])
def test_near_the_fit_it_is_that_of_all_bins_a_little_flatter(fitted, count, least, most):
    samples, problem, best = fitted
    noise = unlike(best, count, least, most)
    few, draws = stand_in(LAYOUT, samples, best, noise), near(noise, best.z, 40)
    whole = on_all(LAYOUT, best.z, problem, noise).log_likelihood(draws)
    assert np.std(few.log_likelihood(draws) - LIKELIHOOD_POWER * whole) < 0.5
    assert np.std(whole) > 1
    prior = few.log_posterior(draws) - few.log_likelihood(draws)
    np.testing.assert_allclose(prior, -np.sum(draws**2, 1) / 2)


def test_where_the_model_is_not_finite_nothing_is_likely(fitted):
    samples, _, best = fitted
    few = stand_in(LAYOUT, samples, best, uncorrelated(best.normal, best.cost, COUNT))
    found = few.log_likelihood(np.stack([best.z, np.full(len(best.z), np.nan)]))
    assert np.isfinite(found[0])
    assert found[1] == -np.inf


@pytest.mark.parametrize(("error", "order"), [(0.02, likelihood.ALL_ORDER), (0.2, 32)])
def test_a_lower_order_is_taken_of_all_bins_where_it_says_the_same_up_to_a_constant(monkeypatch, error, order):
    asked = []

    def said(model):
        def weighed(points):
            asked.append(model.order)
            found = 40 + points[:, 0] + (model.order < 32) * (5 + error * points[:, 1])
            return np.sqrt(found)[:, None]

        return weighed

    monkeypatch.setattr(likelihood, "Objective", lambda layout, _: SimpleNamespace(weighed=said(layout.model)))
    layout, nothing = layout_of(TwoScale("lambert")), np.zeros((1, 1))
    full = Likelihood(said(layout.model), np.zeros(1), 1.0, nothing, nothing)
    monkeypatch.setattr(likelihood, "on_all", lambda *_: full)
    some = np.random.default_rng(9).normal(size=(likelihood.COMPARED, 2))
    likelihood.likelihood_of_all(layout, np.zeros(2), None, None, some)(some)
    assert asked[-1] == order
