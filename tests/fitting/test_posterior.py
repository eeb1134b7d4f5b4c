"""The sampler's parts against what is known of them in closed form."""

import numpy as np
import pytest
from merlfit.fitting import run
from merlfit.fitting.posterior import independent_proposal, laplace_covariance
from scipy.stats import multivariate_t


def test_independent_proposals_are_the_student_t_whose_ratio_they_report():
    rng = np.random.default_rng(0)
    covariance = np.array([[2.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 0.5]])
    centre = np.array([1.0, -2.0, 0.5])
    samples = rng.multivariate_normal(centre, covariance, size=40_000)
    log_prob = -0.5 * np.sum((samples - centre) * np.linalg.solve(covariance, (samples - centre).T).T, 1)
    propose = independent_proposal(samples, log_prob)
    old = samples[:20_000]
    new, log_ratio = propose(old, np.random.RandomState(1))
    t = multivariate_t(centre, covariance, df=10)
    np.testing.assert_allclose(log_ratio, t.logpdf(old) - t.logpdf(new), atol=0.2)
    assert np.median(np.abs(log_ratio - (t.logpdf(old) - t.logpdf(new)))) < 0.02
    np.testing.assert_allclose(new.mean(0), centre, atol=0.05)
    np.testing.assert_allclose(np.cov(new.T), covariance * 10 / 8, atol=0.1)


def test_walkers_astray_do_not_widen_the_proposals():
    rng = np.random.default_rng(2)
    good = rng.normal(size=(20_000, 2))
    stray = rng.normal(size=(1_000, 2)) + 30
    samples = np.concatenate([good, stray])
    log_prob = -0.5 * np.sum(samples**2, 1)
    new, _ = independent_proposal(samples, log_prob)(good, np.random.RandomState(3))
    assert np.quantile(np.abs(new), 0.95) < 3.5
    assert np.cov(samples.T)[0, 0] > 40


def test_the_metropolis_hastings_ratio_leaves_the_target_as_it_is():
    """A skewed target, sampled with independent proposals only: the factor must undo the proposal's density."""
    emcee = pytest.importorskip("emcee")
    rng = np.random.default_rng(4)
    shape = 3.0  # log of a gamma variable
    samples = np.log(rng.gamma(shape, size=(20_000, 2)))

    def log_prob(x):
        return np.sum(shape * x - np.exp(x), 1)

    move = emcee.moves.MHMove(independent_proposal(samples, log_prob(samples)))
    sampler = emcee.EnsembleSampler(8, 2, log_prob, moves=move, vectorize=True)
    sampler.random_state = np.random.RandomState(5).get_state()
    sampler.run_mcmc(samples[:8], 6_000)
    found = np.exp(sampler.get_chain(flat=True))
    assert sampler.acceptance_fraction.mean() > 0.4
    np.testing.assert_allclose(found.mean(0), shape, rtol=0.03)
    np.testing.assert_allclose(found.var(0), shape, rtol=0.1)


def test_directions_without_data_are_held_by_the_prior():
    normal = np.zeros((1, 3, 3))
    normal[0, 0, 0], normal[0, 2, 2] = 4.0, 0.5
    covariance = laplace_covariance(normal, np.array([10.0]), np.zeros(2))
    assert covariance[0, 0] == pytest.approx(1 / (10 * 4.0 / 0.5 + 0.5 + 1e-3))
    assert covariance[1, 1] == pytest.approx(1 / (0.5 + 1e-3))


@pytest.mark.parametrize("grid", [run.COARSE, run.SAMPLING])
def test_thinned_grids_see_the_mirror_direction(grid):
    """A lobe narrower than the first kept row would be invisible, and any height of it a perfect fit."""
    assert grid[0][:2] == (1, 1)
    assert sum(grid[0]) == 90
