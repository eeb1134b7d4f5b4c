"""Which interface and body, and which weights: the rules, on numbers as fits have them."""

from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.fit import plausible
from merlfit.fitting.fit.levenberg_marquardt import UNEXPLAINED_COST
from merlfit.fitting.fit.selection import (
    ALIKE,
    BEYOND,
    MARGIN,
    PATIENCE,
    choose,
    choose_sum,
    errors_of,
    lost,
    nearest,
    promising,
    score,
)
from merlfit.fitting.fit_object import Fit
from merlfit.fitting.results.schema_fit import Candidate
from merlfit.model.effects import KINDS
from merlfit.model.two_scale import TwoScale

from tests.support.made_results import made

COUNT = 13.0


def chosen(objectives, cube_roots, count=COUNT):
    scores = [score(j, e, count) for j, e in zip(objectives, cube_roots, strict=True)]
    return KINDS[choose(objectives, cube_roots, scores)]


def test_kinds_are_effects_the_simplest_first():
    assert [TwoScale(body, index=index).kind for index, body in KINDS] == list(KINDS)
    assert KINDS[0] == ("complex", "none")


def test_a_floor_under_a_metal_is_taken_when_the_dark_parts_gain():
    """Nickel's reconstruction: the floor hardly lowers the cost and halves the error of cube roots."""
    assert chosen([0.0107, 0.014, 0.0133, 0.0134, 0.0111], [0.0212, 0.0133, 0.0123, 0.0123, 0.0117]) == (
        "complex", "lambert",
    )  # fmt: skip


def test_a_plastic_is_taken_where_it_is_clearly_better():
    """Gray plastic."""
    found = chosen([0.0525, 0.0091, 0.0030, 0.0040, 0.0105], [0.03, 0.009, 0.0055, 0.006, 0.009], 25.0)
    assert found == ("real", "plastic")


def test_the_simplest_of_those_alike():
    alike = [1.03, 1.0, 1.0, 1.0, 0.99]
    assert chosen([0.01 * x for x in alike], [0.02 * x for x in alike]) == KINDS[0]


def test_of_those_alike_one_that_makes_no_light():
    errors = [0.0101, 0.01, 0.01, 0.01, 0.0099], [0.02] * 5
    scores = [score(j, e, COUNT) for j, e in zip(*errors, strict=True)]
    assert choose(*errors, scores, excessive=lambda k: k in (0, 1)) == 2
    assert choose(*errors, scores, excessive=lambda _: True) == 0, "the simplest of them"
    scores[3] -= 2 * ALIKE
    assert choose(*errors, scores, excessive=lambda k: 1 / 0) == 3, "asked of those alone that are alike"


@pytest.mark.parametrize("which", [0, 1])
def test_noticeably_worse_is_not_alike_however_few_residuals_count(which):
    """A few independent residuals cannot tell anything apart: twice the error must still be refused."""
    errors = [[0.01] * 5, [0.02] * 5]
    errors[which][0] *= 1.01 * MARGIN
    scores = [score(j, e, 1.0) for j, e in zip(*errors, strict=True)]
    assert scores[0] < min(scores) + ALIKE
    assert choose(*errors, scores) == 1


def test_what_is_not_finite_is_never_chosen():
    objectives, roots = [np.inf, 0.01], [np.inf, 0.02]
    assert choose(objectives, roots, [np.nan, score(0.01, 0.02, COUNT)]) == 1
    assert choose([np.nan, 0.01], [np.nan, 0.02], [np.nan, -50.0], [True, False], [True, False]) == 1


def test_nearest_picture_that_keeps_the_highlight():
    assert nearest([(2.0, 1.1), (1.0, 0.9), (1.5, 1.0)]) == 1
    assert nearest([(1.0, 0.1), (1.5, 0.7), (1.4, 0.4)]) == 1
    assert nearest([(1.0, 0.1), (1.2, 0.2)]) == 0, "no fit keeps it"
    assert nearest([(1.0, 0.1), (1.01 * PATIENCE, 1.0)]) == 0, "at the price of the picture"
    assert nearest([(np.nan, 0.1), (np.nan, 0.9), (np.nan, 1.0)]) == 1, "the first, without pictures"


@pytest.mark.parametrize(("ratio", "is_lost"), [(0.49, True), (0.51, False), (1.9, False), (2.1, True), (np.nan, True)])
def test_a_highlight_off_by_more_than_two_is_lost(ratio, is_lost):
    assert lost(ratio) is is_lost


PTFE = [0.04062, 0.003732, 0.007108, 0.007792, 0.003289], [0.03425, 0.0103, 0.01123, 0.01148, 0.008073]
FELT = [0.01772, 0.03028, 0.03431, 0.03377, 0.01402], [0.01356, 0.01477, 0.01485, 0.01472, 0.01136]
MATTER, DIELECTRIC = [True, True, True, True, False], [index == "real" for index, _ in KINDS]


