"""The objective of fits: all kinds by one program, blocks, threads and solvers alike, directions that are left out."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit import problem as problems
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit.levenberg_marquardt import Status, solve
from merlfit.fitting.fit.outcome import Fitted
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective, compact_normal_equations, spread_out
from merlfit.fitting.fit.starts import start_hints, starting_points
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import search
from merlfit.merl_io.binary import Measurement, read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import thin
from merlfit.model.effects import KINDS
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.support.known_materials import CONDUCTOR, EXPONENTS, tabulate
from tests.support.plain_jacobian import difference, plain

FREE = layout_of(Measured(TwoScale("none")))
LOBE = layout_of(Measured(TwoScale("none", "lobe")))  # half the time to compile
pytestmark = pytest.mark.usefixtures("compiled_quickly")


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    file = tmp_path_factory.mktemp("synthetic") / "conductor.binary"
    write(file, tabulate(CONDUCTOR, TwoScale("none")))
    samples = weighted_samples(read(file))
    return samples, make_problem(thin(samples, (10, 10, 45)))


@pytest.mark.slow
def test_normal_equations_are_those_of_the_plain_jacobian(coarse):
    """Rows of three azimuths and as many nodes: nothing is gathered but the bins themselves."""
    samples = thin(coarse[0], (search.COARSE[0], 5, 30))
    problem = make_problem(samples)
    others = [Measured(TwoScale("plastic"), "derived"), Measured(TwoScale("lambert", order=8), 0.3)]
    for layout in (FREE, *map(layout_of, [*others, TwoScale("lambert", "off", split="conserving")])):
        z = jnp.asarray(np.random.default_rng(1).normal(size=layout.size))
        expected, found = plain(layout, z, samples), np.asarray(Objective(layout, problem).normal_equations(z))
        assert difference(found, expected) < 1e-9
        alone = np.asarray(Objective(layout, problem).costs(layout.values(z)))
        np.testing.assert_allclose(alone, found[:, -1, -1], rtol=1e-10)


@pytest.mark.slow
def test_gathered_azimuths_have_the_normal_equations_of_all_bins(coarse):
    samples = thin(coarse[0], (10, 10, 1))
    other = Measured(TwoScale("subsurface", "lobe", masking="height_correlated"))
    for layout in (FREE, layout_of(other)):
        z = jnp.asarray(np.random.default_rng(2).normal(size=layout.size))
        expected = plain(layout, z, samples)
        few, many = (np.asarray(Objective(layout, make_problem(samples, k)).normal_equations(z)) for k in (2, 8))
        assert difference(many, expected) < 1e-3
        assert difference(few, expected) > 10 * difference(many, expected)


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_the_program_of_all_kinds_has_the_normal_equations_of_each(coarse, kind):
    """A dielectric as a conductor with k = 0, a body chosen when the program runs, albedo 0 for none."""
    problem = make_problem(thin(coarse[0], search.CANDIDATES), 2)
    layout = search.cheaper(layout_of(Measured(TwoScale(kind[1], index=kind[0]))), 8)
    z = jnp.asarray(np.random.default_rng(3).normal(size=layout.size))
    values, slopes = layout.values_and_slopes(z)
    alone = sum(np.asarray(compact_normal_equations(layout.model, values, part)) for part in problem.parts)
    expected = spread_out(layout, np.asarray(slopes), alone, np.asarray(problem.rest))
    assert difference(Objective(layout, problem).normal_equations(z), expected) < 1e-12


def test_blocks_and_threads_do_not_change_the_sum(coarse, monkeypatch):
    thinned = thin(coarse[0], (5, 5, 1))
    problem = make_problem(thinned)
    z = jnp.asarray(starting_points([LOBE], start_hints(coarse[0]), problem, 1)[0][0])
    assert len(problem.parts) == 1
    assert problem.parts[0].target.shape[0] == 1
    monkeypatch.setattr(problems, "BLOCK", 700)
    monkeypatch.setattr(problems, "LEAST_SHARE", 700)
    monkeypatch.setattr(problems, "SHARES", 2)
    blocked = make_problem(thinned)
    assert len(blocked.parts) == 2
    assert blocked.parts[0].target.shape[0] > 1
    ours, whole = (Objective(LOBE, q).normal_equations(z) for q in (blocked, problem))
    np.testing.assert_allclose(ours, whole, rtol=1e-9, atol=1e-15)


def test_solvers_of_three_libraries_agree(coarse):
    start = LOBE.free({**CONDUCTOR, **EXPONENTS}) + 0.1
    objective = Objective(LOBE, coarse[1])
    ours, minpack, jaxopt = (solve(objective, start, 60, 1e-7, b) for b in ("trust-region", "scipy", "jaxopt"))
    assert ours.cost < solve(objective, start, 1).cost / 10
    for other in (minpack, jaxopt):
        assert other.cost == pytest.approx(ours.cost, rel=5e-3)
        np.testing.assert_allclose(other.z, ours.z, atol=0.05)


def test_data_below_the_horizon_are_left_out():
    """A file filled everywhere: bins cut by the horizon have a weight, and a model of 0 that no logarithm likes."""
    grid = merl_grid()
    full = Measurement(Path("full"), np.ones((3, *grid.above.shape)), np.ones_like(grid.above), 0, 0, 0, "", "")
    samples = weighted_samples(full)
    assert not np.any(samples.weight[:, ~grid.above[..., :90]])
    problem = make_problem(thin(samples, (1, 3, 10)))
    for grazing_loss in ("free", 0.0):
        layout = layout_of(Measured(TwoScale("lambert", "off"), grazing_loss))
        assert np.all(np.isfinite(Objective(layout, problem).normal_equations(jnp.zeros(layout.size))))


def test_equations_that_are_not_finite_are_a_failure(coarse):
    problem = coarse[1]
    spoiled = eqx.tree_at(lambda q: q.parts[0].directions.log_base, problem, replace_fn=lambda x: x - jnp.inf)
    solution = solve(Objective(LOBE, spoiled), np.zeros(LOBE.size))
    assert not solution.converged
    assert np.isnan(solution.cost)
    fitted = Fitted(LOBE, solution, np.full(3, np.nan), None, Errors(*(0.0,) * 6), [])
    assert fitted.status is Status.NON_FINITE
