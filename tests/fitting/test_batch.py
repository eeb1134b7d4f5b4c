"""A batch of materials ends where each of them ends by itself."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import run
from merlfit.fitting.settings.config import parse
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import thin
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.bench.stacked import fit_batch, prepare, solve_batch

pytestmark = pytest.mark.usefixtures("compiled_quickly")
LAYOUT = layout_of(Measured(TwoScale("lambert", "off")))


def measured(seed):
    """Synthetic: a random material of the model itself, 5 % of noise; the free coordinates it was made of."""
    grid, rng = merl_grid(), np.random.default_rng(seed)
    blank = Measurement(Path("synthetic"), np.ones((3, *grid.above.shape)), grid.above, 0, 0, 0, "", "")
    z = rng.normal(size=LAYOUT.size) / 2
    half = run.predict_samples(LAYOUT, z, weighted_samples(blank))
    values = np.concatenate([half, half[..., ::-1]], -1)
    values = values * np.exp(0.05 * rng.normal(size=values.shape))
    return dataclasses.replace(blank, values=np.where(grid.above, values, 0.0)), z


@pytest.fixture(scope="module")
def three():
    """Problems of three materials and starting points: near the truth, farther, far from it."""
    made = [measured(seed) for seed in (1, 2, 3)]
    problems = [make_problem(thin(weighted_samples(m), (10, 10, 18))) for m, _ in made]
    return problems, np.array([z + away for (_, z), away in zip(made, (0.01, 0.3, 1.0), strict=True)])


def test_each_ends_where_it_ends_by_itself(three):
    problems, starts = three
    together = solve_batch(LAYOUT, starts, problems, 60)
    alone = [solve(Objective(LAYOUT, q), z, 60) for z, q in zip(starts, problems, strict=True)]
    for one, other in zip(together, alone, strict=True):
        assert one.cost == pytest.approx(other.cost, rel=1e-6)
        np.testing.assert_allclose(one.z, other.z, atol=1e-5)
        np.testing.assert_allclose(one.normal, other.normal, rtol=1e-5, atol=1e-9)
        assert (one.steps, one.converged) == (other.steps, other.converged)
        assert one.offset == pytest.approx(other.offset, abs=1e-5)
    assert len({s.steps for s in together}) > 1


def test_a_finished_one_stays_put(three):
    problems, starts = three
    whole = solve_batch(LAYOUT, starts, problems, 60)
    first = min(range(3), key=lambda k: whole[k].steps)
    stopped = solve_batch(LAYOUT, starts, problems, whole[first].steps)
    assert whole[first].converged
    assert whole[first].steps == stopped[first].steps < max(s.steps for s in whole)
    np.testing.assert_array_equal(whole[first].z, stopped[first].z)
    np.testing.assert_array_equal(whole[first].normal, stopped[first].normal)
    assert not all(s.converged for s in stopped)


def test_one_that_is_not_finite_does_not_spoil_the_others(three):
    problems, starts = three
    spoiled = eqx.tree_at(lambda q: q.rest, problems[1], jnp.full(3, jnp.nan))
    found = solve_batch(LAYOUT, starts, [problems[0], spoiled, problems[2]], 60)
    whole = solve_batch(LAYOUT, starts, problems, 60)
    assert np.isnan(found[1].cost)
    assert (found[1].converged, found[1].steps) == (False, 1)
    np.testing.assert_array_equal(found[1].z, starts[1])
    assert [found[k].cost for k in (0, 2)] == pytest.approx([whole[k].cost for k in (0, 2)], rel=1e-9)


def test_materials_must_share_their_directions(three):
    problems, starts = three
    other = make_problem(thin(weighted_samples(measured(1)[0]), (10, 5, 18)))
    with pytest.raises(ValueError, match="share their directions"):
        solve_batch(LAYOUT, starts[:2], [problems[0], other])


def test_whole_fits_are_those_of_single_files():
    settings = {"grid": "coarse", "azimuths": 4, "starts": 2, "coarse_steps": 40}
    config = parse({"fit": settings, "posterior": {"enabled": False}}, "test")
    files = [weighted_samples(measured(seed)[0]) for seed in (4, 5)]
    together = fit_batch(LAYOUT, [prepare(samples, config) for samples in files], config)
    for samples, found in zip(files, together, strict=True):
        (best,) = run.fit_coarse([LAYOUT], start_hints(samples), *run.make_coarse(samples), config)
        alone = solve(Objective(LAYOUT, make_problem(thin(samples, run.COARSE), 4)), best.z, config.fit.max_steps)
        assert (found.steps, found.converged) == (alone.steps, alone.converged)
        assert found.cost == pytest.approx(alone.cost, rel=1e-6)
        np.testing.assert_allclose(found.z, alone.z, atol=1e-4)
