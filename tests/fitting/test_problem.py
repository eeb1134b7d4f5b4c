"""The cost over gathered azimuths is that of all bins, for the model that is fitted."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit import problem as problems
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective, predict
from merlfit.fitting.fit.transforms import layout_of
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

DRAWS = 24
EFFECTS = Measured(TwoScale("none", "lobe")), Measured(TwoScale("subsurface", "lobe"))


def predictions(effects, samples, draws):
    """Parameters drawn evenly between their bounds, but 3 % at either end, and the model at every bin."""
    rng = np.random.default_rng(11)
    where = problems.directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
    for _ in range(draws):
        places = {q: jnp.asarray(rng.uniform(0.03, 0.97, 3 if q.per_channel else ())) for q in effects.parameters}
        values = {q.name: q.between(u) for q, u in places.items()}
        yield values, predict(effects, values, where)


@pytest.fixture(scope="module")
def every_bin():
    """All azimuths of a fifth of the rows, weighted as Eq. 56 weighs bins of one brightness."""
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(grid, np.ones_like(weight), weight), (5, 5, 1))


def distances(effects, every_bin, nodes):
    """Weighted distance of the model from its interpolant, relative to the model, of each draw."""
    found = []
    for values, predicted in predictions(effects, every_bin, DRAWS):
        samples = replace(every_bin, value=predicted)  # what the gathered model errs by is all its cost
        found.append(np.sqrt(float(Objective(layout_of(effects), make_problem(samples, nodes)).costs(values).sum())))
    return np.array(found)


@pytest.mark.parametrize("effects", EFFECTS)
def test_gathered_model_is_the_model(effects, every_bin):
    errors = {nodes: distances(effects, every_bin, nodes) for nodes in (4, 8)}
    assert np.median(errors[8]) < 3e-5
    assert errors[8].max() < 2e-3
    assert np.median(errors[4]) > 5 * np.median(errors[8])


def test_float32_evaluates_the_same_cost(every_bin):
    effects = EFFECTS[0]
    for values, predicted in predictions(effects, every_bin, 4):
        rng = np.random.default_rng(0)
        samples = replace(every_bin, value=predicted * rng.uniform(0.8, 1.2, predicted.shape))
        problems_ = [make_problem(samples, 8, p) for p in ("float64", "float32")]
        double, single = (float(Objective(layout_of(effects), q).costs(values).sum()) for q in problems_)
        assert single != double
        assert single == pytest.approx(double, rel=1e-4)
