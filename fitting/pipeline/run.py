"""From a file to a result: the whole line, one call a stage."""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...merl_io import inputs, scattered
from ...merl_io.atomic import refused
from ...merl_io.inputs import Input
from ...merl_io.samples import Runs, Samples, runs_for, thin
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples
from ...model.measured import Measured
from ...model.reflectance import Reflectance, of_order
from ...model.sum import lowest
from ...model.two_scale import TwoScale
from ..fit import error_metrics, plausible, scattered_errors
from ..fit.hints import StartHints, hints_of
from ..fit.largest_albedo import largest_albedo
from ..fit.levenberg_marquardt import BLACK, LEAST_BINS, UNEXPLAINED_COST, Solution, solve, solve_many
from ..fit.outcome import Fitted
from ..fit.problem import Problem, make_problem
from ..fit.published_errors import assess_prediction
from ..fit.residuals import Objective
from ..fit.residuals import predict_samples as predicted_by
from ..fit.selection import (
    ENOUGH,
    MUCH,
    NEAR,
    VISIBLE,
    WORTH,
    choose,
    choose_sum,
    error_of,
    errors_of,
    nearest,
    promising,
    score,
)
from ..fit.starts import start_hints, starting_points
from ..fit.transforms import Layout
from ..fit.weights import found_error, weighted_samples
from ..results import schema, storage
from ..settings.config import Config
from ..settings.sections import AUTO, FitSection
from ..support.choices import THETA_MAX
from ..support.clock import Clock, Report, silent
from ..support.kept import loaded_ahead
from ..support.threads import CORES, one_core_a_call
from .draws import chain_of
from .models import candidates, layout_for, with_more, with_sums
from .result import make_result

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
MOST_ROUNDS, SAME_ERROR = 4, 0.05  # of weights with what the model errs by, and a change of it that ends them
APART = 0.3  # in standard deviations of the prior: points nearer to each other are on the way to the same minimum
# What `auto` tries where more than so much is left, or spheres are further off than that
RICHER = (with_sums, ENOUGH, NEAR), (with_more, MUCH, VISIBLE), (with_more, MUCH, VISIBLE)
Finish = Callable[[Fitted, Input, AnySamples], tuple[Fitted, schema.Accuracy | None]]


class Found(NamedTuple):
    """A fit that was made elsewhere, of a file with this SHA-1: where it ended, what was compared, seconds it took."""

    layout: Layout
    solution: Solution
    candidates: list[schema.Candidate]
    sha1: str
    seconds: float


def fit_file(
    path: str | os.PathLike[str] | Input,
    out: str | os.PathLike[str],
    config: Config,
    report: Report = silent,
    finish: Finish | None = None,
    found: Found | None = None,
) -> schema.Result:
    """Fit one file, or what was read of it, and sample its posterior: ``out/NAME.json`` and the chain beside it.

    Args:
        report: called with a few words on what is being done.
        finish: looks at the fit before it is written, and may go on from there (``accuracy.Aim.finish``).
        found: its fit, if there is one already; of another file it is ignored.

    Raises:
        merlfit.merl_io.binary.MerlError: the file cannot be used.
    """
    clock, out = Clock(), Path(out)
    with refused(out, "made"):
        out.mkdir(parents=True, exist_ok=True)
    kind = Path(path).suffix if isinstance(path, str | os.PathLike) else path.path.suffix
    occasion = repr((kind, config.model, config.effects, config.posterior.enabled, config.fit))
    with loaded_ahead(occasion, remember=config.model.name != AUTO and found is None):
        return _fit_file(path, out, config, report, finish, found, clock)


