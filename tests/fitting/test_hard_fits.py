"""Degenerate files and starts at the edge of every range: LM stays finite, and the status says what is wrong."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.results.schema import Quantiles
from merlfit.merl_io.samples import thin
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.hard_cases import fits
from tests.hard_cases import table as hard_table

pytestmark = pytest.mark.usefixtures("compiled_quickly")  # of few bins, or few effects
FILES = {file["name"]: file for file in hard_table.table()[2]}


@pytest.mark.parametrize("name", FILES)
def test_a_degenerate_file_ends_finite_and_says_what_is_wrong(name, compilation_cache):
    assert not fits.row(name).failures, fits.row(name)


def test_the_check_of_fits_sees_a_wrong_status_and_a_parameter_that_is_not_finite(compilation_cache, monkeypatch):
    file = FILES["constant file"]
    found = fits.fit(file)
    assert not fits.complaints(file, found)
    assert fits.complaints({**file, "status": ["NO_DATA"]}, found) == [f"status {found.fit.status}"]
    assert fits.complaints({**file, "near": 1e-2}, found)
    first, *rest = found.parameters
    beyond = Quantiles.model_construct(q05=0.0, q50=first.value, q95=float("nan"))
    for update in (
        {"value": float("nan")},
        {"value": first.upper + 1},
        {"laplace": beyond},
    ):
        spoiled = found.model_copy(update={"parameters": [first.model_copy(update=update), *rest]})
        assert fits.complaints(file, spoiled)
    assert "**" in fits.markdown([fits.Row("a file", "CONVERGED", "so", ["status CONVERGED"])])


# --- Starts at the edges, with everything that the model has

WHOLE = layout_of(Measured(TwoScale("none")))


@pytest.fixture(scope="module")
def coarse(compilation_cache):
    return thin(weighted_samples(fits.measurement(fits.material())), (10, 10, 45))


@pytest.fixture(scope="module")
def small(coarse):
    return make_problem(coarse)


OTHERS = {
    "conserving": layout_of(TwoScale("plastic", "lobe", split="conserving")),
    "free": layout_of(TwoScale("none", "lobe", split="free")),
    "subsurface, derived": layout_of(Measured(TwoScale("subsurface", "lobe"), "derived")),
}
MARKS = {**dict.fromkeys(OTHERS, ()), "conserving": pytest.mark.slow}  # seconds a step


def edges():
    """Free coordinates far out: all low, all high, corners, so far out that values are their bounds exactly."""
    size = WHOLE.size
    corners = np.sign(np.random.default_rng(3).normal(size=(4, size)))
    starts = {"low": -14 * np.ones(size), "high": 14 * np.ones(size), "beyond": -800 * np.ones(size)}
    starts |= {"beyond, high": 800 * np.ones(size), **{f"corner {i}": 14 * s for i, s in enumerate(corners)}}
    whole = [pytest.param(WHOLE, start, id=name) for name, start in starts.items()]
    return whole + [
        pytest.param(layout, sign * np.full(layout.size, 14.0), id=f"{name}, {side}", marks=MARKS[name])
        for name, layout in OTHERS.items()
        for side, sign in (("low", -1), ("high", 1))
        if name != "conserving" or side == "low"
    ]


@pytest.mark.parametrize(("layout", "start"), edges())
def test_a_start_at_the_edge_of_every_range_stays_finite(layout, start, small):
    objective = Objective(layout, small)
    first, found = solve(objective, start, 1), solve(objective, start, 12 if layout == WHOLE else 5)
    assert np.all(np.isfinite(found.z))
    assert np.all(np.isfinite(found.normal))
    assert np.isfinite(found.cost)
    assert found.objective <= first.objective * (1 + 1e-9)
    values = layout.values(jnp.asarray(found.z))
    for q in layout.parameters:
        assert np.all((np.asarray(values[q.name]) >= q.lower * (1 - 1e-12)) & (values[q.name] <= q.upper * (1 + 1e-12)))


@pytest.mark.parametrize("scale", [1e-308, 1e-300, 1e-200, 1e200])
def test_the_size_of_the_weights_does_not_matter(scale, small, coarse):
    """The unit of cost is the measurement's energy: all weights times a number are the same problem."""
    scaled = replace(coarse, weight=coarse.weight * scale, scatter=coarse.scatter * scale)
    tolerance = 1e-9 if scale > 1e-305 else 1e-6  # what is left of the digits of denormal numbers
    z = np.zeros(WHOLE.size)
    expected, found = solve(Objective(WHOLE, small), z, 6), solve(Objective(WHOLE, make_problem(scaled)), z, 6)
    np.testing.assert_allclose(found.cost, expected.cost, rtol=tolerance)
    np.testing.assert_allclose(found.z, expected.z, rtol=1e3 * tolerance, atol=tolerance)
    lopsided = replace(coarse, weight=coarse.weight * np.array([1.0, 2.0, 1.0])[:, None, None, None])
    assert solve(Objective(WHOLE, make_problem(lopsided)), z, 6).cost != pytest.approx(expected.cost, rel=1e-6)
