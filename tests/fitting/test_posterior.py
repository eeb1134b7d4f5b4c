"""The sampler's parts against what is known of them in closed form."""

import dataclasses

import emcee
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting import run
from merlfit.fitting.laplace import laplace_covariance
from merlfit.fitting.levenberg_marquardt import solve
from merlfit.fitting.posterior import free_of_normal, independent_proposal, normal_of_free, sample
from merlfit.fitting.problem import make_problem
from merlfit.fitting.transforms import layout_of
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.effects import Effects
from scipy.special import expit
from scipy.stats import binom, kstest, multivariate_t, norm


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


def test_sampled_coordinates_make_the_priors_normal():
    x = np.linspace(-8, 8, 33)
    z = np.asarray(free_of_normal(jnp.asarray(x)))
    np.testing.assert_allclose(normal_of_free(z), x, atol=1e-12)
    np.testing.assert_allclose(expit(z), norm.cdf(x), rtol=1e-12)  # the position between the bounds is uniform


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


TRUTH = {
    "beta": 0.2, "p": 0.8, "eta": np.array([1.5, 1.6, 1.7]), "albedo": np.array([0.5, 0.3, 0.1]),
}  # fmt: skip
SETS, NOISE = 4, np.array([0.01, 0.006, 0.003])  # relative to the root mean square, per channel: scales are unknown


@pytest.fixture(scope="module")
def noisy_posteriors():
    """Posteriors of synthetic data with independent noise of one size, for which the likelihood is the true one."""
    effects = Effects("lambert", "off")
    grid = merl_grid()
    ones = np.ones((3, 90, 90, 180))
    blank = thin(fold(grid, ones, np.where(grid.above, 1.0, 0.0) * ones), (10, 10, 45))
    clean = run.predict_samples(effects, layout_of(effects).free(TRUTH), blank)
    counts = (blank.weight > 0).sum((1, 2, 3)).astype(float)
    size = (NOISE * np.sqrt(np.sum(blank.weight * clean**2) / counts.sum()))[:, None, None, None]
    rng = np.random.default_rng(6)
    found = []
    for seed in range(SETS):
        noise = size * rng.normal(size=clean.shape) / np.sqrt(np.where(blank.weight > 0, blank.weight, np.inf))
        samples = dataclasses.replace(blank, value=clean + noise)
        problem = make_problem(samples)
        best = solve(effects, layout_of(effects).free(TRUTH), problem)
        assert best.converged
        target = (effects, problem)
        chain = sample(target, target, best.z, best.normal, counts, 3000, seed)
        found.append((best, chain, counts, effects, problem))
    return found


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(noisy_posteriors):
    ranks, inside = [], 0
    for _, chain, _, effects, _ in noisy_posteriors:
        assert chain.sufficient, chain.message
        assert chain.thinning_error < 1e-6
        values = chain.values(layout_of(effects))
        truth = np.concatenate([np.ravel(TRUTH[q.name]) for q in layout_of(effects).parameters])
        ranks.append(np.mean(values < truth, 0))
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
        assert np.all((low < middle) & (middle < high))
        inside += np.sum((low < truth) & (truth < high))
    assert binom.ppf(0.001, SETS * 8, 0.9) <= inside
    # ranks of the truth are uniform: neither too wide nor too narrow (width 0.289), nor shifted
    assert kstest(np.ravel(ranks), "uniform").pvalue > 1e-3
    assert 0.2 < np.std(ranks) < 0.36


@pytest.mark.slow
def test_a_well_determined_posterior_is_the_laplace_approximation(noisy_posteriors):
    """Around the optimum of channels weighed by N_c / S_c, as the likelihood weighs them; Eq. 56 weighs all alike."""
    astray = 0.0
    for best, chain, counts, effects, problem in noisy_posteriors:
        free = chain.chain.reshape(-1, chain.chain.shape[-1])
        scale = counts / best.normal[:, -1, -1]
        root = np.sqrt(scale / scale.mean())
        weighed = eqx.tree_at(
            lambda q: (q.parts[0].root, q.parts[0].target), problem,
            (problem.parts[0].root * root[:, *[None] * 4], problem.parts[0].target * root[:, *[None] * 3]),
        )  # fmt: skip
        centre = solve(effects, best.z, weighed).z
        expected = np.sqrt(np.diag(laplace_covariance(best.normal, counts, best.z)))
        narrow = expected < 0.3  # others are skewed by the bounds
        assert narrow.sum() >= 7
        np.testing.assert_allclose(free.std(0)[narrow], expected[narrow], rtol=0.25)
        assert np.all(np.abs(free.mean(0) - centre) < 0.5 * expected)
        astray = max(astray, np.max(np.abs(free.mean(0) - best.z) / expected))
        assert chain.acceptance > 0.4
    assert astray > 1  # the comparison sees the difference between the two optima
