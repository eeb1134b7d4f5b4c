"""Starting points: of every kind, moved all together by the first of them, and the same every time."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit import starts
from merlfit.fitting.fit.hints import DIELECTRICS, TYPICAL, StartHints, hints_of
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.projection import ALBEDOS, project
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.starts import (
    DARK_QUANTILE,
    NEAR,
    RIM,
    SCATTER,
    half_width,
    start_hints,
    starting_points,
)
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.measured import Measured
from merlfit.model.parameters import WEIGHT
from merlfit.model.priors import PRIORS, Constraint, LogNormal
from merlfit.model.registry import made
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.oren_nayar_qualitative import OrenNayarQualitative
from merlfit.model.two_scale import TwoScale
from scipy.special import ndtr, ndtri

LAYOUT = layout_of(Measured(TwoScale("lambert", "lobe")))
NARROW = {
    "alpha": 0.01,
    "grazing_exponent": 0.2,
    "F0": np.array([0.04, 0.05, 0.3]),
    "albedo": np.array([0.5, 0.1, 0.02]),
}
SHARED = [q.name for q in LAYOUT.parameters if not q.per_channel]
TRUTH = {
    "beta": 0.1, "p": 0.8, "b": 3.0, "c": 2.0, "sigma_s": 0.02, "grazing_exponent": 0.4,
    "grazing_exponent_diffracted": 0.2, "eta": np.full(3, 1.5), "albedo": np.array([0.5, 0.3, 0.1]),
}  # fmt: skip
CLASSES = hints_of(LAYOUT.model).strata
MIDDLE_UM = LAYOUT.bands.middle_um
SEEN = StartHints(MIDDLE_UM / 120)  # a highlight that were diffracted light of b = 60 um
FIRST = {**TYPICAL, "beta": 0.05, "grazing_exponent": 0.5, "grazing_exponent_diffracted": 0.3}


@pytest.fixture(scope="module")
def samples():
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    blank = thin(fold(grid, 1 + 0 * weight, weight), (3, 10, 10))
    return replace(blank, value=predict_samples(LAYOUT, LAYOUT.free(TRUTH), blank))


@pytest.fixture(scope="module")
def problem(samples):
    return make_problem(thin(samples, (2, 3, 1)), 4)


@pytest.fixture(scope="module")
def points(problem):
    """As many as there are kinds, half as many again, and the first."""
    return points_of(LAYOUT, problem, 36)


def kinds(points):
    """Class of every point in every parameter that has some, which both kinds of correlation length share."""
    classes = np.array([CLASSES.get(name, 1) for name in SHARED])
    return [tuple(each) for each in (ndtr(points[:, : len(SHARED)] / SCATTER) * classes).astype(int).tolist()]


def points_of(layout, problem, count, over=map, first=FIRST):
    """Of one kind alone."""
    return starting_points([layout], SEEN, problem, count, over, first)[0]


def values_of(points):
    return LAYOUT.values(points)


def test_they_begin_with_the_first(points):
    assert points.shape == (37, LAYOUT.size)
    values = values_of(points)
    for name in SHARED:
        assert values[name][0] == pytest.approx(FIRST[name], rel=1e-9)


def test_they_are_of_every_kind_the_best_of_each_first(points, problem):
    number = int(np.prod(list(CLASSES.values())))
    assert number == 12
    of = kinds(points[1:])
    best, second = of[: 2 * number], of[2 * number :]
    assert set(Counter(best).values()) == {2}  # with any correlation length, and with that of the highlight
    assert len(set(best)) == number
    assert max(Counter(second).values()) <= 2
    values = values_of(points)
    ((costs, _),) = project([LAYOUT], {name: values[name] for name in SHARED}, problem)
    first, then = costs[1 : 2 * number + 1], costs[2 * number + 1 :]
    for some in (first, then):
        assert np.all(np.diff(some) >= -1e-9 * some[1:])
    for kind, cost in zip(second, then, strict=True):
        assert first[best.index(kind)] <= cost * (1 + 1e-9)


def test_in_half_of_them_the_highlight_is_diffracted_light(points):
    """Whatever the width of the facets' lobe: of every kind one has about the correlation length that was seen."""
    b = SHARED.index("b")
    place = points[1:, b] - LAYOUT.free({**TRUTH, "b": 60.0})[b]
    near = np.abs(place) <= NEAR * ndtri(1 - RIM) * (1 + 1e-9)
    kind = kinds(points[1:])
    assert {kind[k] for k in np.flatnonzero(near)} == set(kind)
    assert 0.5 <= near.mean() < 0.9
    assert np.std(place[near]) > NEAR / 3
    assert points[1:, b].min() < -1