def _fit_file(
    path: str | os.PathLike[str] | Input,
    out: Path,
    config: Config,
    report: Report,
    finish: Finish | None,
    found: Found | None,
    clock: Clock,
) -> schema.Result:
    with clock.stage("read"):
        report("reading")
        measurement = (
            inputs.read(path, dims=config.input.allowed, quantity=config.input.quantity)
            if isinstance(path, str | os.PathLike)
            else path
        )
        if isinstance(measurement, ScatteredMeasurement):
            config = config.for_scattered
        samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    if found is not None and found.sha1 == measurement.sha1:
        report("errors on all bins")
        fitted = _arrived(found, measurement, samples, config, clock)
    else:
        fitted = fit(measurement, samples, config, report, clock)
    accuracy = None
    if fitted is not None and (fitted.exponent, fitted.model_error) != (config.exponents[0], None):
        samples = weighted_samples(measurement, fitted.exponent, config.fit.theta_max, fitted.model_error)
    if fitted is not None and finish is not None:
        with clock.stage("accuracy"):
            report("accuracy")
            fitted, accuracy = finish(fitted, measurement, samples)
    result = make_result(measurement, samples, fitted, None, config, clock.times(), accuracy)
    target = out / f"{measurement.name}.json"
    storage.write_result(target, result)  # before the sampling, which may be interrupted
    if fitted is not None and config.posterior.samples(fitted.layout.size) and fitted.status.succeeded:
        with clock.stage("posterior"):
            try:
                from ..posterior.sampling import sample  # its libraries take a second to load

                sampled = sample(
                    fitted, samples, config.posterior.max_steps, config.seed, chain_of(target), report=report
                )
            except RuntimeError as error:
                raise RuntimeError(f"{error}; {target} holds the fit without a posterior") from error
        result = make_result(measurement, samples, fitted, sampled, config, clock.times(), accuracy)
        storage.write_result(target, result)
    return result


def _arrived(found: Found, measurement: Input, samples: AnySamples, config: Config, clock: Clock) -> Fitted:
    """A fit with its errors, and its seconds on the clock."""
    clock.spent("together", found.seconds)
    with clock.stage("metrics"):
        fitted = assess(found.layout, found.solution, measurement, samples, config.fit.theta_max)
    return replace(fitted, candidates=found.candidates, exponent=config.exponents[0])


@one_core_a_call
def fit(
    measurement: Input,
    samples: AnySamples,
    config: Config,
    report: Report = silent,
    clock: Clock | None = None,
    first: Mapping[str, float] | None = None,
) -> Fitted | None:
    """Coarse grid first for every candidate, then all valid bins for the best; None without enough light.

    Args:
        first: shared parameters to start from instead of those read off the data.
    """
    clock = clock or Clock()
    if too_dark(samples):
        return None
    with clock.stage("coarse"):
        data, few, (problem, roughly) = start_hints(samples), thinned(samples, COARSE), make_coarse(samples)

        def searched(models: list[Measured]) -> list[Searched]:
            report(f"coarse grid: {', '.join(model.variant for model in models)}")
            layouts = [layout_for(config, model, samples.bands) for model in models]
            rough = [searched_for(each) for each in layouts]
            found = fit_coarse(rough, data, problem, roughly, config, first)
            return [*map(Searched, layouts, rough, found)]

        tried, auto = searched(candidates(config)), config.model.name == AUTO
        compared, chosen = compare(tried, few, seen=auto)
        single, kinds = chosen, len(tried)
        for richer, left, off in RICHER if auto else ():
            if (compared[chosen].cost or 0.0) <= left and (compared[chosen].picture or 0.0) <= off:
                break
            bases = [tried[k].layout.material for k in (single, promising(compared, single, kinds))]
            known = [each.layout.model for each in tried]
            if more := [model for model in richer(config, *bases) if model not in known]:
                tried += searched(more)
                compared, chosen = compare(tried, few, single, kinds, seen=True)
    ended = [finished(tried[k], problem, measurement, samples, config, clock, report) for k in sorted({single, chosen})]
    seen = all(np.isfinite(each.errors.picture) for each in ended)
    return replace(min(ended, key=partial(_error, seen=seen)), candidates=compared)


@one_core_a_call
def descend(
    layout: Layout, z: np.ndarray, measurement: Input, samples: AnySamples, config: Config, clock: Clock
) -> list[Fitted]:
    """The last grid, with one weight after the other, each from where the one before it ended.

    Args:
        samples: with the first of `Config.exponents`.

    Returns:
        the fit with the last weights, or those with all of them, among which ``adaptive`` chooses.
    """
    settings, found = config.fit, []
    for k, exponent in enumerate(config.exponents):
        with clock.stage("full"):
            own = samples if k == 0 else weighted_samples(measurement, exponent, settings.theta_max)
            solution = last_steps(layout, z, own, settings)
            for _ in range(MOST_ROUNDS):
                if not isinstance(own, ScatteredSamples) or own.model_error is None:
                    break
                error = found_error(own, predict_samples(layout, solution.z, own), layout.size)
                if abs(np.log(error / own.model_error)) < SAME_ERROR:
                    break
                own = weighted_samples(measurement, exponent, settings.theta_max, error)
                solution = last_steps(layout, solution.z, own, settings)
            z = solution.z
        if settings.weights == "adaptive" or k == len(config.exponents) - 1:
            with clock.stage("metrics"):
                found.append(replace(assess(layout, solution, measurement, own, settings.theta_max), exponent=exponent))
    return found


