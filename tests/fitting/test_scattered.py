"""Scattered directions of any number of wavelengths: cost and slopes, recovery, and the commands."""

import csv
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.commands.fit import aims_of
from merlfit.fitting.commands.metrics import samples_by_incidence
from merlfit.fitting.cost.accuracy import distance, reference_problem, resume_fit
from merlfit.fitting.fit import scattered_errors as assess
from merlfit.fitting.fit.problem import Arrangement, make_problem
from merlfit.fitting.fit.residuals import Objective, predict_samples
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import compressive_weight, cos_weighted_median, weighted_samples
from merlfit.fitting.pipeline.models import layout_for
from merlfit.fitting.pipeline.result import unread
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.posterior.coreset import edges_of
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.settings.choice import POINTS, REFERENCE
from merlfit.fitting.settings.config import load
from merlfit.merl_io import inputs
from merlfit.merl_io.bands import Bands
from merlfit.merl_io.binary import read
from merlfit.merl_io.scattered import ScatteredSamples, half_difference, scattered
from merlfit.model.geometry import Geometry
from merlfit.model.measured import Measured
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale

from tests import spectral
from tests.support import rgl_files
from tests.support.command import call
from tests.support.compiled import evaluate

FOUR = Bands(("420nm", "500nm", "600nm", "680nm"), (0.42, 0.5, 0.6, 0.68))
GLOSSY = {
    "alpha": 0.12, "F0": np.array([0.3, 0.45, 0.6, 0.7]), "albedo": np.array([0.02, 0.05, 0.1, 0.2]),
}  # fmt: skip


def table_of(path, model, truth, bands, each=120):
    angles = spectral.directions(each)
    values = spectral.values_of(model, truth, angles, bands.wavelengths_um)
    spectral.write_csv(path, angles, values, bands.names)
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    target = tmp_path_factory.mktemp("scattered") / "glossy.csv"
    model = GGX()
    where = spectral.geometry(spectral.directions(120))
    values = np.asarray(evaluate(model, GLOSSY, where, FOUR.wavelengths_um))
    spectral.write_csv(target, spectral.directions(120), values, FOUR.names)
    return target


def test_errors_by_incidence_are_those_of_the_samples_there():
    """Of samples at 10, 11 and 50 degrees, one of which is left out; together they are the RMSE over all."""
    theta_i, share = np.radians([10, 11, 50, 50, 50]), np.array([1.0, 3.0, 1.0, 2.0, 5.0])
    value, weight = np.zeros((4, 5)), np.ones((4, 5))
    weight[:, 4] = 0
    samples = ScatteredSamples(*[np.zeros(5)] * 2, np.cos(theta_i), np.ones(5), value, weight, share, FOUR)
    predicted = np.array([[1.0, 2.0, 3.0, 4.0, 1e9]] * 4)
    angles, found = samples_by_incidence(samples, predicted)
    near = share[:2] * np.cos(theta_i[:2])
    np.testing.assert_allclose(np.degrees(angles), [near @ [10, 11] / near.sum(), 50])
    np.testing.assert_allclose(found**2, [near @ [1, 4] / near.sum(), (9 + 2 * 16) / 3])
    whole = assess.errors(samples, predicted).rmse ** 2
    each = np.array([near.sum(), 3 * np.cos(theta_i[2])])
    assert each @ found**2 / each.sum() == pytest.approx(whole)


def test_weights_are_the_share_times_that_of_the_value(file):
    measured = inputs.read(file)
    measured = replace(measured, share=np.linspace(1, 2, len(measured.share)))
    samples = weighted_samples(measured)
    inside = np.maximum(measured.theta_i, measured.theta_o) <= 1.4
    assert samples.value.shape == (4, inside.sum())
    for plane, found, weight in zip(measured.values, samples.value, samples.weight, strict=True):
        median = cos_weighted_median(plane[inside], np.cos(measured.theta_i[inside]))
        expected = measured.share[inside] * compressive_weight(plane[inside], np.asarray(median))
        np.testing.assert_allclose(np.sort(weight), np.sort(expected))
        np.testing.assert_allclose(np.sort(found), np.sort(plane[inside]))


