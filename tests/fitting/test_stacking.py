"""Stacked posteriors: weights against a grid search and known cases, and one interval of several models."""

import json

import numpy as np
import pytest
from merlfit.fitting.cost import calibration
from merlfit.fitting.fit.total_scatter import USUAL, of_values
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.search import make_coarse
from merlfit.fitting.pipeline.stacking import _places
from merlfit.fitting.posterior.likelihood import Likelihood
from merlfit.fitting.posterior.stacking import best_mixture, left_out, log_densities, pieces_of
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.binary import read
from scipy.stats import multivariate_normal, norm

from tests.support.command import call


def test_weights_are_those_of_the_best_mixture():
    expected = np.log(np.random.default_rng(0).uniform(0.05, 1.0, (2, 15)))
    first = np.linspace(0, 1, 100_001)
    scores = np.log(first[:, None] * np.exp(expected[0]) + (1 - first[:, None]) * np.exp(expected[1])).sum(1)
    np.testing.assert_allclose(best_mixture(expected)[0], first[scores.argmax()], atol=1e-4)


def test_a_model_that_predicts_worse_everywhere_counts_for_nothing_and_twins_count_alike():
    expected = -np.random.default_rng(1).exponential(size=9)
    np.testing.assert_allclose(best_mixture(np.stack([expected, expected - 2])), [1, 0], atol=1e-8)
    np.testing.assert_allclose(best_mixture(np.stack([expected, expected])), [0.5, 0.5])


def test_pieces_are_consecutive_and_of_the_same_energy():
    energy = np.random.default_rng(2).exponential(size=5000)
    pieces = pieces_of(energy, 20.3)
    assert np.all(np.diff(pieces) >= 0)
    np.testing.assert_allclose(np.bincount(pieces, energy), energy.sum() / 20, rtol=0.03)
    assert pieces_of(energy, 3.0).max() == 7, "as many as importance weights can do with"


def test_a_peak_that_has_the_energy_of_several_pieces_is_one():
    energy = np.ones(100)
    energy[50], energy[-5:] = 150.0, 0.0
    pieces = pieces_of(energy, 20.0)
    assert pieces.max() < 20
    assert np.array_equal(np.unique(pieces), np.arange(pieces.max() + 1)), "and none is empty"
    assert np.sum(pieces == pieces[50]) < 10


def linear(rng, count, size, excess):
    """A linear model of noisy data that the likelihood is exact of: its precision, the likelihood, and its draws."""
    slopes, truth = rng.standard_normal((count, size)), rng.standard_normal(size)
    along = rng.standard_normal((count, size)) / np.sqrt(count)
    scale = 0.7
    precision = 2 * scale * (np.eye(count) + along @ excess @ along.T)
    target = slopes @ truth + np.linalg.cholesky(np.linalg.inv(precision)) @ rng.standard_normal(count)
    likelihood = Likelihood(lambda points: points @ slopes.T, target, scale, along, excess)
    posterior = np.linalg.inv(slopes.T @ precision @ slopes + np.eye(size))
    middle = posterior @ slopes.T @ precision @ target
    draws = middle + rng.standard_normal((8000, size)) @ np.linalg.cholesky(posterior).T
    return slopes, precision, likelihood, draws


@pytest.mark.parametrize("excess", [np.zeros((2, 2)), np.array([[3.0, 1.0], [1.0, 2.0]])], ids=["independent", "not"])
def test_what_is_left_out_is_predicted_as_by_the_posterior_of_the_rest(excess):
    """Against the conditional density of normal data, the parameters of a prior of their own integrated out."""
    slopes, precision, likelihood, draws = linear(np.random.default_rng(4), 24, 2, excess)
    pieces, y = np.repeat(np.arange(12), 2), likelihood.target
    found, k = left_out(
        log_densities(likelihood, draws, pieces, 1 / (2 * likelihood.scale), np.full(12, 2.0)), np.ones(len(draws))
    )
    whole = np.linalg.inv(precision) + slopes @ slopes.T
    for b in range(12):
        own, others = np.flatnonzero(pieces == b), np.flatnonzero(pieces != b)
        weights = whole[np.ix_(own, others)] @ np.linalg.inv(whole[np.ix_(others, others)])
        covariance = whole[np.ix_(own, own)] - weights @ whole[np.ix_(others, own)]
        exact = multivariate_normal.logpdf(y[own], weights @ y[others], covariance)
        np.testing.assert_allclose(found[b], exact, atol=0.05)
    assert k < 0.7


