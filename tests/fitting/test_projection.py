"""Projected optical constants: the best of those tried, at the cost that the model itself has there."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit import projection
from merlfit.fitting.fit.hints import DIELECTRICS, METALS, hints_of
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.projection import ALBEDOS, BATCH, project
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.effects import KINDS
from merlfit.model.measured import Measured
from merlfit.model.rivals.abc_microfacet import ABCMicrofacet
from merlfit.model.rivals.cook_torrance import CookTorrance
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.he import He
from merlfit.model.rivals.smooth import Smooth
from merlfit.model.two_scale import TwoScale

SHARED = {"beta": 0.15, "p": 0.7, "b": 1.5, "c": 1.8, "sigma_s": 0.03, "grazing_exponent": 0.3,
          "grazing_exponent_diffracted": 0.1}  # fmt: skip
OTHERS = [{**SHARED, "beta": 0.4, "sigma_s": 0.1}, {**SHARED, "p": 1.5}]
METAL, ALBEDO = {"n": np.array([0.3, 0.8, 2.0]), "k": np.array([3.0, 2.0, 1.0])}, np.array([0.6, 0.2, 0.05])
OPTICS = {
    (index, body): {
        **(METAL if index == "complex" else {"eta": np.full(3, 1.6)}),
        **({} if body == "none" else {"albedo": ALBEDO}),
    }
    for index, body in (*KINDS, ("real", "none"))
}


def measured(kind):
    """F colours the diffracted light, which makes projection exact."""
    index, body = kind
    return Measured(TwoScale(body, "lobe", index=index, colour="fresnel"))


def batch(candidates):
    """Shared parameters of candidates as projection wants them."""
    return {name: np.array([each[name] for each in candidates]) for name in SHARED}


def one(found, k):
    """Of one candidate."""
    return {name: jnp.asarray(x[k]) for name, x in found.items()}


def cost_of(effects, values, problem):
    return float(Objective(layout_of(effects), problem).costs(values).sum())


@pytest.fixture(scope="module")
def blank():
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(grid, 1 + 0 * weight, weight), (6, 10, 10))


@pytest.fixture(scope="module", params=OPTICS, ids=" ".join)
def made(request, blank):
    """Effects with a body, a problem of data that they explain, and what projection finds for three candidates."""
    layout = layout_of(measured(request.param))
    value = predict_samples(layout, layout.free({**SHARED, **OPTICS[request.param]}), blank)
    problem = make_problem(replace(blank, value=value, weight=blank.weight / np.maximum(value, 1e-3)), 4)
    together = project([layout_of(measured(kind)) for kind in OPTICS], batch([SHARED, *OTHERS]), problem)
    return layout.model, problem, *together[list(OPTICS).index(request.param)]


def test_every_candidate_has_the_model_s_cost(made):
    effects, problem, costs, found = made
    assert costs.shape == (3,)
    assert set(found) == {q.name for q in effects.parameters}
    assert len(set(costs.tolist())) == 3
    for k, shared in enumerate([SHARED, *OTHERS]):
        values = one(found, k)
        assert {name: float(values[name]) for name in SHARED} == shared
        assert all(values[name].shape == (3,) for name in OPTICS[effects.material.kind])
        assert costs[k] == pytest.approx(cost_of(effects, values, problem), rel=1e-5)


def test_nothing_else_that_is_tried_is_better(made):
    effects, problem, costs, found = made
    rng = np.random.default_rng(2)
    for k in range(3):
        for _ in range(10):
            metal = rng.choice(len(METALS["n"]), 3)
            other = {name: x[metal] for name, x in METALS.items()}
            other |= {"eta": np.full(3, rng.choice(DIELECTRICS["eta"])), "albedo": rng.choice(ALBEDOS, 3)}
            changed = {name: jnp.asarray(other.get(name, x)) for name, x in one(found, k).items()}
            assert costs[k] <= cost_of(effects, changed, problem) * (1 + 1e-5)


def test_what_the_data_were_made_of_is_found(made):
    effects, _, costs, found = made
    assert np.argmin(costs) == 0
    assert costs[0] < 0.02
    if effects.material.index == "real":
        assert np.all(np.abs(found["eta"][0] - 1.6) < 0.15)
    if effects.material.body != "none":
        assert np.all(np.abs(np.log(found["albedo"][0] / ALBEDO)) < np.log(1.8))


def test_batches_do_not_mix_their_candidates(made, monkeypatch):
    """As many as fill two batches, and one more, in any order and by any map."""
    effects, problem, costs, found = made
    monkeypatch.setattr(projection, "BATCH", 2)
    order, seen = [2, 0, 1, 1, 0], []

    def backwards(function, batches):
        seen.append(len(list(batches)))
        return [function(each) for each in reversed(batches)][::-1]

    ((again, values),) = project([layout_of(effects)], batch([[SHARED, *OTHERS][k] for k in order]), problem, backwards)
    assert (seen, BATCH) == ([3], 64)
    np.testing.assert_allclose(again, costs[order], rtol=1e-12)
    for name in found:
        np.testing.assert_array_equal(values[name], found[name][order])


def test_diffracted_light_coloured_by_q_is_projected_roughly(blank):
    """Between F and Q are 9 % of the energy of data made with F; with other constants it is nearly always more."""
    layout = layout_of(measured(("complex", "none")))
    alike = {**SHARED, "grazing_exponent_diffracted": SHARED["grazing_exponent"]}
    value = predict_samples(layout, layout.free({**alike, **METAL}), blank)
    problem = make_problem(replace(blank, value=value, weight=blank.weight / np.maximum(value, 1e-3)), 4)
    effects = Measured(replace(layout.material, colour="rayleigh_rice"))
    values = one(project([layout_of(effects)], batch([alike]), problem)[0][1], 0)
    here, rng = cost_of(effects, values, problem), np.random.default_rng(3)
    assert here < 0.12
    metals = [[jnp.asarray(x[k]) for x in METALS.values()] for k in rng.choice(len(METALS["n"]), (60, 3))]
    others = np.array([cost_of(effects, {**values, "n": n, "k": k}, problem) for n, k in metals])
    assert np.sum(others < here) <= 3
    assert np.median(others) > 10 * here


SEPARATED = [
    GGX(), GGX("dielectric"), GGX("conductor", "v-groove"), EPD(), Smooth(), ABCMicrofacet(), CookTorrance(),
    CookTorrance("ngan"), He(),
]  # fmt: skip


@pytest.mark.parametrize("model", SEPARATED, ids=str)
def test_channels_of_rivals_are_linear_exactly(model, blank):
    """Projected costs are the model's own, and no other constants that are tried are better."""
    layout, rng = layout_of(Measured(model)), np.random.default_rng(1)
    z = 0.5 * rng.standard_normal(layout.size)
    value = predict_samples(layout, z, blank)
    samples = replace(blank, value=value, weight=blank.weight / np.maximum(value, 1e-3))
    objective = Objective(layout, make_problem(samples, 4))
    named = layout.values(np.array([z, 0.3 * z]))
    shared = {q.name: named[q.name] for q in layout.parameters if not q.per_channel}
    ((costs, found),) = project([layout], shared, objective.problem)
    ours = np.asarray(objective.costs_of_many({name: jnp.asarray(x) for name, x in found.items()})).sum(1)
    np.testing.assert_allclose(costs, ours, rtol=1e-6)
    parted = hints_of(layout.model).linear
    for _ in range(10):
        chosen = rng.integers(0, len(next(iter(parted.constants.values()))), (2, 1 if parted.alike else 3))
        other = {**found, **{name: np.broadcast_to(x[chosen], (2, 3)) for name, x in parted.constants.items()}}
        others = np.asarray(objective.costs_of_many({name: jnp.asarray(x) for name, x in other.items()})).sum(1)
        assert np.all(costs <= others * (1 + 1e-6))
