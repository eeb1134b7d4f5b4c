"""Total integrated scatter: of directions against closed forms, of bins and of a fit against the model's integral."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit.levenberg_marquardt import Solution
from merlfit.fitting.fit.outcome import Fitted
from merlfit.fitting.fit.total_scatter import (
    AT_ONCE,
    COUNT,
    USUAL,
    WIDTH,
    incidences_of,
    of_file,
    of_values,
    solid_angles,
    with_slopes,
)
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.result import total_scatter_results
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.merl_io.bands import MERL, Bands
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.scattered import ScatteredMeasurement
from merlfit.model.measured import Measured
from merlfit.model.reflectance import evaluate
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale

from tests.support.compiled import directional_albedo
from tests.support.stand_ins import uncorrelated

GGX = models()["ggx"]()
TRUTH = {"alpha": 0.2, "F0": np.array([0.05, 0.5, 0.2]), "albedo": np.array([0.2, 0.1, 0.05])}
ONE = Bands(("650nm",), (0.65,))


def all_over(incidences, count=400):
    """Directions of viewers of every incidence (rad) all over the hemisphere: theta_i, theta_o, phi."""
    k = np.arange(count) + 0.5
    theta_o, phi = np.arccos(1 - k / count), np.pi * (3 - np.sqrt(5)) * k
    return np.repeat(incidences, count), np.tile(theta_o, len(incidences)), np.tile(phi, len(incidences))


def scattered(angles, values, **more):
    return ScatteredMeasurement(
        Path("x.csv"), "table", *angles, np.atleast_2d(values), np.ones(angles[0].size), ONE, "", "", **more
    )


def test_cells_of_directions_are_all_of_the_hemisphere():
    _, theta_o, phi = all_over([0.0])
    cells = solid_angles(theta_o, phi)
    assert cells.sum() == pytest.approx(2 * np.pi, rel=1e-9)
    assert cells @ np.cos(theta_o) == pytest.approx(np.pi, rel=2e-3)
    # the eight octants of a sphere: the normal has as much as three directions at the horizon have above it
    found = solid_angles(np.array([0.0, np.pi / 2, np.pi / 2, np.pi / 2]), np.array([0.0, 0.0, np.pi / 2, np.pi]))
    np.testing.assert_allclose(found, np.array([2, 1, 2, 1]) * np.pi / 3, rtol=1e-6)
    twice = solid_angles(*(np.concatenate([x, x[:1]]) for x in (theta_o, phi)))
    assert twice[0] == pytest.approx(cells[0] / 2) == twice[-1]


def test_a_list_of_directions_gives_back_what_was_put_in():
    """Of a matte white its albedo; without the cosine, as one maker's files state it, twice as much."""
    angles = all_over(np.radians([10.0, 45.0]))
    measured = scattered(angles, np.full(angles[0].size, 0.3 / np.pi))
    np.testing.assert_allclose(of_file(measured, incidences_of(measured)), [[0.3, 0.3]], rtol=2e-3)
    scan = np.full(100, np.radians(10.0)), np.linspace(0, 1.5, 100), np.pi * (np.arange(100) % 2)
    assert np.isnan(of_file(scattered(scan, np.ones(100)), np.radians([10.0]))).all(), "a plane is no hemisphere"
    half = replace(measured, solid_angle=np.full(angles[0].size, np.pi / 400))
    np.testing.assert_allclose(of_file(half, np.radians([10.0])), [[0.15]], rtol=2e-3)


def test_incidences_are_the_files_own_as_far_as_there_are_a_few():
    many = scattered(all_over(np.radians(np.arange(0.0, 90.0, 5.0)), 20), np.ones(360))
    np.testing.assert_allclose(np.degrees(incidences_of(many)), [0, 25, 55, 80])
    rng = np.random.default_rng(0)
    assert incidences_of(scattered(rng.uniform(0, 1, (3, 50)), np.ones(50))) is USUAL


def test_bins_have_the_integral_of_the_model():
    values = tabulate(lambda g: evaluate(GGX, TRUTH, g))
    measured = Measurement(Path("x.binary"), values, np.isfinite(values).all(0), 0, 0, 0, "", "")
    expected = np.asarray(directional_albedo(GGX, TRUTH, USUAL))
    np.testing.assert_allclose(of_file(measured, USUAL), expected, rtol=0.01)


def test_sets_of_parameters_have_the_integrals_of_their_models():
    """Of dielectrics, whose program is that of all kinds; more sets than one call takes."""
    material, count = TwoScale("lambert"), AT_ONCE + 1
    values = {
        "beta": np.linspace(0.1, 0.4, count), "p": np.full(count, 0.8), "b": np.full(count, 3.0),
        "c": np.full(count, 2.0), "sigma_s": np.full(count, 0.03), "eta": np.full((count, 3), 1.5),
        "albedo": np.tile([0.1, 0.3, 0.6], (count, 1)),
    }  # fmt: skip
    theta_i = np.radians(np.linspace(10.0, 60.0, WIDTH + 1))
    found = of_values(material, values, MERL, theta_i)
    assert found.shape == (count, 3, WIDTH + 1)
    for k in (0, count - 1):
        own = {name: jnp.asarray(x[k]) for name, x in values.items()}
        np.testing.assert_allclose(found[k], directional_albedo(material, own, theta_i), rtol=1e-6)


