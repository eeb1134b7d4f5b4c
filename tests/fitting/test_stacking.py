"""Stacked posteriors: weights against a grid search and known cases, and one interval of several models."""

import numpy as np
import pytest
from merlfit.fitting.commands.compare import sampled
from merlfit.fitting.fit.total_scatter import USUAL
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.comparison import compare_file
from merlfit.fitting.pipeline.stacking import DRAWS, scatter_of_several
from merlfit.fitting.posterior.stacking import best_mixture, log_densities, pieces_of, stacked
from merlfit.fitting.settings.config import load
from merlfit.fitting.show.comparison_table import several_table, several_words
from merlfit.fitting.support.clock import silent
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.binary import read
from scipy.stats import norm


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


def test_densities_of_pieces_are_those_of_normal_residuals():
    residuals, variance = np.random.default_rng(3).normal(0, 0.3, (4, 12)), 0.09
    pieces = np.repeat(np.arange(6), 2)
    found = log_densities(residuals**2, pieces, variance, 12.0)
    np.testing.assert_allclose(found, norm.logpdf(residuals, scale=0.3).reshape(4, 6, 2).sum(-1))


def test_stacking_finds_the_model_of_the_data():
    """Two models of independent normal data with unlike means: one is right, each has draws of its posterior."""
    rng = np.random.default_rng(4)
    data = rng.normal(1.0, 1.0, 40)
    draws = rng.normal(data.mean(), 1 / np.sqrt(40), 500), rng.normal(-0.5, 0.2, 500)
    right, wrong = (norm.logpdf(data, each[:, None]) for each in draws)
    found = stacked([right, wrong])
    assert found.weights[0] > 0.9
    assert np.all(found.pareto_k < 0.7)


@pytest.mark.usefixtures("compiled_quickly")
def test_models_of_a_file_have_one_interval_together(file, tmp_path):
    """Of GGX and of what is nearly it, whose intervals the common one lies within the hull of."""
    names, settings = ["ggx", "gtr"], load(posterior=False)
    measurement = read(file)
    samples = weighted_samples(measurement, settings.exponents[0], settings.fit.theta_max)
    rows, _ = compare_file(measurement, names, settings, tmp_path, with_published=False)
    best = sampled(rows, measurement, load(posterior=True), tmp_path, silent)
    found = scatter_of_several(best, measurement, samples)
    assert found.own.keys() == found.weights.keys() <= set(names)
    assert sum(found.weights.values()) == pytest.approx(1)
    np.testing.assert_allclose(found.theta_i, USUAL)
    own = np.stack(list(found.own.values()))
    assert own.shape == (len(best), 3, 3, 3)
    assert np.all((own.min(0) <= found.together + 1e-12) & (found.together <= own.max(0) + 1e-12))
    assert np.all(np.diff(found.together, axis=0) > 0)
    assert DRAWS >= 400, "which 5 % quantiles need"
    drawn = several_table(found, MERL.names)
    assert drawn.row_count == 9
    assert "stacking" in several_words(found)