@pytest.mark.parametrize(("model", "columns"), [(Measured(TwoScale("none"), "off"), 12), (Measured(GGX()), 1)], ids=str)
def test_cost_and_slopes_are_those_of_the_model_at_each_direction(file, model, columns):
    """What the fit looks up in tables is what each direction computes for itself; slopes are those of the cost."""
    samples = weighted_samples(inputs.read(file))
    layout = layout_of(model, bands=FOUR)
    z = 0.3 * np.random.default_rng(1).standard_normal(layout.size)
    values = layout.values(jnp.asarray(z))
    objective = Objective(layout, make_problem(samples, columns=columns))
    where = Geometry(*(jnp.asarray(x) for x in (samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)))
    predicted = np.asarray(evaluate(model, values, where, FOUR.wavelengths_um))
    np.testing.assert_allclose(predict_samples(model, values, samples), predicted, rtol=2e-3, atol=1e-9)
    squares = samples.weight * (samples.value - predicted) ** 2
    expected = squares.sum(1) / np.sum(samples.weight * samples.value**2)
    normal = objective.normal_equations(z)
    np.testing.assert_allclose(normal[:, -1, -1], expected, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(objective.costs(values)), normal[:, -1, -1], rtol=1e-10)
    slope = -2 * normal.sum(0)[:-1, -1]
    for k in range(layout.size):
        step = 1e-4 * np.eye(layout.size)[k]
        high, low = (float(objective.costs(layout.values(jnp.asarray(z + s))).sum()) for s in (step, -step))
        assert slope[k] == pytest.approx((high - low) / 2e-4, rel=2e-3, abs=2e-5 * np.abs(slope).max())


def test_spectral_parameters_of_a_diffracting_metal_are_recovered_to_a_thousandth(tmp_path):
    """The smaller version of results/spectral.md: seven wavelengths, one kind of material."""
    um = spectral.WAVELENGTHS_UM[::5]
    truth = {**spectral.SURFACE, **spectral.metal(um)}
    bands = Bands(tuple(f"{round(1e3 * x)}nm" for x in um), tuple(um.tolist()))
    file = table_of(tmp_path / "metal.csv", TwoScale("none"), truth, bands)
    config = load({"effects": {"body": "none"}, "fit": {"starts": 2}, "posterior": {"enabled": False}})
    result = fit_file(file, tmp_path, config)
    assert result.fit.status == "CONVERGED"
    for name, error in spectral.errors(result, truth).items():
        assert error < 1e-3, name
    assert len(result.parameters) == 5 + 2 * 7
    assert [q.channel for q in result.parameters if q.parameter == "n"] == list(bands.names)
    assert result.model.bands == bands
    assert result.model.acquisition.grazing_loss == "off", "MERL's loss is none of another apparatus"
    wrong = {**truth, "b": 1.01 * truth["b"]}
    assert max(spectral.errors(result, wrong).values()) > 1e-3


def test_a_spectral_file_of_rgls_is_fitted(tmp_path):
    """Synthetic, of a known material; stored in float32, and the nodes are where RGL's method puts them."""
    where = rgl_files.parameterization(0.2, (0, 15, 30, 50, 70), resolution=32, nodes=12)
    um = np.array(FOUR.wavelengths_um)

    def brdf(*angles):
        return np.asarray(evaluate(GGX(), GLOSSY, spectral.geometry(np.degrees(np.stack(angles))), FOUR.wavelengths_um))

    file = rgl_files.write(tmp_path / "glossy_spec.bsdf", rgl_files.made(where, brdf, 1e3 * um))
    assert call("fit", file, "-o", tmp_path, "--model", "ggx", "--no-posterior").exit_code == 0
    path = tmp_path / "glossy_spec.json"
    result = read_result(path)
    for name, found in result.values().items():
        np.testing.assert_allclose(found, GLOSSY[name], rtol=1e-3, err_msg=name)
    assert result.source.format == "RGL"
    assert result.model.bands == FOUR
    assert result.model.acquisition.grazing_loss == "off"
    assert "of the values of the RGL file valid" in " ".join(call("inspect", path).stdout.split())
    assert (tmp_path / "glossy_spec.ggx.samples.png").stat().st_size > 10_000
    reported = call("report", tmp_path)
    assert reported.exit_code == 0
    assert "isolines of the file are interpolated between its samples" in " ".join(reported.stderr.split())


def test_wavelengths_that_are_not_fitted_are_told(file):
    measured = inputs.read(file)
    assert unread(measured) == []
    (said,) = unread(replace(measured, left_out=191))
    assert said.startswith("4 of the file's 195 wavelengths were fitted")