def test_those_of_one_kind_are_the_same_beside_others(points, problem):
    others = [LAYOUT.with_material(replace(LAYOUT.material, body=body, index="usual")) for body in ("plastic", "none")]
    together = starting_points([others[0], LAYOUT, others[1]], SEEN, problem, 36, first=FIRST)
    np.testing.assert_allclose(together[1], points, rtol=1e-12)
    assert [each.shape[1] for each in together] == [others[0].size, LAYOUT.size, others[1].size]


def test_those_of_the_free_split_are_those_of_the_printed_one_with_a_typical_weight(points, problem):
    material, half = LAYOUT.material.changed(split="free"), Constraint(start=0.5)
    free = layout_of(replace(LAYOUT.model, material=material), constraints=(("weight", half),))
    found = points_of(free, problem, 36)
    values = free.values(found)
    np.testing.assert_allclose(values["weight"][0], 0.5)
    np.testing.assert_allclose(values["weight"][1:], WEIGHT.default)
    np.testing.assert_allclose(values["b"], LAYOUT.values(points)["b"], rtol=1e-9)


def test_few_are_of_as_many_kinds(problem):
    assert max(Counter(kinds(points_of(LAYOUT, problem, 5)[1:])).values()) <= 2


def test_they_are_scattered_over_the_prior_with_the_optics_that_suit_them(points):
    shared = points[1:, : len(SHARED)]
    assert np.all(np.abs(shared) <= SCATTER * ndtri(1 - RIM) * (1 + 1e-9))
    assert np.all(np.ptp(shared, axis=0) > 2)
    values = values_of(points)
    for name, tried in (("eta", DIELECTRICS["eta"]), ("albedo", ALBEDOS)):
        away = np.abs(values[name][..., None] / tried - 1).min(-1)
        assert np.all(away < 1e-6)
    np.testing.assert_allclose(values["eta"][:, [0, 2]], values["eta"][:, [1, 1]], rtol=1e-9)
    assert len({tuple(each) for each in np.round(values["albedo"], 6).tolist()}) > 3


def test_they_are_the_same_every_time_and_another_first_moves_all(problem):
    with ThreadPoolExecutor(2) as pool:
        once, again = (points_of(LAYOUT, problem, 4, over) for over in (map, pool.map))
    np.testing.assert_array_equal(once, again)
    moved = points_of(LAYOUT, problem, 4, first={**FIRST, "beta": 0.06, "p": 0.9})
    assert np.all(np.any(np.abs(once[:, None] - moved) > 1e-3, axis=-1))


def test_those_of_models_with_unlike_lobes_are_the_same_side_by_side(problem):
    layouts = [LAYOUT, LAYOUT.with_material(replace(LAYOUT.material, diffraction="off"))]
    alone = [points_of(each, problem, 4, first=FIRST) for each in layouts]
    with ThreadPoolExecutor(2) as pool:
        beside = starting_points(layouts, SEEN, problem, 4, pool.map, FIRST)
    for one, other in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_prior_scatters_them_otherwise(problem):
    narrow = layout_of(LAYOUT.model, replace(PRIORS, half_width=LogNormal(0.05, 1.2), p=LogNormal(1.0, 1.2)))
    found = points_of(narrow, problem, 24)
    values = [narrow.values(jnp.asarray(z)) for z in found]
    widths = [float(v["beta"] * np.log(2) ** (1 / (2 * v["p"]))) for v in values]
    assert max(abs(np.log(np.array(widths) / 0.05))) < SCATTER * ndtri(1 - RIM) * np.log(1.2)
    assert len(set(kinds(found[1:]))) == 12