def test_slopes_are_those_of_the_integral():
    """Of a dielectric, whose program is that of all kinds: what a channel's own parameters and shared ones do to it."""
    material = TwoScale("lambert")
    values = {
        "beta": 0.15, "p": 0.8, "b": 3.0, "c": 2.0, "sigma_s": 0.03, "eta": np.full(3, 1.5),
        "albedo": np.array([0.1, 0.3, 0.6]),
    }  # fmt: skip
    theta_i = np.radians([10.0, 60.0])
    found, slopes = with_slopes(material, values, MERL, theta_i)
    np.testing.assert_allclose(found, directional_albedo(material, values, theta_i), rtol=1e-6)
    assert slopes.keys() == values.keys()
    for name in values:
        own = {q: jnp.asarray(x, float) for q, x in values.items()}
        still = {q: jnp.full_like(x, q == name) for q, x in own.items()}
        _, true = jax.jvp(lambda v: directional_albedo(material, v, theta_i), (own,), (still,))
        np.testing.assert_allclose(slopes[name], true, rtol=1e-4, atol=3e-4, err_msg=name)  # order 12


def test_slopes_at_bounds_and_of_tiny_parameters_are_those_of_the_integral():
    """The coefficients of optical scatter are far below one; an albedo may be nothing, or all."""
    theta_i, where = np.radians([30.0]), np.array([1e-6, 1e-8, 1e-10])
    abg = models()["abg"]()
    values = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in abg.parameters}
    values |= {"B": where} if next(q for q in abg.parameters if q.name == "B").per_channel else {"B": 1e-8}
    _, slopes = with_slopes(abg, values, MERL, theta_i)
    own = {q: jnp.asarray(x, float) for q, x in values.items()}
    still = {q: jnp.full_like(x, q == "B") for q, x in own.items()}
    _, true = jax.jvp(lambda v: directional_albedo(abg, v, theta_i), (own,), (still,))
    np.testing.assert_allclose(slopes["B"], true, rtol=1e-4)
    bounds = {**TRUTH, "albedo": np.array([0.0, 0.5, 1.0])}
    _, slopes = with_slopes(GGX, bounds, MERL, theta_i)
    np.testing.assert_allclose(slopes["albedo"], 1, rtol=0.01)


def test_an_interval_holds_what_draws_of_the_approximation_hold():
    layout = layout_of(Measured(GGX, "off"))
    z = layout.free(TRUTH)
    normal = np.tile(np.diag([*np.full(len(z), 1.0), 0.003]), (3, 1, 1))
    solution = Solution(z, 0.01, normal, 9, 1e-4, converged=True)
    noise = uncorrelated(normal, 0.01, 2.0)
    fitted = Fitted(layout, solution, np.full(3, 0.003), noise, Errors(*(0.1,) * 6), [])
    theta_i = np.radians([5.0, 70.0])
    at_fit, ends = fitted.total_scatter(theta_i)
    spread = 1 / np.sqrt(1 + 2.0 * 3 / 0.01)  # of every free coordinate
    draws = z + spread * np.random.default_rng(1).standard_normal((1500, len(z)))
    scatter = of_values(layout.material, layout.values(draws), MERL, theta_i)
    np.testing.assert_allclose(ends, np.quantile(scatter, [0.05, 0.95], axis=0), rtol=0.01)
    loose = replace(fitted, noise=uncorrelated(1e-4 * normal, 0.01, 2.0))
    assert np.isnan(loose.total_scatter(theta_i)[1]).all(), "where the prior says more than the data"
    assert at_fit.shape == (3, 2)


def test_a_result_lists_fit_file_and_what_the_file_states():
    theta_i, channels = np.radians([10.0, 45.0]), ("650nm",)
    at_fit, ends = np.array([[0.31, 0.33]]), np.array([[[0.29, np.nan]], [[0.33, np.nan]]])
    fitted = SimpleNamespace(total_scatter=lambda _: (at_fit, ends), layout=SimpleNamespace(channels=channels))
    measured = scattered(all_over(theta_i), np.full(800, 0.3 / np.pi), stated_tis=((np.radians(45.0), 0.2),))
    first, second = total_scatter_results(fitted, measured, None)
    assert (first.theta_i_deg, first.channel, first.value, first.stated) == (10.0, "650nm", 0.31, None)
    assert (first.laplace.q05, first.laplace.q95) == (0.29, 0.33)
    assert first.file == pytest.approx(0.3, rel=2e-3)
    assert (second.laplace, second.stated) == (None, 0.2)
    assert len(theta_i) <= COUNT
    drawn = np.linspace(0.2, 0.4, 101)[:, None, None] * np.array([1.0, 2.0])
    fitted.scatter_at = lambda *_: drawn
    posterior = SimpleNamespace(sufficient=True, draws=np.zeros((101, 1)), weights=np.full(101, 1 / 101))
    found = total_scatter_results(fitted, measured, SimpleNamespace(posterior=posterior))
    np.testing.assert_allclose([q.quantiles.q50 for q in found], [0.3, 0.6], rtol=0.01)
    assert found[0].quantiles.q05 == pytest.approx(0.21, rel=0.01)