def test_a_sphere_of_samples_looks_like_that_of_the_right_model(tmp_path):
    """However coarse the table and sharp the lobe; a scan plane shows too little of a sphere."""
    theta_i, theta_o, phi = (
        x.ravel() for x in np.meshgrid(np.arange(0, 76, 15), np.arange(0, 80, 5), np.arange(0, 360, 15))
    )
    angles, sharp = np.stack([theta_i, theta_o, phi]).astype(float), {**GLOSSY, "alpha": 0.03}
    seen = np.asarray(evaluate(GGX(), sharp, spectral.geometry(angles), FOUR.wavelengths_um))
    spectral.write_csv(tmp_path / "all.csv", angles, seen, FOUR.names)
    samples = weighted_samples(inputs.read(tmp_path / "all.csv"))
    assert max(assess.pictures(samples, samples.value)) < 1e-6
    assert min(assess.pictures(samples, 1.5 * samples.value)) > 2
    flat = np.abs(np.sin(np.radians(phi))) < 0.1
    spectral.write_csv(tmp_path / "plane.csv", angles[:, flat], seen[:, flat], FOUR.names)
    plane = weighted_samples(inputs.read(tmp_path / "plane.csv"))
    assert np.all(np.isnan(assess.pictures(plane, plane.value)))


def test_samples_with_the_most_leverage_are_kept():
    shares = np.random.default_rng(0).pareto(1.2, 2000)
    shares /= shares.sum()
    edges = edges_of(shares, 288)
    kept = (edges[:-1] + edges[1:]) // 2
    heavy = np.flatnonzero(shares > 1 / 288)
    assert len(heavy) > 20
    assert set(heavy) <= set(kept)
    assert 250 < len(kept) < 330
    assert np.all(np.add.reduceat(shares, edges[:-1])[np.diff(edges) > 1] < 3 / 288)


def test_the_posterior_of_noisy_samples_holds_the_truth(tmp_path):
    """Noise of 3 %, independent: intervals are those of the errors of least squares, and go on from the chain."""
    angles = spectral.directions(250)
    values = np.asarray(evaluate(GGX(), GLOSSY, spectral.geometry(angles), FOUR.wavelengths_um))
    noisy = values * (1 + 0.03 * np.random.default_rng(5).standard_normal(values.shape))
    spectral.write_csv(tmp_path / "noisy.csv", angles, noisy, FOUR.names)
    assert call("fit", tmp_path / "noisy.csv", "-o", tmp_path, "--model", "ggx", "--seed", "1").exit_code == 0
    result = read_result(tmp_path / "noisy.json")
    assert result.posterior is not None
    assert result.posterior.sufficient, result.posterior.message
    assert result.posterior.effective_bins > 0.15 * values.size
    truth = [x for name in ("alpha", "F0", "albedo") for x in np.ravel(GLOSSY[name])]
    held = [q.quantiles.q05 <= x <= q.quantiles.q95 for q, x in zip(result.parameters, truth, strict=True)]
    assert sum(held) >= 6, result.parameters
    for q in result.parameters:
        widths = [x.q95 - x.q05 for x in (q.quantiles, q.laplace)]
        assert widths[0] == pytest.approx(widths[1], rel=0.25), q.name
    steps = result.posterior.steps
    assert call("sample", tmp_path / "noisy.json", "--max-steps", "10").exit_code == 0
    assert read_result(tmp_path / "noisy.json").posterior.steps >= steps


@pytest.mark.slow
def test_a_diffracting_metal_is_recovered_from_a_file_of_rgls(tmp_path):
    """Synthetic. b is what the little diffracted light says least of: its standard error is a thousandth."""
    um = spectral.WAVELENGTHS_UM[::5]
    truth = {**spectral.SURFACE, **spectral.metal(um)}
    where = rgl_files.parameterization(0.15, (0, 10, 20, 30, 45, 60, 70), resolution=64, nodes=16)

    def brdf(*angles):
        return spectral.values_of(TwoScale("none"), truth, np.degrees(np.stack(angles)), um)

    file = rgl_files.write(tmp_path / "metal.bsdf", rgl_files.made(where, brdf, 1e3 * um))
    config = load({"effects": {"body": "none"}, "posterior": {"enabled": False}})
    result = fit_file(file, tmp_path, config)
    assert result.fit.status == "CONVERGED"
    for name, error in spectral.errors(result, truth).items():
        assert error < (2e-3 if name == "b" else 1e-3), name


