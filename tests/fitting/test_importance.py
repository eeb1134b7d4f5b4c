"""Importance weights against Gaussians, of which all is known."""

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit.levenberg_marquardt import Solution
from merlfit.fitting.fit.outcome import Fitted
from merlfit.fitting.pipeline.result import parameter_results, posterior_parts, with_quantiles
from merlfit.fitting.posterior import importance
from merlfit.fitting.posterior.chain import WALKERS, Chain
from merlfit.fitting.posterior.diagnosis import LEAST_SIZE, diagnose
from merlfit.fitting.posterior.importance import LARGEST_K, MOST_DRAWS, correct, sizes, smoothed
from merlfit.fitting.support.weighted import quantiles
from merlfit.model.derived import quantities

from tests.support.stand_ins import LAYOUT, uncorrelated

SIZE = LAYOUT.size
NORMAL = np.random.RandomState(0).get_state()[1:]


def gaussian_chain(deviation=1.0, steps=400):
    """A chain of independent draws from a normal distribution."""
    states = deviation * np.random.default_rng(0).normal(size=(steps, WALKERS, SIZE))
    return Chain(states, np.zeros(states.shape[:2]), 0.0, np.eye(SIZE), 0.15, states[0], NORMAL, np.zeros(SIZE))


def gaussian(z, middle=0.0, deviation=1.0):
    """Logarithm of its density, up to a constant."""
    return -np.sum((z - middle) ** 2, -1) / (2 * deviation**2)


def corrected(chain, few, whole):
    return correct(chain, few, whole, LAYOUT.coordinates)


def a_fit():
    solution = Solution(np.zeros(SIZE), 0.1, np.stack([np.eye(SIZE + 1)] * 3), 1, 0.0, True)
    noise = uncorrelated(solution.normal, solution.cost, 20.0)
    return Fitted(LAYOUT, solution, np.full(3, 0.1 / 3), noise, Errors(*(0.0,) * 6), [])


def quantiles_of(posterior):
    """As the JSON has them."""
    sampled = SimpleNamespace(posterior=posterior, values=posterior.draws)
    return [q.quantiles for q in with_quantiles(parameter_results(a_fit()), sampled)]


def test_draws_of_a_shifted_gaussian_are_weighed_to_the_right_mean_and_quantiles():
    shift = np.where(np.arange(SIZE) == 1, 0.5, 0.0)
    found = corrected(gaussian_chain(), gaussian, lambda z: gaussian(z, shift, 0.8))
    assert found.sufficient, found.message
    assert found.pareto_k < LARGEST_K
    assert found.weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(found.weights @ found.draws, shift, atol=0.15)
    assert np.all(np.abs(found.draws.mean(0)) < 0.1)  # without weights it is the chain's
    for interval, middle in zip(quantiles_of(found), shift, strict=True):
        ends = (interval.q05, interval.q50, interval.q95)
        np.testing.assert_allclose(ends, middle + 0.8 * np.array([-1.645, 0, 1.645]), atol=0.3)


def test_more_draws_are_taken_until_they_are_enough():
    few = corrected(gaussian_chain(), gaussian, gaussian)
    assert len(few.draws) == importance.DRAWS
    assert few.sufficient
    assert few.pareto_k == 0
    np.testing.assert_allclose(few.weights, 1 / len(few.draws))
    shift = np.where(np.arange(SIZE) == 1, 0.7, 0.0)
    more = corrected(gaussian_chain(), gaussian, lambda z: gaussian(z, shift))
    assert importance.DRAWS < len(more.draws) <= MOST_DRAWS
    assert more.effective_size.min() >= LEAST_SIZE
    np.testing.assert_array_equal(more.draws[: importance.DRAWS], few.draws)  # those before are kept


def test_too_narrow_a_chain_is_not_trusted_and_gives_no_intervals():
    found = corrected(gaussian_chain(0.4), lambda z: gaussian(z, deviation=0.4), gaussian)
    assert found.pareto_k > LARGEST_K
    assert not found.sufficient
    assert f"Pareto k of its weights is {found.pareto_k:.2f}" in found.message
    assert quantiles_of(found) == [None] * SIZE


def test_too_short_a_chain_is_not_trusted_however_good_the_weights():
    found = corrected(gaussian_chain(steps=50), gaussian, gaussian)
    assert not found.sufficient
    assert found.message.startswith("50 steps are 0 autocorrelation times, 50 are needed; continue the chain with")
    assert quantiles_of(found) == [None] * SIZE


