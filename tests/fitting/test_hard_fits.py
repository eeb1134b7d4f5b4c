"""Degenerate files and starts at the edge of every range: LM stays finite, and the status says what is wrong."""

from dataclasses import replace
from functools import cache

import hard_table
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting import run
from merlfit.fitting.config import parse
from merlfit.fitting.levenberg_marquardt import Status, solve
from merlfit.fitting.outcome import make_result
from merlfit.fitting.residuals import make_problem, weighted_samples
from merlfit.fitting.transforms import layout_of
from merlfit.merl_io.binary import MerlError, read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import thin
from merlfit.model.effects import Effects
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import two_scale

FILES = hard_table.table()[2]
TRUTH = {"beta": 0.15, "p": 0.7, "eta": np.array([1.4, 1.5, 1.6]), "albedo": np.array([0.5, 0.2, 0.05])}
CONFIG = parse(
    {
        "effects": {"preset": "microfacet", "body": "lambert"},
        "fit": {"starts": 1, "coarse_steps": 30, "max_steps": 20},
        "posterior": {"enabled": False},
    },
    "tests",
)


@pytest.fixture(scope="module")
def material(compilation_cache):
    """A known material in every bin, (3, 90, 90, 180); NaN below the horizon."""
    grid = merl_grid()
    g = Geometry.from_half_difference(*np.ix_(grid.theta_h, grid.theta_d, grid.phi_d))
    values = jax.jit(lambda g: two_scale(TRUTH, g, Effects("lambert", "off")))(g)
    return np.where(grid.above, np.asarray(values), np.nan)


def measurement(values, folder):
    """Written as a MERL file and read again."""
    write(folder / "hard.binary", values)
    return read(folder / "hard.binary")


