"""Rounds of richer models that ``--model auto`` goes through: what each begins with, and where they end."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.pipeline import run
from merlfit.fitting.pipeline.search import in_turn
from merlfit.fitting.results import schema
from merlfit.fitting.settings.config import load
from merlfit.merl_io.bands import MERL
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.grating import Grating
from merlfit.model.sum import Sum, lowest
from merlfit.model.two_scale import TwoScale

PLASTIC = TwoScale("plastic")
BESIDE, RINGED = Sum(EPD(), PLASTIC), Sum(Grating(), PLASTIC)
COATED = Sum(EPD(), BESIDE, coated=True)
NEAR, FAR = 0.2, 3.0  # pictures: one that needs nothing richer, one that needs whatever there is


@dataclass
class Ended:
    """A fit on all bins, of which nothing is known but its errors."""

    solution: SimpleNamespace
    errors: SimpleNamespace
    candidates: list = field(default_factory=list)


def test_models_take_turns_and_each_has_its_own_results():
    began = []

    def solved(k, z):
        began.append((k, z))
        return 10 * k + z

    assert in_turn(map, solved, [[1, 2, 3], [], [4, 5]]) == [[1, 2, 3], [], [24, 25]]
    assert began == [(0, 1), (2, 4), (0, 2), (2, 5), (0, 3)]


@pytest.fixture
def rounds(monkeypatch):
    """The fit of a file of which a table says what every model leaves, and how far its picture is off."""

    def fitted(left, on_all_bins=None):
        """What is kept, by material, and what was reported; other models than those in the table leave 1."""
        seen = {}  # material by what stands for its fit

        def at(material):
            return left.get(material, (1.0, 10.0))

        def coarse(layouts, *_):
            return [SimpleNamespace(cost=at(each.material)[0], objective=at(each.material)[0]) for each in layouts]

        def compare(tried, few, taken=None, first=0, seen=False):
            found = [
                schema.Candidate(
                    model=m.name, variant=m.variant, cost=at(m)[0], objective=at(m)[0], picture=at(m)[1], highlight=1.0
                )
                for m in (each.layout.material for each in tried)
            ]
            return found, min(range(len(found)), key=lambda k: found[k].cost)

        def finished(searched, *_):
            cost, picture = (on_all_bins or left).get(searched.layout.material, at(searched.layout.material))
            ended = Ended(SimpleNamespace(cost=cost), SimpleNamespace(picture=picture, cube_root=1.0, highlight=1.0))
            seen[id(ended.solution)] = searched.layout.material
            return ended

        stubs = {
            "too_dark": lambda _: False, "start_hints": lambda _: None, "thinned": lambda *_: None,
            "make_coarse": lambda _: (None, None), "fit_coarse": coarse, "compare": compare, "finished": finished,
        }  # fmt: skip
        for name, stub in stubs.items():
            monkeypatch.setattr(run, name, stub)
        said = []
        found = run.fit(None, SimpleNamespace(bands=MERL), load(model="auto", posterior=False), said.append)
        return seen[id(found.solution)], [text.split(": ") for text in said], found.candidates

    return fitted


def test_a_single_model_that_is_near_is_all(rounds):
    kept, said, _ = rounds({PLASTIC: (0.004, NEAR)})
    assert kept == PLASTIC
    assert [stage for stage, _ in said] == ["coarse grid"]


@pytest.mark.parametrize("single", [(0.004, 0.9), (0.02, NEAR)])
def test_a_little_that_is_left_or_seen_is_worth_one_round(rounds, single):
    kept, said, _ = rounds({PLASTIC: single, BESIDE: (0.003, NEAR)})
    assert kept == BESIDE
    assert [stage for stage, _ in said] == ["coarse grid", "richer models, round 1"]


def test_each_round_adds_to_the_single_model_and_to_the_most_promising_one(rounds):
    kept, said, compared = rounds({PLASTIC: (0.3, FAR), BESIDE: (0.2, FAR), COATED: (0.01, NEAR)})
    assert kept == COATED
    assert [stage for stage, _ in said] == ["coarse grid", *(f"richer models, round {k}" for k in (1, 2))]
    tried = [set(names.split(", ")) for _, names in said]
    assert RINGED.variant in tried[2]
    assert COATED.variant in tried[2]
    assert BESIDE.variant not in tried[2]  # it was tried in the first
    assert len(compared) == len({(c.model, c.variant) for c in compared})


def test_there_are_three_rounds_at_most(rounds):
    deepest = Sum(EPD(), RINGED, coated=True)
    kept, said, _ = rounds({PLASTIC: (0.5, FAR), RINGED: (0.4, FAR), deepest: (0.3, FAR)})
    assert kept == deepest
    assert [stage for stage, _ in said] == ["coarse grid", *(f"richer models, round {k}" for k in (1, 2, 3))]
    assert {lowest(m) for m in (deepest, RINGED)} == {PLASTIC}


def test_all_bins_decide_between_the_single_model_and_the_richer_one(rounds):
    coarse = {PLASTIC: (0.02, 1.0), BESIDE: (0.003, NEAR)}
    kept, _, compared = rounds(coarse, on_all_bins={PLASTIC: (0.02, 1.0), BESIDE: (0.05, FAR)})
    assert kept == PLASTIC
    assert np.isclose(min(c.cost for c in compared), 0.003)