def test_the_commands_take_a_table(file, tmp_path):
    shown = call("check", file)
    assert shown.exit_code == 0
    assert "4: 420nm to 680nm" in " ".join(shown.stdout.split())
    words = ("fit", file, "-o", tmp_path, "--model", "ggx", "--no-posterior", "--resume")
    assert call(*words).exit_code == 0, call(*words).stderr
    path = tmp_path / "glossy.json"
    result = read_result(path)
    for name, found in result.values().items():
        np.testing.assert_allclose(found, GLOSSY[name], rtol=1e-3, err_msg=name)
    assert result.source.format == "table"
    assert result.source.dims is None
    assert result.model.colour_space == "none: a channel is a wavelength"
    assert result.metrics.highlight == pytest.approx(1, abs=1e-3)
    assert result.metrics.rmse < 1e-3
    assert "done already: 1 of 1 file, " in call(*words).stdout
    told = call("inspect", path)
    assert told.exit_code == 0, told.stderr
    assert "a table of scattered directions" in " ".join(told.stdout.split())
    assert "picture: CIELAB distance of lit pixels" in told.stdout
    assert (tmp_path / "glossy.ggx.samples.png").stat().st_size > 10_000
    assert call("table", tmp_path).exit_code == 0
    (row,) = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert float(row["picture"]) == pytest.approx(result.metrics.picture, rel=1e-2)
    assert float(row["F0_600nm"]) == pytest.approx(0.6, rel=1e-3)
    assert call("metrics", path, "--against", file, "-o", tmp_path / "metrics").exit_code == 0
    (_, *curve) = csv.reader((tmp_path / "metrics" / "by_incidence.csv").read_text().splitlines())
    assert len(curve) > 1
    assert all(0 <= float(angle) < 90 and float(error) < 1e-3 for angle, error in curve)
    assert call("synth", path, "-o", tmp_path / "seen.binary").exit_code == 0
    assert read(tmp_path / "seen.binary").valid.any()


def test_a_time_that_nothing_is_calibrated_for_is_refused_in_one_line(file, tmp_path):
    refused = call("fit", file, "-o", tmp_path, "--time", "20s")
    assert refused.exit_code == 2
    said = "holds scattered directions, and what settings take is calibrated on MERL's grid: leave --time out"
    assert said in " ".join(refused.stderr.split())


def test_files_without_a_grid_have_an_aim_of_their_own():
    """No calibration speaks of them: they begin with the cheapest last steps, and end with the reference's."""
    aims = aims_of(load(posterior=False), 1e-2, None, [Path("a.binary"), Path("b.csv")])
    assert aims[False].point is not None
    assert aims[True].point is None
    assert aims[True].choices == [*(q for q in POINTS if q.starts == REFERENCE.starts), REFERENCE]
    assert aims[True].settings.acquisition.grazing_loss == "off"
    assert aims_of(load(), None, None, [Path("b.csv")]) == {}


@pytest.mark.slow
def test_settings_are_found_on_the_samples_themselves(tmp_path):
    """The cheapest ones err by more than was asked for; those that were taken do not, measured from the reference."""
    um, asked = spectral.WAVELENGTHS_UM[::15], 1e-4
    bands = Bands(tuple(f"{round(1e3 * x)}nm" for x in um), tuple(um.tolist()))
    path, angles = tmp_path / "metal.csv", spectral.directions(350)
    values = spectral.values_of(TwoScale("none"), {**spectral.SURFACE, **spectral.metal(um)}, angles, um)
    noise = 0.03 * np.random.default_rng(0).standard_normal(values.shape)
    spectral.write_csv(path, angles, values * (1 + noise), bands.names)
    words = ("--body", "none", "--no-posterior", "--accuracy", asked)
    shown = call("fit", path, "-o", tmp_path, *words)
    assert shown.exit_code == 0, shown.stderr
    assert "each file's own samples decide (no calibration is of their directions)" in " ".join(shown.stdout.split())
    result = read_result(tmp_path / "metal.json")
    told = result.accuracy
    assert told.met
    assert told.expected is None
    assert [t.settings for t in told.tried] == [q for q in POINTS if q.starts == 8][: len(told.tried)]
    assert told.tried[0].estimated > asked >= told.tried[-1].estimated == told.estimated
    samples, config = weighted_samples(inputs.read(path)), load(body="none").for_scattered
    layout = layout_for(config, result.model.measured, bands)
    found = layout, layout.free(result.values())
    best = resume_fit(found, REFERENCE.settings(config), samples)
    away = distance(found, (best[0], best[1].z), reference_problem(samples))
    assert 0 < away < asked


