"""Uncertainties that a file states: weights that know of them, what a model errs by beside them, and intervals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from merlfit.fitting.fit import scattered_errors
from merlfit.fitting.fit.residuals import predict_samples
from merlfit.fitting.fit.weights import completed, found_error, weighted_samples
from merlfit.fitting.pipeline.comparison import on_same_weights
from merlfit.fitting.pipeline.result import overstated
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.choices import THETA_MAX
from merlfit.merl_io import inputs
from merlfit.merl_io.bands import Bands
from merlfit.model.rivals.ggx import GGX

from tests import spectral
from tests.support.command import call
from tests.support.compiled import evaluate

TWO = Bands(("450nm", "650nm"), (0.45, 0.65))
TRUTH = {"alpha": 0.12, "F0": np.array([0.3, 0.6]), "albedo": np.array([0.02, 0.1])}
FLAT = np.concatenate([np.ravel(x) for x in TRUTH.values()])
CONFIG = load(model="ggx", posterior=False).for_scattered


def made(seed=0, least=0.003, most=0.3, each=150):
    """A table as arrays: noise of `least` to `most` of the value, as drawn for each, and these uncertainties."""
    rng, angles = np.random.default_rng(seed), spectral.directions(each)
    clean = np.asarray(evaluate(GGX(), TRUTH, spectral.geometry(angles), TWO.wavelengths_um))
    sigma = clean * np.exp(rng.uniform(np.log(least), np.log(most), clean.shape))
    noisy = clean + sigma * rng.standard_normal(clean.shape)
    names = dict(zip(("theta_i_deg", "theta_o_deg", "phi_deg"), angles, strict=True))
    return {**names, "wavelengths_um": np.array(TWO.wavelengths_um), "values": noisy.T, "uncertainty": sigma.T}


def fitted_to(table):
    measured = inputs.read(table)
    return fit(measured, weighted_samples(measured), CONFIG)


def test_intervals_are_those_of_the_noise_that_the_file_states():
    """Independent noise: errors in units of the intervals are normal, and much larger without the column."""
    known, ignored = [], []
    for seed in range(6):
        table = made(seed)
        with_it, without = fitted_to(table), fitted_to({name: x for name, x in table.items() if name != "uncertainty"})
        known.append((with_it.values - FLAT) / with_it.standard_errors)
        ignored.append(np.abs(without.values - FLAT) / np.abs(with_it.values - FLAT))
        assert np.all(with_it.standard_errors < 0.3 * without.standard_errors)
        assert overstated(with_it, weighted_samples(inputs.read(table), model_error=with_it.model_error)) == []
    assert 0.6 < np.sqrt(np.mean(np.square(known))) < 1.4
    assert np.median(ignored) > 5


def test_the_error_of_a_model_is_found_beside_the_noise():
    """Residuals drawn with both, twice as many of them by repeats; their size alone is no such error."""
    measured = inputs.read(made(least=0.05, most=2.0))
    twice = {name: np.tile(getattr(measured, name), 2) for name in ("theta_i", "theta_o", "phi", "share")}
    twice |= {name: np.tile(getattr(measured, name), (1, 2)) for name in ("values", "uncertainty")}
    rng, error = np.random.default_rng(1), 0.02
    for each in (measured, replace(measured, **twice)):
        model_error = None
        for _ in range(5):
            samples = weighted_samples(each, model_error=model_error)
            variance = error**2 / _without_noise(samples) + samples.uncertainty**2
            predicted = samples.value + np.sqrt(variance) * np.random.default_rng(2).standard_normal(variance.shape)
            model_error = found_error(samples, predicted, 5)
        assert model_error == pytest.approx(error, rel=0.15)
        wrong = np.sqrt(np.mean(_without_noise(samples) * (samples.value - predicted) ** 2))
        assert wrong > 1.5 * error
    exact = samples.value + samples.uncertainty * rng.standard_normal(variance.shape)
    assert found_error(samples, exact, 5) < error / 3, "all of it is noise"


def _without_noise(samples):
    return 1 / (1 / samples.weight - (samples.uncertainty / samples.model_error) ** 2)


def test_weights_are_between_those_of_the_value_and_of_the_noise():
    """Where noise is all, whatever share of the measure the file gives a sample."""
    measured = inputs.read(made())
    plain = weighted_samples(replace(measured, uncertainty=None))
    np.testing.assert_allclose(weighted_samples(measured, model_error=1e3).weight, plain.weight, rtol=1e-3)
    found = weighted_samples(measured, model_error=1e-8)
    np.testing.assert_allclose(found.weight, (1e-8 / found.uncertainty) ** 2, rtol=1e-3)
    inside = np.maximum(measured.theta_i, measured.theta_o) <= THETA_MAX
    assert np.sum(found.uncertainty**-2) == pytest.approx(np.sum(measured.uncertainty[:, inside] ** -2.0))
    reweighed = replace(measured, share=np.full(len(measured.share), 7.0))
    np.testing.assert_allclose(weighted_samples(reweighed, model_error=1e-8).weight, found.weight, rtol=1e-9)


def test_what_is_not_stated_is_as_uncertain_as_the_rest():
    values, used = np.array([[1.0, 1.0, 1.0, 50.0], [2.0, 2.0, 2.0, 2.0]]), np.ones((2, 4), bool)
    stated = np.array([[0.1, 0.2, 0.3, np.nan], [np.nan] * 4])
    found = completed(stated, values, used)
    np.testing.assert_allclose(found, [[0.1, 0.2, 0.3, 10.0], [0.4] * 4])
    assert np.isnan(stated[0, 3]), "the file's own are not touched"


def test_residuals_count_as_no_more_than_repeated_directions_allow():
    """Of a fit that is nearer to few means than these are to the truth."""
    rng, angles = np.random.default_rng(3), np.tile(spectral.directions(10), 8)
    clean = np.full((2, angles.shape[1]), 0.5)
    names = dict(zip(("theta_i_deg", "theta_o_deg", "phi_deg"), angles, strict=True))
    noisy = clean + 0.05 * rng.standard_normal(clean.shape)
    samples = weighted_samples(inputs.read({**names, "wavelengths_um": [0.45, 0.65], "values": noisy.T}), 0.0)
    assert samples.repeatability == pytest.approx(0.05**2, rel=0.1)
    near = samples.value + 0.3 * (samples.value - 0.5)
    residual = np.sum(samples.weight * (samples.value - near) ** 2)
    assert scattered_errors.effective_count(samples, near) == pytest.approx(max(residual / samples.repeatability, 1))
    alone = scattered_errors.effective_count(replace(samples, repeatability=0.0), near)
    assert alone > 3 * scattered_errors.effective_count(samples, near)


def test_a_table_with_uncertainties_is_fitted_and_told(tmp_path):
    table, path = made(each=100), tmp_path / "plate.csv"
    names = ["theta_i_deg", "theta_o_deg", "phi_deg", *TWO.names, *(f"sigma_{name}" for name in TWO.names)]
    rows = np.column_stack([table[name] for name in (*names[:3], "values", "uncertainty")])
    text = [",".join(f"{x:.8g}" for x in row) for row in rows]
    text[0] = text[0].rsplit(",", 1)[0] + ","
    path.write_text("\n".join([",".join(names), *text]))
    assert call("fit", path, "-o", tmp_path, "--model", "ggx", "--no-posterior").exit_code == 0
    result = read_result(tmp_path / "plate.json")
    assert 0.99 < result.source.fraction_uncertain < 1
    assert result.fit.model_error > 0
    told = " ".join(call("inspect", tmp_path / "plate.json", "--pictures", "none").stdout.split())
    assert "uncertainties: given by the file for 9" in told
    samples = weighted_samples(inputs.read(path), result.fit.weights, THETA_MAX, result.fit.model_error)
    predicted = predict_samples(result.model.measured, result.values(), samples)
    assert scattered_errors.effective_count(samples, predicted) == pytest.approx(result.fit.effective_bins, rel=1e-3)
    fit_part = {"model_error": 3 * result.fit.model_error, "cost": 0.5}  # as of another model, with weights of its own
    other = result.model_copy(update={"fit": result.fit.model_copy(update=fit_part)})
    same = on_same_weights({"one": result, "other": other}, inputs.read(path), CONFIG)
    assert same["other"].fit.cost == same["one"].fit.cost == pytest.approx(result.fit.cost, rel=1e-3)
    expanded = inputs.read({**table, "uncertainty": 3 * table["uncertainty"]})
    doubtful = fit(expanded, weighted_samples(expanded), CONFIG)
    (line,) = overstated(doubtful, weighted_samples(expanded, model_error=doubtful.model_error))
    assert re.search(r"uncertainties are 3(\.\d)? times as large as the residuals: are they expanded", line)