def last_steps(layout: Layout, z: np.ndarray, samples: AnySamples, settings: FitSection) -> Solution:
    """Where a fit comes to from here on its last grid."""
    problem = make_problem(thinned(samples, GRIDS[settings.grid]), settings.azimuths, settings.precision)
    return solve(Objective(layout, problem), z, settings.max_steps, backend=settings.backend)


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


def finished(
    found: Searched, problem: Problem, measurement: Input, samples: AnySamples, config: Config, clock: Clock,
    report: Report,
) -> Fitted:  # fmt: skip
    """Where a model comes to from the coarse grid's ``problem`` on the last grid."""
    layout, rough, solution = found
    z, last = solution.z, cheaper(layout, COARSE_ORDER)
    if last != rough:  # the conserving split costs a hundred times as much, and moves a fit a little
        with clock.stage("coarse"):
            z = solve(Objective(last, problem), z, config.fit.coarse_steps, backend=config.fit.backend).z
    report(f"{config.fit.grid} grid: {layout.model.variant}")
    ends = descend(layout, z, measurement, samples, config, clock)
    return ends[nearest([(f.errors.picture, f.errors.highlight) for f in ends])]


def _error(fitted: Fitted, seen: bool) -> float:
    """What richer models are judged by on the coarse grid, on all data: few samples may not say which is the better.

    Args:
        seen: whether all that are compared have a picture.
    """
    e, highlight = fitted.errors, fitted.errors.highlight
    look = e.picture if seen else e.cube_root
    found = error_of(fitted.solution.cost, look, highlight if np.isfinite(highlight) else None)
    return found if np.isfinite(found) else np.inf


def compare(
    tried: Sequence[Searched], samples: AnySamples, taken: int | None = None, first: int = 0, seen: bool = False
) -> tuple[list[schema.Candidate], int]:
    """Fits of the same samples, the simplest model first, and which of them to take (`selection`).

    Args:
        taken: which of those before ``first`` was taken, if the others are richer models to take in its place.
        seen: whether to compare pictures and highlights, too.
    """
    layouts, found = [each.rough for each in tried], [each.solution for each in tried]
    materials = [layout.material for layout in layouts]
    if len(found) == 1 and not seen:
        only = materials[0]
        return [schema.Candidate(model=only.name, variant=only.variant, cost=storage.finite(found[0].cost))], 0
    predicted = [predict_samples(layout, s.z, samples) for layout, s in zip(layouts, found, strict=True)]
    objectives = [float(np.nan_to_num(s.objective, nan=np.inf)) for s in found]
    count = count_of(samples, predicted[int(np.argmin(objectives))])
    cube_root = (
        scattered_errors.cube_root_error if isinstance(samples, ScatteredSamples) else error_metrics.cube_root_error
    )
    roots = [cube_root(samples, p) for p in predicted]  # pyright: ignore[reportArgumentType] - each of its own kind
    looks = [_seen(samples, p) if seen else (None, None) for p in predicted]
    scores = [score(j, e, count) for j, e in zip(objectives, roots, strict=True)]
    values = [valued(layout, s.z) for layout, s in zip(layouts, found, strict=True)]
    matter = [plausible.of_matter(material, v) for material, v in zip(materials, values, strict=True)]
    candidates = [
        schema.Candidate(
            model=material.name, variant=material.variant, cost=storage.finite(s.cost), objective=storage.finite(j),
            cube_root=storage.finite(e), picture=picture, highlight=highlight, score=storage.finite(each),
            of_matter=own, converged=s.converged,
        )
        for material, s, j, e, (picture, highlight), each, own in zip(
            materials, found, objectives, roots, looks, scores, matter, strict=True
        )
    ]  # fmt: skip

    def excessive(k: int) -> bool:
        brightest = largest_albedo(materials[k], values[k], layouts[k].bands)
        return brightest is not None and brightest.excessive

    if taken is not None:
        errors = errors_of(candidates)
        beside = [k for k in range(first, len(materials)) if matter[k] and not _idle(k, materials, errors)]
        return candidates, choose_sum(taken, beside, candidates, [layout.size for layout in layouts], excessive)
    dielectric, explains = ["k" not in v for v in values], [s.cost <= UNEXPLAINED_COST for s in found]
    return candidates, choose(objectives, roots, scores, matter, dielectric, explains, excessive)


