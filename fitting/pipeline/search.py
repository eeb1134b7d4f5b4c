"""The search on the coarse grid: from many starting points, by successive halving, for every model at once."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from ...merl_io import scattered
from ...merl_io.samples import Runs, Samples, runs_for, thin
from ...merl_io.scattered import ScatteredSamples
from ...model.reflectance import of_order
from ..fit.hints import StartHints, hints_of
from ..fit.levenberg_marquardt import BLACK, LEAST_BINS, Solution, solve, solve_many
from ..fit.problem import Problem, make_problem
from ..fit.residuals import Objective
from ..fit.starts import starting_points
from ..fit.transforms import Layout
from ..settings.config import Config
from ..support.threads import CORES

# Runs of bins along theta_h, theta_d, phi_d that one bin stands for (merl_io.samples.thin). Near the mirror direction
# every row counts: a lobe narrower than the first kept row would be invisible, and any height of it a perfect fit.
COARSE = ((*(1,) * 6, 3, 3, *(6,) * 13), 5, 1)  # 21 x 18 rows of all azimuths
GRIDS = {"fine": (1, 1, 1), "medium": ((*(1,) * 12, *(3,) * 26), 3, 1), "coarse": COARSE}  # of the last steps
COARSE_AZIMUTHS, COARSE_ORDER = 4, 16  # nodes of a row, order of the convolution
CANDIDATES = ((1, 1, 1, 1, 2, 3, 3, *(13,) * 6), 10, 1)  # 13 x 9 rows, to compare starting points
CANDIDATE_AZIMUTHS, CANDIDATE_ORDER = 2, 8
# Of scattered samples: how many of them do for these grids, candidates in columns of about one theta_d; or which share.
SCATTERED, COLUMNS = {COARSE: 1536, CANDIDATES: 240}, 12
SHARES_OF = {GRIDS["fine"]: 1, GRIDS["medium"]: 7}
AnySamples = Samples | ScatteredSamples
# Successive halving on the coarse grid, steps and points: most basins tell themselves apart within ten steps.
FIRST_ROUND_EACH, FIRST_ROUND, SECOND_ROUND = 3, 6, 14  # the first: for each of `fit.starts`, which go two rounds
# Relative offset at which a round's points go no further: by another step they would lower the cost by 0.25 or 0.01 %.
OFFSET_EARLY, OFFSET_LATE = 0.05, 0.01
MARGINS = 1.6, 1.3  # times the lowest after the first and after the second round: who is so much behind gives up
APART = 0.3  # in standard deviations of the prior: points nearer to each other are on the way to the same minimum


def too_dark(samples: AnySamples) -> bool:
    """Whether too few bins have light to carry a fit."""
    sets = [samples, *(thinned(samples, runs) for runs in (COARSE, CANDIDATES))]
    return min(int(np.any((s.weight > 0) & (s.value > BLACK), axis=0).sum()) for s in sets) < LEAST_BINS


def thinned(samples: AnySamples, runs: tuple[Runs, Runs, Runs]) -> AnySamples:
    """`thin` by runs of MERL's bins, or by what corresponds to them on another grid or among scattered samples."""
    if isinstance(samples, Samples):
        return thin(samples, runs_for(samples, runs))
    if runs in SCATTERED:
        return scattered.thin(samples, SCATTERED[runs])
    return scattered.thin(samples, max(SCATTERED[COARSE], len(samples.theta_h) // SHARES_OF[runs]))


def make_coarse(samples: AnySamples) -> tuple[Problem, Problem]:
    """Problems of the successive halving and of the candidates for its starting points."""
    few, coarse = thinned(samples, CANDIDATES), thinned(samples, COARSE)
    return make_problem(coarse, COARSE_AZIMUTHS), make_problem(few, CANDIDATE_AZIMUTHS, columns=COLUMNS)


class Searched(NamedTuple):
    """A model on the coarse grid.

    Attributes:
        layout: of the model that is asked for. rough: that which was searched in its place.
        solution: the lowest minimum.
    """

    layout: Layout
    rough: Layout
    solution: Solution


def fit_coarse(
    layouts: Sequence[Layout],
    data: StartHints,
    problem: Problem,
    roughly: Problem,
    config: Config,
    first: Mapping[str, float] | None = None,
) -> list[Solution]:
    """The lowest minima that successive halving from many starting points finds with every model, all cores at work.

    Args:
        data, first: where to start (`starts.starting_points`).
        roughly: on which candidates for starting points are compared, and the first round is run (`CANDIDATES`).
    """
    count = FIRST_ROUND_EACH * config.fit.starts
    with ThreadPoolExecutor(max_workers=CORES) as pool:
        rough = [cheaper(layout, CANDIDATE_ORDER) for layout in layouts]
        points = starting_points(rough, data, roughly, count, pool.map, first)

        def follow(points: list[np.ndarray], stage: Round) -> list[list[Solution]]:
            backend, limits = config.fit.backend, {"max_steps": stage.steps, "offset": stage.offset}
            if stage.rough and backend == "trust-region":
                return follow_many(points, limits)
            models, where = (rough, roughly) if stage.rough else (layouts, problem)
            return in_turn(
                pool.map, lambda k, z: solve(Objective(models[k], where), z, backend=backend, **limits), points
            )

        def follow_many(points: list[np.ndarray], limits: Mapping[str, Any]) -> list[list[Solution]]:
            """Several by each call: on few bins it takes as long as what it computes."""
            found = in_turn(
                pool.map,
                lambda k, z: solve_many(Objective(rough[k], roughly).normal_equations_of_many, z, **limits),
                [_shared_out(each) for each in points],
            )
            return [[*chain.from_iterable(of_model)][: len(each)] for of_model, each in zip(found, points, strict=True)]

        return successive_halving(points, follow, config, [0] * len(points))


def in_turn(
    over: Callable[..., Iterable], solved: Callable[[int, np.ndarray], Any], given: Sequence[Any]
) -> list[list[Any]]:
    """Results by model and point; the first points of all models go first: threads load different models' programs.

    Args:
        over: maps a function over numbers of models and over points. solved: what comes of a model, by its number, and
            a point. given: points of every model.
    """
    places = sorted((number, k) for k, each in enumerate(given) for number in range(len(each)))
    results = over(solved, [k for _, k in places], [given[k][number] for number, k in places])
    found = dict(zip(places, results, strict=True))
    return [[found[number, k] for number in range(len(each))] for k, each in enumerate(given)]


def _shared_out(points: np.ndarray) -> list[np.ndarray]:
    """Half the points for each of two calls, the last one repeated where there are too few: one shape to compile."""
    return np.split(np.concatenate([points, points[-1:].repeat(len(points) % 2, 0)]), 2)


class Round(NamedTuple):
    """A round of successive halving: how far its points go, and how many of a team's leaders go on from there.

    Attributes:
        steps: at the most. offset: relative offset at which a point goes no further. rough: whether a few bins will do.
    """

    steps: int
    offset: float
    kept: int
    rough: bool = False


Follow = Callable[[list[np.ndarray], Round], list[list[Solution]]]


def successive_halving(
    points: list[np.ndarray], follow: Follow, config: Config, contests: Sequence[int] | None = None
) -> list[Solution]:
    """The best of many points: all go a few steps, the leaders further, the best of these to the end.

    Args:
        points: free coordinates of every team's starting points, (R, P) each: a team is a body, or a material.
        follow: solutions, by team and point, at the end of a round.
        contests: number of the contest that each team is in, if the teams compete: then who is far behind the leader
            of a contest gives up, and a team that has but such points sends its best one into the second round, and
            none into the last.
    """
    settings = config.fit
    first, second = (min(steps, settings.coarse_steps) for steps in (FIRST_ROUND, SECOND_ROUND))
    rounds = (
        Round(first, OFFSET_EARLY, settings.starts, rough=True),
        Round(second, OFFSET_EARLY, -(-settings.starts // 2)),
        Round(settings.coarse_steps, OFFSET_LATE, 1),
    )
    leaders: list[list[Solution]] = [[] for _ in points]
    for number, stage in enumerate(rounds):
        found = follow(points, stage)
        leaders = [_leaders(each, stage.kept) if each else before for each, before in zip(found, leaders, strict=True)]
        going = leaders
        if contests is not None and number < len(MARGINS):
            lowest = dict.fromkeys(contests, np.inf)
            for contest, each in zip(contests, leaders, strict=True):
                lowest[contest] = min(lowest[contest], _rank(each[0]))
            least = 1 if number == 0 else 0
            going = [
                [s for k, s in enumerate(each) if k < least or _rank(s) <= MARGINS[number] * lowest[contest]]
                for contest, each in zip(contests, leaders, strict=True)
            ]
        points = [np.array([s.z for s in each]) for each in going]
    return [each[0] for each in leaders]


def _rank(solution: Solution) -> float:
    return float(np.nan_to_num(solution.objective, nan=np.inf))


def _leaders(found: list[Solution], most: int) -> list[Solution]:
    """The lowest, each of which is somewhere else than those before it; at least one."""
    chosen: list[Solution] = []
    for s in sorted(found, key=_rank):
        if len(chosen) < most and all(np.linalg.norm(s.z - other.z) > APART for other in chosen):
            chosen.append(s)
    return chosen


def searched_for(layout: Layout) -> Layout:
    """What is looked for on the coarse grid in place of a layout."""
    return cheaper(replace(layout, model=hints_of(layout.model).search or layout.model), COARSE_ORDER)


def cheaper(layout: Layout, order: int) -> Layout:
    """The same with a convolution of no more than this order."""
    return replace(layout, model=of_order(layout.model, order))