@pytest.mark.parametrize("name", ["beta", "p", "b", "c", "sigma_s", "grazing_exponent", "grazing_exponent_diffracted"])
def test_a_first_one_at_a_bound_leaves_all_within_bounds(name, problem):
    q = next(q for q in LAYOUT.parameters if q.name == name)
    for bound in (q.lower, q.upper):
        found = points_of(LAYOUT, problem, 1, first={**FIRST, name: bound})
        assert np.all(np.isfinite(found))
        for each, x in values_of(found).items():
            q = next(q for q in LAYOUT.parameters if q.name == each)
            assert np.all((q.lower * (1 - 1e-12) <= x) & (x <= q.upper * (1 + 1e-12)))


def test_effects_without_diffraction_are_scattered_too(problem):
    layout = LAYOUT.with_material(replace(LAYOUT.material, diffraction="off"))
    points = points_of(layout, problem, 6)
    assert points.shape == (7, layout.size)
    assert np.all(np.isfinite(points))
    width = [q.name for q in layout.parameters].index("beta")
    of = {tuple((ndtr(z[[width, width + 1]] / SCATTER) * [CLASSES["beta"], CLASSES["p"]]).astype(int)) for z in points}
    assert len(of) == CLASSES["beta"] * CLASSES["p"]


def test_the_first_has_the_width_of_a_known_lobe(samples):
    half = TRUTH["beta"] * np.log(2) ** (1 / (2 * TRUTH["p"]))
    first, other = hints_of(LAYOUT.model).starts(start_hints(samples), MIDDLE_UM)
    assert half / 2 < first["beta"] * np.log(2) ** (1 / (2 * first["p"])) < 2 * half
    assert {name: first[name] for name in TYPICAL} == TYPICAL
    assert {name for name in other if other[name] != first[name]} == {"b"}


def test_the_correlation_length_is_that_of_a_highlight_of_diffracted_light(samples):
    sharp = {**TRUTH, "beta": 0.002, "b": 20.0, "sigma_s": 0.2}
    clues = start_hints(replace(samples, value=predict_samples(LAYOUT, LAYOUT.free(sharp), samples)))
    assert sharp["b"] / 2 < hints_of(LAYOUT.model).starts(clues, MIDDLE_UM)[1]["b"] < 2 * sharp["b"]


def test_a_black_file_has_a_first_one_nevertheless(samples):
    for black in (replace(samples, value=0 * samples.value), replace(samples, weight=0 * samples.weight)):
        for values in hints_of(LAYOUT.model).starts(start_hints(black), MIDDLE_UM):
            assert np.all(np.isfinite(LAYOUT.free({**TRUTH, **values})))


def lobe(tangent, width):
    """Beckmann's, one at its peak."""
    return np.exp(-np.log(2) * (tangent / width) ** 2)


@pytest.mark.parametrize("width", [0.02, 0.08, 0.3, 1.0])
def test_the_half_width_is_that_of_a_known_lobe(width):
    grid = merl_grid()
    tangent = np.tan(grid.theta_h)
    value = (0.2 + 5 * lobe(tangent, width))[None, :, None, None] * np.ones((3, 1, 90, 90))
    used = np.broadcast_to(grid.above[..., :90], value.shape)
    found = half_width(grid.theta_h, grid.theta_d, value, used)
    row = np.searchsorted(tangent, width)  # the first that is darker than half
    assert tangent[row - 1] <= found <= tangent[row + 1]
    np.testing.assert_allclose(half_width(grid.theta_h, grid.theta_d, 1e3 * value, used), found)


def test_the_half_width_looks_at_small_theta_d_and_at_what_counts():
    grid = merl_grid()
    value = (0.2 + 5 * lobe(np.tan(grid.theta_h), 0.02))[None, :, None, None] * np.ones((3, 1, 90, 90))
    used = np.broadcast_to(grid.above[..., :90], value.shape)
    expected = half_width(grid.theta_h, grid.theta_d, value, used)
    elsewhere = np.where(grid.theta_d[:, None] > 1.0, 1e4, value)
    assert half_width(grid.theta_h, grid.theta_d, elsewhere, used) == expected
    spoiled, without = value.copy(), used.copy()
    spoiled[:, 60:, :3, :10], without[:, 60:, :3, :10] = 1e6, False
    assert half_width(grid.theta_h, grid.theta_d, spoiled, without) == expected
    assert 0 < DARK_QUANTILE < 1


