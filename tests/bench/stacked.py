"""Many materials fitted as one program: Levenberg-Marquardt mapped over materials that share their directions.

One material's directions are too few to fill a GPU; the problems of many, stacked, are not. Normal equations and steps
are those of `residuals` and `levenberg_marquardt`, so each material goes the way it would go by itself (costs to 1e-6,
``tests/fitting/test_batch.py``). Materials that have finished stay where they are until all have, their equations being
summed on: a batch takes as long as its slowest. On a CPU, files one by one are faster.
"""

from dataclasses import dataclass
from functools import partial, reduce
from operator import add

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.hints import StartHints
from merlfit.fitting.fit.levenberg_marquardt import solve_many
from merlfit.fitting.fit.problem import Part, Problem, make_problem
from merlfit.fitting.fit.residuals import compact_normal_equations, spread_out
from merlfit.fitting.fit.starts import start_hints, starting_points
from merlfit.fitting.pipeline.run import (
    CANDIDATE_ORDER,
    COARSE_ORDER,
    FIRST_ROUND_EACH,
    GRIDS,
    cheaper,
    make_coarse,
    successive_halving,
)
from merlfit.fitting.support.threads import side_by_side
from merlfit.merl_io.samples import thin


@dataclass(frozen=True)
class Prepared:
    """What a fit needs of one material.

    Attributes:
        data: where to start. coarse, roughly: problems of the search and of the candidates for starting points.
        problem: of the last steps.
    """

    data: StartHints
    coarse: Problem
    roughly: Problem
    problem: Problem


def prepare(samples, config):
    """Samples of a file gathered as `run.fit` does it."""
    settings = config.fit
    whole = make_problem(thin(samples, GRIDS[settings.grid]), settings.azimuths, settings.precision)
    return Prepared(start_hints(samples), *make_coarse(samples), whole)


def fit_batch(layout, materials, config):
    """All materials with the same effects: successive halving on the coarse grid, then the last grid.

    As `run.fit` does it one by one, without its choice of a body and its assessment on all bins.
    """
    cheap, settings = cheaper(layout, COARSE_ORDER), config.fit
    count, rough = FIRST_ROUND_EACH * settings.starts, cheaper(layout, CANDIDATE_ORDER)
    points = [starting_points([rough], m.data, m.roughly, count)[0] for m in materials]

    def follow(points, stage):
        model, problems = (
            (rough, [m.roughly for m in materials]) if stage.rough else (cheap, [m.coarse for m in materials])
        )
        rows = [[each[min(k, len(each) - 1)] for each in points] for k in range(max(map(len, points)))]
        found = [solve_batch(model, np.array(row), problems, stage.steps) for row in rows]
        return [list(each)[: len(own)] for each, own in zip(zip(*found, strict=True), points, strict=True)]

    best = successive_halving(points, follow, config)
    return solve_batch(layout, np.array([s.z for s in best]), [m.problem for m in materials], settings.max_steps)


def solve_batch(layout, z, problems, max_steps=100, rtol=1e-5):
    """`levenberg_marquardt.solve` for many materials at once.

    Args:
        z: starting points, (M, P). problems: of M materials, with the same directions.
        max_steps, rtol: as for `solve`, for every material.

    Raises:
        ValueError: problems whose directions differ.
    """
    stacked = _stack(problems)
    return solve_many(lambda points: _equations(layout, jnp.asarray(points), stacked), z, max_steps, rtol)


def _stack(problems):
    """One problem with a leading axis of materials everywhere but in the directions, which all share."""
    first = problems[0]
    for other in problems[1:]:
        if not eqx.tree_equal([p.directions for p in first.parts], [p.directions for p in other.parts]):
            raise ValueError("materials of a batch must share their directions: grid, azimuths and precision")
    parts = [
        Part(same[0].directions, jnp.stack([p.root for p in same]), jnp.stack([p.target for p in same]))
        for same in zip(*(q.parts for q in problems), strict=True)
    ]
    return Problem(tuple(parts), jnp.stack([q.rest for q in problems]), jnp.stack([q.scatter for q in problems]))


def _equations(layout, z, stacked):
    """Normal equations of all materials, (M, C, P+1, P+1)."""
    by_material = Part(directions=None, root=0, target=0)
    mapped = jax.vmap(partial(compact_normal_equations, layout.model), in_axes=(0, by_material))
    values, slopes = jax.vmap(layout.values_and_slopes)(z)
    compact = reduce(add, side_by_side(lambda part: mapped(values, part), stacked.parts))
    return jax.vmap(partial(spread_out, layout))(slopes, compact, stacked.rest)
