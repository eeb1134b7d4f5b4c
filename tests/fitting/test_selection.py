"""Which interface and body, and which weights: the rules, on numbers as fits have them."""

import numpy as np
import pytest
from merlfit.fitting.assess.selection import ALIKE, MARGIN, PATIENCE, choose, lost, nearest, score
from merlfit.model.effects import KINDS
from merlfit.model.two_scale import TwoScale

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


def test_nearest_picture_that_keeps_the_highlight():
    assert nearest([(2.0, 1.1), (1.0, 0.9), (1.5, 1.0)]) == 1
    assert nearest([(1.0, 0.1), (1.5, 0.7), (1.4, 0.4)]) == 1
    assert nearest([(1.0, 0.1), (1.2, 0.2)]) == 0, "no fit keeps it"
    assert nearest([(1.0, 0.1), (1.01 * PATIENCE, 1.0)]) == 0, "at the price of the picture"


@pytest.mark.parametrize(("ratio", "is_lost"), [(0.49, True), (0.51, False), (1.9, False), (2.1, True), (np.nan, True)])
def test_a_highlight_off_by_more_than_two_is_lost(ratio, is_lost):
    assert lost(ratio) is is_lost