def _seen(samples: AnySamples, predicted: np.ndarray) -> tuple[float | None, float | None]:
    """Picture and highlight on the coarse grid; None where there is none."""
    if isinstance(samples, ScatteredSamples):
        found = scattered_errors.pictures(samples, predicted)[0], scattered_errors.highlight(samples, predicted)
    else:
        found = error_metrics.picture_of_few(samples, predicted), error_metrics.highlight_of_few(samples, predicted)
    return storage.finite(found[0]), storage.finite(found[1])


def _idle(k: int, materials: Sequence[Reflectance], errors: Sequence[float]) -> bool:
    """Whether a film does little that its complex index alone would not do: with both a felt would pass for a film."""
    film = lowest(materials[k])
    if not (isinstance(film, TwoScale) and film.index == "film"):
        return False
    bare = (j for j, m in enumerate(materials) if isinstance(m, TwoScale) and m.kind == ("complex", film.body))
    return any(errors[k] > WORTH * errors[j] for j in bare)


def valued(layout: Layout, z: np.ndarray) -> dict[str, np.ndarray]:
    """Physical values by name."""
    return {name: np.asarray(x) for name, x in layout.values(z).items()}


def assess(
    layout: Layout, solution: Solution, measurement: Input, samples: AnySamples, theta_max: float = THETA_MAX
) -> Fitted:
    """A solution with its cost on all bins, its errors and the effective count of its residuals."""
    predicted = predict_samples(layout, solution.z, samples)
    errors, costs = assess_prediction(predicted, measurement, samples, theta_max)
    whole = replace(solution, cost=float(costs.sum()))
    error = samples.model_error if isinstance(samples, ScatteredSamples) else None
    return Fitted(layout, whole, costs, count_of(samples, predicted), errors, [], model_error=error)


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
            if stage.rough and backend == "optimistix":
                return follow_many(points, limits)
            models, where = (rough, roughly) if stage.rough else (layouts, problem)
            pairs = [(layout, z) for layout, each in zip(models, points, strict=True) for z in each]
            solved = pool.map(lambda pair: solve(Objective(pair[0], where), pair[1], backend=backend, **limits), pairs)
            return [list(islice(solved, len(each))) for each in points]

        def follow_many(points: list[np.ndarray], limits: Mapping[str, Any]) -> list[list[Solution]]:
            """Several by each call: on few bins it takes as long as what it computes."""
            shares = [_shared_out(each) for each in points]
            pairs = [(Objective(layout, roughly), z) for layout, each in zip(rough, shares, strict=True) for z in each]
            solved = pool.map(lambda pair: solve_many(pair[0].normal_equations_of_many, pair[1], **limits), pairs)
            together = [list(chain.from_iterable(islice(solved, len(each)))) for each in shares]
            return [found[: len(each)] for found, each in zip(together, points, strict=True)]

        return successive_halving(points, follow, config, [0] * len(points))


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


def predict_samples(layout: Layout, z: np.ndarray, samples: AnySamples) -> np.ndarray:
    """Prediction with the acquisition's loss, 1/sr, of the shape of the values of ``samples``."""
    return predicted_by(layout.model, layout.values(z), samples)


def count_of(samples: AnySamples, predicted: np.ndarray) -> float:
    """Effective sample count of the residuals."""
    if isinstance(samples, ScatteredSamples):
        return scattered_errors.effective_count(samples, predicted)
    return error_metrics.effective_count(np.sqrt(samples.weight) * (samples.value - predicted), samples.weight > 0)