def degenerate(file, material):
    """What an entry of the table puts into the bins."""
    values = material if file["fill"] == "material" else np.where(np.isfinite(material), float(file["fill"]), np.nan)
    values = values * file.get("factor", 1.0)
    values[:, 2, 10, 90] *= file.get("outlier", 1.0)
    if valid := file.get("valid", 0):
        bins = np.flatnonzero(np.isfinite(values[0]).ravel())[:: values[0].size // 200][:valid]
        kept = np.isin(np.arange(values[0].size), bins).reshape(values[0].shape)
        values = np.where(kept, values, np.nan)
    return values


def check_fit(result, statuses):
    """Only finite parameters within their bounds, and a status that is one of those, with its sentence."""
    status = Status[result.fit.status]
    assert status.name in statuses
    assert result.fit.message == status.value
    assert result.fit.succeeded == status.succeeded
    for q in result.parameters:
        assert np.isfinite(q.value)
        assert q.lower <= q.value <= q.upper
        assert q.standard_error is None or np.isfinite(q.standard_error)
    assert bool(result.parameters) == (status not in (Status.NO_DATA, Status.NON_FINITE))
    assert result.fit.cost is None or np.isfinite(result.fit.cost)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hard")


@pytest.fixture(scope="module")
def fit(material, folder):
    """Each file fitted once, by name."""

    @cache
    def fit(name):
        m = measurement(degenerate(next(file for file in FILES if file["name"] == name), material), folder)
        samples = weighted_samples(m)
        fitted = run.fit(m, samples, CONFIG, lambda _: None, run._Clock())
        return make_result(m, samples, fitted, None, CONFIG, {})

    return fit


@pytest.mark.parametrize("file", FILES, ids=lambda file: file["name"])
def test_a_degenerate_file_ends_finite_and_says_what_is_wrong(file, fit):
    if "refused" in file:
        with pytest.raises(MerlError, match=file["refused"]):
            fit(file["name"])
        return
    found = fit(file["name"])
    check_fit(found, file["status"])
    if "near" in file:  # of the known material's parameters, relative
        for name, truth in TRUTH.items():
            np.testing.assert_allclose(found.values()[name], truth, rtol=file["near"], err_msg=name)


def test_the_check_of_fits_sees_a_wrong_status_and_a_parameter_that_is_not_finite(fit):
    found = fit("constant file")
    with pytest.raises(AssertionError):
        check_fit(found, ["NO_DATA"])
    spoiled = found.parameters[0].model_copy(update={"value": float("nan")})
    with pytest.raises(AssertionError):
        check_fit(found.model_copy(update={"parameters": [spoiled, *found.parameters[1:]]}), [found.fit.status])


# --- Starts at the edges, with everything that the model has

WHOLE = Effects("none", acquisition="free")


@pytest.fixture(scope="module")
def coarse(material, folder):
    return thin(weighted_samples(measurement(material, folder)), (10, 10, 45))


@pytest.fixture(scope="module")
def small(coarse):
    return make_problem(coarse)


OTHERS = {
    "conserving": Effects("plastic", "lobe", split="conserving"),
    "zonal": Effects(diffraction="zonal", zonal_order=25),
    "scaled": Effects(diffraction="scaled", order=8),
    "subsurface, derived": Effects("subsurface", "lobe", acquisition="derived"),
}


def edges():
    """Free coordinates far out: all low, all high, corners, so far out that the logistic function is 0 or 1."""
    size = layout_of(WHOLE).size
    corners = np.sign(np.random.default_rng(3).normal(size=(4, size)))
    starts = {"low": -14 * np.ones(size), "high": 14 * np.ones(size), "beyond": -800 * np.ones(size)}
    starts |= {"beyond, high": 800 * np.ones(size), **{f"corner {i}": 14 * s for i, s in enumerate(corners)}}
    whole = [pytest.param(WHOLE, start, id=name) for name, start in starts.items()]
    return whole + [
        pytest.param(effects, sign * np.full(layout_of(effects).size, 14.0), id=f"{name}, {side}")
        for name, effects in OTHERS.items()
        for side, sign in (("low", -1), ("high", 1))
        if name != "conserving" or side == "low"  # seconds a step
    ]


@pytest.mark.parametrize(("effects", "start"), edges())
def test_a_start_at_the_edge_of_every_range_stays_finite(effects, start, small, table):
    first, found = solve(effects, start, small, 1), solve(effects, start, small, 12 if effects == WHOLE else 5)
    assert np.all(np.isfinite(found.z))
    assert np.all(np.isfinite(found.normal))
    assert np.isfinite(found.cost)
    assert found.cost <= first.cost * (1 + 1e-9)
    values = layout_of(effects).values(jnp.asarray(found.z))
    for q in layout_of(effects).parameters:
        assert np.all((np.asarray(values[q.name]) >= q.lower * (1 - 1e-12)) & (values[q.name] <= q.upper * (1 + 1e-12)))


@pytest.mark.parametrize("scale", [1e-308, 1e-300, 1e-200, 1e200])
def test_the_size_of_the_weights_does_not_matter(scale, small, coarse):
    """The unit of cost is the measurement's energy: all weights times a number are the same problem."""
    scaled = replace(coarse, weight=coarse.weight * scale, scatter=coarse.scatter * scale)
    tolerance = 1e-9 if scale > 1e-305 else 1e-6  # what is left of the digits of denormal numbers
    z = np.zeros(layout_of(WHOLE).size)
    expected, found = solve(WHOLE, z, small, 6), solve(WHOLE, z, make_problem(scaled), 6)
    np.testing.assert_allclose(found.cost, expected.cost, rtol=tolerance)
    np.testing.assert_allclose(found.z, expected.z, rtol=1e3 * tolerance, atol=tolerance)
    lopsided = replace(coarse, weight=coarse.weight * np.array([1.0, 2.0, 1.0])[:, None, None, None])
    assert solve(WHOLE, z, make_problem(lopsided), 6).cost != pytest.approx(expected.cost, rel=1e-6)