def test_densities_of_independent_pieces_are_those_of_normal_residuals():
    residuals, variance = np.random.default_rng(3).normal(0, 0.3, (4, 12)), 0.09
    likelihood = Likelihood(lambda _: residuals, np.zeros(12), 1 / (2 * variance), np.zeros((12, 1)), np.zeros((1, 1)))
    found = log_densities(likelihood, np.zeros((4, 1)), np.repeat(np.arange(6), 2), variance, np.full(6, 2.0))
    np.testing.assert_allclose(found, norm.logpdf(residuals, scale=0.3).reshape(4, 6, 2).sum(-1))


def test_weights_of_draws_count():
    """Draws that stand twice are as one of twice the weight."""
    _, _, likelihood, draws = linear(np.random.default_rng(5), 24, 2, np.zeros((2, 2)))
    densities = log_densities(likelihood, draws[:1500], np.repeat(np.arange(12), 2), 1.0, np.full(12, 2.0))
    once, _ = left_out(densities, np.concatenate([np.full(500, 2.0), np.full(1000, 1.0)]))
    twice, _ = left_out(np.concatenate([densities, densities[:500]]), np.ones(2000))
    np.testing.assert_allclose(once, twice, atol=0.01)


def test_places_are_rows_of_bins_in_order_of_theta_d(file):
    samples = weighted_samples(read(file))
    problem, _ = make_coarse(samples)
    places, energy = _places(problem, samples)
    (part,) = problem.parts
    target = np.asarray(part.target)
    assert places.shape == (target.size,)
    theta_d = np.broadcast_to(np.asarray(part.directions.geometry.theta_d)[:, None], target.shape).ravel()
    theta_h = np.broadcast_to(np.asarray(part.directions.geometry.theta_h)[:, None], target.shape).ravel()
    order = np.argsort(places, kind="stable")
    assert np.all(np.diff(theta_d[order]) >= 0)
    assert np.all(np.diff(theta_h[order])[np.diff(theta_d[order]) == 0] >= 0)
    np.testing.assert_allclose(energy, np.bincount(places, target.ravel() ** 2))


@pytest.mark.slow
def test_which_samples_the_best_models_stacks_them_and_goes_on(file, tmp_path):
    """Of a file that the two-scale model made: it has most of the weight, and all together hold the true scatter."""
    command = ("which", file, "--models", "two-scale,ggx,ward", "--posterior", "-o", tmp_path)
    shown = call(*command)
    assert shown.exit_code == 0
    assert "total integrated scatter (TIS): medians and 90 % intervals of posteriors" in shown.stdout
    told = json.loads((tmp_path / f"{file.stem}.stacked.json").read_text())
    assert told["weights"].keys() == {"two-scale", "ggx", "ward"}
    assert told["weights"]["two-scale"] > 0.9
    model, values = calibration.truth(int(file.stem.split("-")[1]))
    true = of_values(model.material, {name: np.asarray(x)[None] for name, x in values.items()}, MERL, USUAL)[0]
    for row in told["tis"]["together"]:
        k = round(row["theta_i_deg"] / 30)
        assert row["q05"] - 0.01 < true[MERL.names.index(row["channel"]), k] < row["q95"] + 0.01
    before = (tmp_path / "ggx" / f"{file.stem}.json").stat().st_mtime
    assert call(*command).exit_code == 0
    assert (tmp_path / "ggx" / f"{file.stem}.json").stat().st_mtime == before, "what is done is left alone"
