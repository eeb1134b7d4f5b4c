"""Any number of bands: objective, starting points, fit, result and prediction know of no three channels."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.starts import start_hints, starting_points
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.fitting.results import schema
from merlfit.merl_io.bands import MERL, Bands
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.measured import Measured
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale

from tests.support.plain_jacobian import difference, plain

FIVE = Bands(("violet", "blue", "green", "orange", "red"), (0.42, 0.47, 0.53, 0.6, 0.66))
ONE = Bands(("green",), (0.532,))
pytestmark = pytest.mark.usefixtures("compiled_quickly")


def samples_of(model, bands, seed=0):
    """Synthetic ones of the model itself, and the free coordinates that they were made of."""
    layout, grid = layout_of(model, bands=bands), merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((len(bands), 1, 1, 1))
    blank = replace(thin(fold(grid, np.ones_like(weight), weight), (6, 9, 30)), bands=bands)
    z = 0.4 * np.random.default_rng(seed).standard_normal(layout.size)
    value = predict_samples(layout, z, blank)
    assert value.shape[0] == len(bands)
    return layout, replace(blank, value=value, weight=blank.weight / np.maximum(value, 1e-3)), z


@pytest.mark.parametrize(
    ("model", "bands"),
    [
        (Measured(GGX()), ONE), (Measured(GGX()), FIVE),
        (Measured(TwoScale("plastic", "lobe")), FIVE), (Measured(TwoScale("none", "lobe"), "derived"), ONE),
    ],
    ids=str,
)  # fmt: skip
def test_normal_equations_of_any_number_of_bands(model, bands):
    layout, samples, z = samples_of(model, bands)
    away = jnp.asarray(z + 0.1)
    found = Objective(layout, make_problem(samples)).normal_equations(away)
    assert found.shape == (len(bands), layout.size + 1, layout.size + 1)
    assert difference(found, plain(layout, away, samples)) < 1e-11


@pytest.mark.parametrize("bands", [ONE, FIVE], ids=len)
def test_a_fit_of_any_number_of_bands_finds_what_the_data_were_made_of(bands):
    layout, samples, z = samples_of(Measured(GGX()), bands)
    objective = Objective(layout, make_problem(samples))
    starts = starting_points([layout], start_hints(samples), objective.problem, 4)[0]
    best = min((solve(objective, start) for start in starts), key=lambda s: s.cost)
    np.testing.assert_allclose(layout.flat(jnp.asarray(best.z)), layout.flat(jnp.asarray(z)), rtol=1e-4)


def test_wavelengths_of_the_data_are_those_of_the_model():
    """Diffraction: the same numbers at other wavelengths are another BRDF."""
    model = Measured(TwoScale("none", "lobe"))
    _, samples, z = samples_of(model, FIVE)
    shifted = replace(FIVE, wavelengths_um=tuple(1.2 * x for x in FIVE.wavelengths_um))
    there = predict_samples(layout_of(model, bands=shifted), z, replace(samples, bands=shifted))
    assert not np.allclose(there, samples.value, rtol=0.05)


def test_a_result_has_the_bands_of_its_data():
    layout, _, z = samples_of(Measured(GGX()), FIVE)
    told = schema.Model.of(layout.model, layout.values(jnp.asarray(z)), layout.bands)
    again = schema.Model.model_validate_json(told.model_dump_json())
    assert again.bands == FIVE


def test_merls_bands_are_those_that_the_models_assume():
    assert MERL.wavelengths_um == WAVELENGTHS_UM


@pytest.mark.parametrize(
    ("names", "wavelengths"), [((), ()), (("R", "R"), (0.6, 0.5)), (("R",), (0.6, 0.5)), (("R",), (-1.0,))]
)
def test_what_are_no_bands_is_refused(names, wavelengths):
    with pytest.raises(ValueError, match=r"bands need|as many wavelengths|must be positive"):
        Bands(names, wavelengths)