def of_matter(errors, matter, count=8.2):
    return KINDS[choose(*errors, [score(j, e, count) for j, e in zip(*errors, strict=True)], matter, DIELECTRIC)]


def test_sintered_ptfe_is_no_metal():
    """Germer 2017, on the coarse grid: a bright body under n = 0.1, k = 0.5 describes it a little better."""
    assert of_matter(PTFE, [True] * 5) == ("complex", "lambert")
    assert of_matter(PTFE, MATTER) == ("real", "lambert")


def test_a_felt_is_no_metal_without_its_body_either():
    """The green one of RGL (Dupuy & Jakob 2018): the conductor alone has a lower score than any dielectric."""
    assert of_matter(FELT, MATTER, 15.0) == ("real", "lambert")


@pytest.mark.parametrize("which", [0, 1])
def test_what_no_matter_has_is_taken_where_nothing_else_describes_the_file(which):
    errors = [list(each) for each in PTFE]
    errors[which][-1] = 0.99 * min(errors[which][1:-1]) / BEYOND
    assert of_matter(errors, MATTER) == ("complex", "lambert")


def test_what_is_known_of_matter_changes_nothing_among_fits_of_matter():
    every = [0.0107, 0.014, 0.0133, 0.0134, 0.0111], [0.0212, 0.0133, 0.0123, 0.0123, 0.0117]
    assert of_matter(every, [True] * 5, COUNT) == ("complex", "lambert")
    assert of_matter(every, [False] * 5, COUNT) == ("complex", "lambert")


@pytest.mark.parametrize(("n", "k", "floor", "known"), [
    ([0.05, 0.05, 0.04], [4.2, 3.3, 2.6], 0.0, True),  # silver
    ([0.67, 0.735, 0.79], [0.403, 0.358, 0.357], 0.0, True),  # chrome's reconstruction, ten times too dark
    ([1.213, 1.31, 1.42], [1.111, 1.034, 0.939], 0.005, True),  # nickel's, with stray light
    ([2.86, 2.772, 2.436], [1.258, 0.838, 0.627], 0.074, True),  # a silver paint's, a little brighter than dust
    ([0.147, 0.1, 0.094], [0.515, 0.501, 0.493], 0.79, False),  # what describes PTFE
    ([0.787, 0.734, 1.209], [0.358, 0.249, 0.311], 0.189, False),  # a green felt
    ([1.076, 1.083, 1.088], [0.112, 0.092, 0.092], 0.0, False),  # obsidian's reconstruction: glass absorbs little
    ([0.07, 0.085, 0.069], [0.397, 0.39, 0.394], 0.0, False),  # a mirror, of an index that is not silver's
])  # fmt: skip
def test_which_constants_are_those_of_matter(n, k, floor, known):
    values = {"n": np.array(n), "k": np.array(k), "albedo": np.full(3, floor)}
    assert plausible.of_matter(TwoScale("lambert", index="complex"), values) is known
    assert plausible.of_matter(TwoScale("lambert"), {"eta": np.full(3, 1.5), "albedo": np.full(3, 0.9)})


ORANGE = (
    [0.5731, 0.8218, 0.8201, 0.8165, 0.6139],
    [0.1289, 0.0974, 0.0707, 0.0674, 0.0795],
    [0.446, 0.689, 0.689, 0.687, 0.454],
)
MINT = (
    [0.4150, 0.6822, 0.6823, 0.6823, 0.4152],
    [0.2125, 0.0852, 0.1544, 0.1535, 0.0663],
    [0.357, 0.607, 0.607, 0.607, 0.357],
)


@pytest.mark.parametrize(("film", "matter", "count"), [(ORANGE, [True] * 5, 26.2), (MINT, MATTER, 3.3)])
def test_a_body_without_its_mirror_is_not_taken_where_a_conductor_explains_the_film(film, matter, count):
    """Chrome wraps of RGL, orange and mint: a dielectric describes the cube roots as well, and leaves 0.6 and more."""
    *errors, costs = film
    scores = [score(j, e, count) for j, e in zip(*errors, strict=True)]
    explains = [cost <= UNEXPLAINED_COST for cost in costs]
    describes_nothing = not all(matter)  # there: then matter counts for nothing
    assert KINDS[choose(*errors, scores, matter, DIELECTRIC)][0] == ("complex" if describes_nothing else "real")
    assert KINDS[choose(*errors, scores, matter, DIELECTRIC, explains)] == ("complex", "lambert")
    assert choose(*errors, scores, matter, DIELECTRIC, [False] * 5) == choose(*errors, scores, matter, DIELECTRIC)


