"""Stacked posteriors: weights against a grid search and known cases, and one interval of several models."""

from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.fit.total_scatter import USUAL
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import stacking
from merlfit.fitting.pipeline.stacking import scatter_of_several
from merlfit.fitting.posterior.stacking import Said, best_mixture, pieces_of, stacked
from merlfit.fitting.settings.config import load
from merlfit.fitting.show.comparison_table import several_table, several_words
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.binary import read
from scipy.stats import norm

from tests.support.command import call
from tests.support.made_results import made


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
    likelihood = np.array([-3.0, -2.0, -1.0, 0.0])
    found = Said.of(residuals**2, pieces, likelihood, variance, 12.0)
    np.testing.assert_allclose(found.densities, norm.logpdf(residuals, scale=0.3).reshape(4, 6, 2).sum(-1))
    np.testing.assert_allclose(found.contributions.sum(1), likelihood)


def test_what_is_left_out_is_predicted_as_by_the_posterior_of_the_rest():
    """Independent normal data with a mean to be found: the exact density of each without it is known."""
    rng = np.random.default_rng(4)
    data = rng.normal(1.0, 1.0, 40)
    draws = rng.normal(data.mean(), 1 / np.sqrt(40), 4000)
    squares = (data - draws[:, None]) ** 2
    said = Said.of(squares, np.arange(40), -squares.sum(1) / 2, 1.0, 40.0)
    found, k = said.left_out()
    exact = norm.logpdf(data, (data.sum() - data) / 39, np.sqrt(1 + 1 / 39))
    np.testing.assert_allclose(found, exact, atol=0.01)
    assert k < 0.7
    wrong = (data + 0.5) ** 2 + np.zeros((4000, 1))
    assert stacked([said, Said.of(wrong, np.arange(40), -wrong.sum(1) / 2, 1.0, 40.0)]).weights[0] > 0.9


@pytest.mark.usefixtures("compiled_quickly")
def test_posteriors_of_a_file_have_one_interval_together(file, monkeypatch):
    """Of two results whose draws, of nearly the same parameters, are half as far apart as they are wide."""
    count, rng = 64, np.random.default_rng(6)
    monkeypatch.setattr(stacking, "DRAWS", count)
    settings, measurement, result = load(), read(file), made(posterior=True)
    samples = weighted_samples(measurement, settings.exponents[0], settings.fit.theta_max)
    fit = np.array([q.value for q in result.parameters])

    def chain(_, path):
        shift = 0.1 if path.stem == "b" else 0.0
        values = fit * np.exp(shift + 0.2 * rng.standard_normal((count, len(fit))))
        return {"values": values, "weights": np.full(count, 1 / count), "log_likelihood": -rng.exponential(size=count)}

    monkeypatch.setattr(stacking, "chain_file", chain)
    found = scatter_of_several({name: (result, Path(f"{name}.json")) for name in "ab"}, measurement, samples)
    assert sum(found.weights.values()) == pytest.approx(1)
    np.testing.assert_allclose(found.theta_i, USUAL)
    own = np.stack([found.own[name] for name in "ab"])
    assert own.shape == (2, 3, 3, 3)
    assert np.all((own.min(0) <= found.together + 1e-12) & (found.together <= own.max(0) + 1e-12))
    assert np.all(np.diff(found.together, axis=0) > 0)
    drawn, said = several_table(found, MERL.names), several_words(found)
    assert drawn.row_count == 9
    assert "8 pieces in turn" in said


@pytest.mark.slow
def test_which_samples_the_best_models_and_stacks_them(file, tmp_path):
    shown = call("which", file, "--models", "two-scale,ggx,ward", "--posterior", "-o", tmp_path)
    assert shown.exit_code == 0
    assert "total integrated scatter (TIS): medians and 90 % intervals of posteriors" in shown.stdout
    assert "together" in shown.stdout
    assert "weights: of the mixture of posteriors" in shown.stdout