def test_what_an_isotropic_material_cannot_tell_apart_is_one_sample(file):
    """Mirror images with noise of their own: their sum of squares is that of the means, and what they scatter by."""
    once, rng = inputs.read(file), np.random.default_rng(0)
    twice = {name: np.tile(getattr(once, name), 2) for name in ("theta_i", "theta_o", "phi", "share")}
    twice["phi"][len(once.phi) :] *= -1
    values = np.tile(once.values, 2) * rng.uniform(0.9, 1.1, (4, 2 * len(once.phi)))
    whole, weight = replace(once, **twice, values=values), rng.uniform(1, 2, values.shape)
    found = scattered(whole, values, weight, np.ones(values.shape, bool))
    alone = scattered(once, once.values, weight[:, : len(once.phi)], np.ones(once.values.shape, bool))
    assert len(found.theta_h) == len(alone.theta_h)
    assert np.sum(found.share) == pytest.approx(np.sum(whole.share))
    predicted, means = (np.exp(-half_difference(*x)[0]) for x in angles_of(whole, found))
    squares = np.sum(weight * (values - predicted) ** 2)
    assert np.sum(found.weight * (found.value - means) ** 2) + found.scatter == pytest.approx(squares, rel=1e-9)


def angles_of(measured, samples):
    """theta_i, theta_o and phi (rad) of a file, and of its samples."""
    theta_i, theta_o = np.arccos(samples.cos_i), np.arccos(samples.cos_o)
    between = np.cos(2 * samples.theta_d) - samples.cos_i * samples.cos_o
    phi = np.arccos(np.clip(between / np.maximum(np.sin(theta_i) * np.sin(theta_o), 1e-12), -1, 1))
    return (measured.theta_i, measured.theta_o, measured.phi), (theta_i, theta_o, phi)


def test_too_few_samples_are_no_data(tmp_path):
    target = tmp_path / "few.csv"
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,500nm\n" + "0,10,0,1\n" * 20)
    result = fit_file(target, tmp_path, load(model="ggx", posterior=False))
    assert result.fit.status == "NO_DATA"


def test_errors_alike_among_neighbours_count_once(file):
    """Residuals that are independent are worth their number, and those that are the same all over but a few."""
    samples = weighted_samples(inputs.read(file))
    samples = replace(samples, weight=np.ones_like(samples.weight))
    rng = np.random.default_rng(0)
    noise = samples.value - rng.standard_normal(samples.value.shape)
    smooth = samples.value - np.cos(2 * samples.theta_d) * np.ones((4, 1))
    independent, alike = (assess.effective_count(samples, x) for x in (noise, smooth))
    assert independent > samples.value.size / 4
    assert alike < 20


def test_the_width_of_the_highlight_is_read_off():
    samples = weighted_samples(_measured(lambda theta_h: np.exp(-np.log(2) * (np.tan(theta_h) / 0.1) ** 2) + 0.01))
    assert start_hints(samples).half_width == pytest.approx(0.1, rel=0.3)


def _measured(brdf):
    from merlfit.merl_io.scattered import ScatteredMeasurement, half_difference

    theta_i, theta_o, phi = np.radians(spectral.directions())
    values = brdf(half_difference(theta_i, theta_o, phi)[0])[None]
    return ScatteredMeasurement(
        Path("made"), "table", theta_i, theta_o, phi, values, np.ones(len(theta_i)), Bands(("500nm",), (0.5,)), "", ""
    )


@pytest.mark.parametrize("count", [1, 30, 1000, 70_001])
@pytest.mark.parametrize("columns", [1, 12])
def test_padding_is_a_quarter_at_the_most(count, columns):
    arranged = Arrangement.of(count, 31, columns)
    x = np.arange(float(count))
    split = arranged.split(x)
    assert split.shape == (arranged.blocks, arranged.height, columns, 1)
    assert split.size <= 1.3 * count + 12 * columns + 16
    np.testing.assert_array_equal(np.unique(split), x)