@pytest.mark.parametrize(
    ("lowest", "said"),
    [
        ({"cost": 0.7}, "as other leaves too much of the file unexplained"),
        ({"cost": 0.3, "of_matter": False}, "as no matter has the constants of other"),
        ({"cost": 0.3}, "the simplest of those that describe the file about as well as the lowest"),
    ],
)
def test_why_another_kind_than_the_lowest_was_taken_is_said(lowest, said):
    result = made()
    taken = result.model.material.variant
    candidates = [
        Candidate(model="two-scale", variant=taken, cost=0.4, score=1.0),
        Candidate(model="two-scale", variant="other", score=-5.0, **lowest),
    ]
    result = result.model_copy(update={"fit": result.fit.model_copy(update={"candidates": candidates})})
    assert said in " ".join(str(Fit(result, Path("nickel.json"))).split())


def richer(J, look, highlight=(1.0,) * 3, **others):
    """A single model and two richer ones, as they were compared."""
    none = lambda x: None if np.isnan(x) else x  # noqa: E731
    return [
        Candidate(
            model="m", variant="m", cost=none(j), objective=none(j), cube_root=1.0, picture=p, highlight=h, **others
        )
        for j, p, h in zip(J, look, highlight, strict=True)
    ]


@pytest.mark.parametrize(
    ("J", "look", "highlight", "chosen"),
    [
        ((1.0, 0.9, 0.9), (1.0, 0.9, 0.85), (1.0, 1.0, 1.0), 0),  # not worth another lobe
        ((1.0, 0.9, 0.8), (1.0, 0.9, 0.8), (1.0, 1.0, 1.0), 2),
        ((1.0, 1.04, 0.8), (4.0, 1.0, 3.6), (1.0, 1.0, 1.0), 1),  # hardly a lower cost, but it looks like the file
        ((1.0, 0.4, 0.39), (1.0, 0.9, 0.9), (1.0, 1.0, 1.0), 1),  # as good by fewer numbers
        ((1.0, 0.8, 0.65), (1.0, 0.9, 0.9), (1.0, 1.0, 1.0), 1),  # of which the other one alone would not be worth it
        ((1.0, 0.4, 0.25), (1.0, 0.9, 0.9), (1.0, 1.0, 1.0), 2),
        ((1.0, 0.2, 0.4), (1.0, 1.2, 0.9), (1.0, 1.0, 1.0), 2),  # a lower cost by a picture that is further off
        ((1.0, 1.2, 1.2), (1.0, 0.3, 0.3), (1.0, 1.0, 1.0), 0),  # a nearer picture by a higher cost
        ((1.0, float("nan"), 0.4), (1.0, 0.1, 0.9), (1.0, 1.0, 1.0), 2),
        ((1.0, 0.4, 0.4), (1.0, 0.9, 0.9), (1.0, 2.5, 1.0), 2),  # that which keeps the highlight
        ((1.0, 0.9, 0.9), (1.0, 0.9, 0.9), (0.3, 1.0, 1.0), 1),  # that the single one has lost
    ],
)
def test_a_richer_model_is_taken_where_it_is_seen(J, look, highlight, chosen):
    assert choose_sum(0, [1, 2], richer(J, look, highlight), [13, 16, 20]) == chosen


def test_one_that_ran_away_changes_nothing_for_the_others():
    compared = [*richer((0.02, 0.012, 0.5), (4.1, 1.0, None)), Candidate(model="m", variant="m", cost=None)]
    assert choose_sum(0, [1, 2, 3], compared, [13, 16, 20, 20]) == 1
    nothing = [Candidate(model="m", variant="m", cost=None)] * 2
    assert choose_sum(0, [1], nothing, [13, 16]) == 0


def test_what_gives_back_more_than_it_receives_comes_after_what_is_as_good():
    compared = richer((1.0, 0.4, 0.4), (1.0, 0.9, 0.9))
    assert choose_sum(0, [1, 2], compared, [13, 16, 20], excessive=lambda k: k == 1) == 2


def test_richer_models_are_judged_by_cube_roots_where_nothing_is_to_be_seen():
    compared = richer((1.0, 0.9, 0.4), (None,) * 3, (None,) * 3)
    assert errors_of(compared) == [1.0, 0.9, 0.4]
    assert choose_sum(0, [1, 2], [*compared[:2], compared[2].model_copy(update={"cube_root": 0.9})], [13, 16, 20]) == 2


def test_what_is_added_to_is_the_best_of_matter_or_the_single_model():
    of = lambda J, matter=True: Candidate(model="m", variant="m", cost=J, objective=J, cube_root=1.0, of_matter=matter)  # noqa: E731
    assert promising([of(1.0), of(2.0)], 1, 2) == 1  # not another kind, which was not taken
    assert promising([of(1.0), of(2.0), of(0.5, matter=False), of(0.8)], 1, 2) == 3
