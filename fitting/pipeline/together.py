"""Many files fitted together on a GPU: what `run.fit` does of one file, of all of them in the same steps.

What is computed once a file (starting points, the choice of a kind, errors on all bins) is left to the CPU, a thread a
file; the steps of all fits, which take most of the time, are made on the device (`fit.stacked`).
"""

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np

from ...merl_io.samples import Samples
from ..fit.hints import StartHints, general_of
from ..fit.levenberg_marquardt import Solution
from ..fit.problem import Problem, make_problem
from ..fit.stacked import AT_ONCE, Joined, Stack, Start, compile_ahead, joined, solve_stacked, stack
from ..fit.starts import start_hints, starting_points
from ..fit.transforms import Layout
from ..settings.config import Config
from ..support.choices import Device
from ..support.threads import CORES
from .models import candidates, layout_for
from .run import Found, compare
from .search import (
    CANDIDATE_ORDER,
    COARSE,
    COARSE_ORDER,
    FIRST_ROUND_EACH,
    GRIDS,
    Round,
    Searched,
    cheaper,
    make_coarse,
    searched_for,
    successive_halving,
    thinned,
)

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True)
class Prepared:
    """What a fit needs of one material.

    Attributes:
        data: where to start. few: samples of the coarse grid, for the choice of a kind. candidates: the problem of the
            candidates for starting points. roughly, coarse, whole: that one, of the search, and of the last steps.
    """

    data: StartHints
    few: Samples
    candidates: Problem
    roughly: Joined
    coarse: Joined
    whole: Joined
    sha1: str = ""


def on_cpu(compute: Callable[[S], T], every: Iterable[S]) -> list[T]:
    """Results of all, a thread each, whatever device JAX would take."""
    cpu = jax.local_devices(backend="cpu")[0]

    def there(one: S) -> T:
        with jax.default_device(cpu):
            return compute(one)

    with ThreadPoolExecutor(CORES) as pool:
        return list(pool.map(there, every))


def prepare(samples: Samples, config: Config, sha1: str = "") -> Prepared:
    """Samples of a file with this SHA-1, gathered as `run.fit` does it."""
    settings, few = config.fit, thinned(samples, COARSE)
    coarse, roughly = make_coarse(samples)
    whole = make_problem(thinned(samples, GRIDS[settings.grid]), settings.azimuths, settings.precision)
    assert isinstance(few, Samples)
    return Prepared(start_hints(samples), few, roughly, joined(roughly), joined(coarse), joined(whole), sha1)


def fit_together(
    materials: Sequence[Prepared],
    config: Config,
    device: Device,
    at_once: int = AT_ONCE,
) -> list[Found]:
    """Coarse grid first for every candidate of every material, then all valid bins for the best.

    Args:
        at_once: directions that a step may take.

    Raises:
        ValueError: their directions differ.
    """
    begun, solved = time.perf_counter(), partial(_solved, at_once=at_once)
    layouts = [layout_for(config, model, materials[0].few.bands) for model in candidates(config)]
    rough = [searched_for(each) for each in layouts]
    first = [cheaper(each, CANDIDATE_ORDER) for each in rough]
    count, kinds = FIRST_ROUND_EACH * config.fit.starts, range(len(layouts))
    teams = [(m, k) for m in range(len(materials)) for k in kinds]
    roughly, coarse, whole = (
        stack([getattr(m, name) for m in materials], device) for name in ("roughly", "coarse", "whole")
    )
    needed = [(first, roughly, (count + 1) * len(teams)), (rough, coarse, len(teams)), (layouts, whole, len(materials))]
    with ThreadPoolExecutor(len(needed)) as pool:
        compiling = [pool.submit(_compiled_ahead, *each, at_once) for each in needed]
        points = on_cpu(lambda m: starting_points(first, m.data, m.candidates, count), materials)
        for each in compiling:
            each.result()

    def follow(points: list[np.ndarray], stage: Round) -> list[list[Solution]]:
        starts = [Start(k, m, z) for (m, k), each in zip(teams, points, strict=True) for z in each]
        models, problems = (first, roughly) if stage.rough else (rough, coarse)
        every = iter(solved(models, problems, starts, max_steps=stage.steps, offset=stage.offset))
        return [[next(every) for _ in each] for each in points]

    leaders = successive_halving([points[m][k] for m, k in teams], follow, config, [m for m, _ in teams])
    tried = [
        [Searched(layouts[k], rough[k], leaders[m * len(kinds) + k]) for k in kinds] for m in range(len(materials))
    ]
    compared = on_cpu(lambda pair: compare(pair[0], pair[1].few), zip(tried, materials, strict=True))
    chosen = [k for _, k in compared]
    starts = [Start(k, m, leaders[m * len(kinds) + k].z) for m, k in enumerate(chosen)]
    last = [cheaper(each, COARSE_ORDER) for each in layouts]
    if moved := [s for s in starts if last[s.kind] != rough[s.kind]]:
        further = solved(last, coarse, moved, max_steps=config.fit.coarse_steps)
        nearer = {s.material: each.z for s, each in zip(moved, further, strict=True)}
        starts = [s._replace(z=nearer.get(s.material, s.z)) for s in starts]
    ended = solved(layouts, whole, starts, max_steps=config.fit.max_steps)
    seconds = (time.perf_counter() - begun) / len(materials)
    return [
        Found(layouts[k], solution, each, m.sha1, seconds)
        for k, solution, (each, _), m in zip(chosen, ended, compared, materials, strict=True)
    ]


def _compiled_ahead(layouts: Sequence[Layout], problems: Stack, count: int, at_once: int) -> None:
    for rows in _of_one_program(layouts):
        compile_ahead([layouts[k] for k in rows], problems, count, at_once=at_once)


def _of_one_program(layouts: Sequence[Layout]) -> list[list[int]]:
    """Numbers of the layouts, those of one general model together."""
    general = [general_of(each.model).model for each in layouts]
    return [[k for k, each in enumerate(general) if each == model] for model in dict.fromkeys(general)]


def _solved(layouts: Sequence[Layout], problems: Stack, starts: Sequence[Start], **limits: Any) -> list[Solution]:  # noqa: ANN401 - as `solve_stacked` has them
    """Solutions in the order of the starts: those of one program together."""
    found: dict[int, Solution] = {}
    for own in _of_one_program(layouts):
        rows = [k for k, s in enumerate(starts) if s.kind in own]
        moved = [starts[k]._replace(kind=own.index(starts[k].kind)) for k in rows]
        found |= dict(zip(rows, solve_stacked([layouts[k] for k in own], problems, moved, **limits), strict=True))
    return [found[k] for k in range(len(starts))]