def test_a_chain_that_is_too_short_for_its_weights_says_how_long_it_must_be(monkeypatch):
    def slow(states):
        """Its diagnosis were a quarter of the steps of one walker independent."""
        return replace(diagnose(states), bulk=np.full(SIZE, len(states) / 4))

    monkeypatch.setattr(importance, "diagnose", slow)
    whole = partial(gaussian, middle=np.where(np.arange(SIZE) == 1, 0.7, 0.0))
    found = corrected(gaussian_chain(steps=1700), gaussian, whole)
    assert not found.diagnosis.failures()
    assert not found.sufficient
    assert "in the weighted draws is" in found.message
    assert found.message.endswith("continue the chain with `merlfit sample`")
    assert found.wanted > 1700
    longer = corrected(gaussian_chain(steps=found.wanted), gaussian, whole)
    assert longer.sufficient, longer.message
    assert longer.wanted == 0


def test_weights_too_uneven_for_any_chain_do_not_send_it_on(monkeypatch):
    monkeypatch.setattr(importance, "LARGEST_K", np.inf)
    found = corrected(gaussian_chain(0.4), lambda z: gaussian(z, deviation=0.4), gaussian)
    assert not found.sufficient
    assert f"in {MOST_DRAWS} weighted draws is" in found.message
    assert "the weights are uneven" in found.message
    assert found.wanted == 0


def test_too_short_a_chain_goes_into_json():
    with np.errstate(divide="ignore"):
        found = corrected(gaussian_chain(steps=50), gaussian, gaussian)
    told = {q.name: np.zeros((len(found.draws) + 1, 3 if q.per_channel else 1)) for q in quantities(LAYOUT.material)}
    sampled = SimpleNamespace(
        posterior=found, values=found.draws, derived={k: x[:-1] for k, x in told.items()},
        at_fit={k: x[-1] for k, x in told.items()},
    )  # fmt: skip
    told = posterior_parts(parameter_results(a_fit()), a_fit(), sampled, "x")["posterior"]
    assert json.dumps(told.model_dump(mode="json"), allow_nan=False)


def test_draws_where_the_model_of_all_bins_is_not_finite_weigh_nothing():
    found = corrected(gaussian_chain(), gaussian, lambda z: np.where(z[:, 1] > 1.5, -np.inf, gaussian(z, 0.05)))
    assert np.all(found.weights[found.draws[:, 1] > 1.5] < 1e-12)
    assert found.weights.sum() == pytest.approx(1)


def test_smoothed_weights_are_the_ratios_but_for_the_largest():
    log_ratio = 0.5 * np.random.default_rng(1).normal(size=2000)
    weights, k = smoothed(log_ratio + 1000)  # the constant does not matter
    expected = np.exp(log_ratio) / np.exp(log_ratio).sum()
    small = log_ratio < np.quantile(log_ratio, 0.8)
    np.testing.assert_allclose(weights[small], expected[small], rtol=0.02)
    np.testing.assert_array_equal(np.argsort(weights), np.argsort(log_ratio))
    assert k < 0.5
    heavy, k = smoothed(2 * np.random.default_rng(2).exponential(size=2000))  # weights of infinite mean
    assert k > LARGEST_K
    assert heavy.max() > 0.1


def test_the_size_of_weighted_draws_is_that_of_the_variance_of_their_mean():
    """Of draws +-1 in pairs of the same weight: 1 / sum w^2."""
    draws = np.tile([[1.0, -2.0], [-1.0, 2.0]], (300, 1))
    weights = np.repeat(np.random.default_rng(3).uniform(size=300), 2)
    weights /= weights.sum()
    expected = 1 / np.sum(weights**2)
    np.testing.assert_allclose(sizes(draws, weights, np.array([1e4, 600.0])), expected)
    np.testing.assert_allclose(sizes(draws, weights, np.array([300.0, 60.0])), expected * np.array([0.5, 0.1]))
    equal, half = np.full(600, 1 / 600), np.repeat([1 / 300, 0.0], 300)
    np.testing.assert_allclose(sizes(draws, equal, np.full(2, 600.0)), 600)
    np.testing.assert_allclose(sizes(draws, half, np.full(2, 600.0)), 300)


def test_the_size_is_what_means_of_many_sets_of_draws_scatter_by():
    rng, means, expected = np.random.default_rng(4), [], []
    for _ in range(800):
        x = rng.normal(size=(400, 1))
        weights = np.exp(0.5 * x[:, 0])
        weights /= weights.sum()
        means.append(weights @ x[:, 0])
        expected.append(sizes(x, weights, np.array([400.0]))[0])
    assert np.mean(means) == pytest.approx(0.5, abs=0.02)
    assert 1 / np.var(means) == pytest.approx(np.median(expected), rel=0.15)  # the target's variance is one


def test_weighted_quantiles_are_those_of_repeated_values():
    rng = np.random.default_rng(5)
    values, times = rng.normal(size=(200, 3, 2)), rng.integers(0, 5, 200)
    found = quantiles(values, times / times.sum())
    repeated = np.repeat(values, times, axis=0)
    assert found.shape == (3, 3, 2)
    np.testing.assert_array_equal(found, np.quantile(repeated, [0.05, 0.5, 0.95], axis=0, method="inverted_cdf"))