def test_the_half_width_of_nothing_is_a_number():
    grid = merl_grid()
    value, used = np.zeros((3, 90, 90, 90)), np.broadcast_to(grid.above[..., :90], (3, 90, 90, 90))
    for nothing in (used, np.zeros_like(used)):
        assert 0 < half_width(grid.theta_h, grid.theta_d, value, nothing) <= 2


@pytest.mark.parametrize("linear", [True, False], ids=["projected", "searched"])
def test_points_of_any_model_are_of_every_width_and_suit_every_channel(samples, linear, monkeypatch):
    """Of a narrow lobe over a bright body a wide one is the cheaper guess: with guesses by cost alone it were lost."""
    layout = layout_of(Measured(GGX()))
    if not linear:
        own = replace(hints_of(layout.model), linear=None)
        monkeypatch.setattr(starts, "hints_of", lambda model: own)
    value = predict_samples(layout, layout.free(NARROW), samples)
    problem = make_problem(
        thin(replace(samples, value=value, weight=samples.weight / np.maximum(value, 1e-2)), (2, 3, 1))
    )
    found = points_of(layout, problem, 12, first=None)
    assert found.shape == (13, layout.size)
    np.testing.assert_array_equal(found, points_of(layout, problem, 12, first=None))
    thirds = (ndtr(found[1:, 0] / SCATTER) * 3).astype(int)
    assert sorted(np.bincount(thirds)) == [4, 4, 4]
    values = layout.values(found)
    best = int(np.argmin(np.asarray(Objective(layout, problem).costs_of_many(values)).sum(1)))
    albedo = values["albedo"][best]
    assert albedo[0] > 2 * albedo[1] > 4 * albedo[2], "of each channel by itself"
    ends = [solve(Objective(layout, problem), z, 100) for z in found]
    assert min(s.cost for s in ends) < 1e-8


def test_models_of_several_kinds_keep_their_order(problem):
    layouts = [layout_of(Measured(GGX())), LAYOUT, layout_of(OrenNayarQualitative())]
    found = starting_points(layouts, SEEN, problem, 5)
    assert [each.shape for each in found] == [(6, layout.size) for layout in layouts]
    np.testing.assert_array_equal(found[1], points_of(LAYOUT, problem, 5, first=None))


SUMS = {
    "ggx+epd": {"F0": Constraint(start=0.33), "alpha_2": Constraint(fixed=(0.1,))},
    "coat(ggx)+two-scale": {"eta_coat": Constraint(fixed=(1.5,)), "albedo": Constraint(upper=0.2)},
    "ggx+two-scale": {"weight": Constraint(fixed=(0.7,)), "share_2": Constraint(lower=0.2, upper=0.4)},
}


@pytest.mark.parametrize("name", SUMS)
def test_those_of_sums_heed_what_is_said_of_parameters(problem, name):
    """Of a real interface with the free split, which has parameters that no weight stands for."""
    base = {"base": asdict(TwoScale("lambert", split="free"))} if "two-scale" in name else {}
    layout = layout_of(Measured(made(name, base), "off"), constraints=tuple(SUMS[name].items()))
    found = starting_points([layout], SEEN, problem, 5)[0]
    values = layout.values(found)
    for parameter, said in SUMS[name].items():
        own = values[parameter]
        if said.fixed is not None:
            np.testing.assert_allclose(own, said.fixed[0])
        if said.start is not None:
            np.testing.assert_allclose(own[0], said.start)
        assert said.lower is None or own.min() >= said.lower
        assert said.upper is None or own.max() <= said.upper
    costs = [Objective(layout, problem).normal_equations(z)[:, -1, -1].sum() for z in found]
    assert min(costs) < 0.6  # of the energy, of which no light at all leaves 1
