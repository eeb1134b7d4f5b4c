"""From a file to a result: the whole line, one call a stage."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...merl_io import inputs
from ...merl_io.atomic import refused
from ...merl_io.inputs import Input
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples
from ...model.measured import Measured
from ...model.reflectance import Reflectance
from ...model.sum import lowest
from ...model.two_scale import TwoScale
from ..fit import error_metrics, plausible, scattered_errors
from ..fit.largest_albedo import largest_albedo
from ..fit.levenberg_marquardt import UNEXPLAINED_COST, Solution, solve
from ..fit.noise import noise_of
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
from ..fit.starts import start_hints
from ..fit.transforms import Layout
from ..fit.weights import found_error, weighted_samples
from ..results import schema, storage
from ..settings.config import Config
from ..settings.sections import AUTO, FitSection
from ..support.allocation import give_freed_memory_back
from ..support.choices import THETA_MAX
from ..support.clock import Clock, Report, silent
from ..support.kept import loaded_ahead
from ..support.threads import one_core_a_call
from .draws import chain_of
from .models import candidates, layout_for, with_more, with_sums
from .result import make_result
from .search import (
    COARSE,
    COARSE_ORDER,
    GRIDS,
    AnySamples,
    Searched,
    cheaper,
    fit_coarse,
    make_coarse,
    searched_for,
    thinned,
    too_dark,
)

MOST_ROUNDS, SAME_ERROR = 4, 0.05  # of weights with what the model errs by, and a change of it that ends them
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
    with loaded_ahead(config.occasion(kind), remember=config.model.name != AUTO and found is None):
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
    give_freed_memory_back()  # of all bins: what is derived of the fit needs as much again
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

        def searched(models: list[Measured], stage: str = "coarse grid") -> list[Searched]:
            report(f"{stage}: {', '.join(model.variant for model in models)}")
            layouts = [layout_for(config, model, samples.bands) for model in models]
            rough = [searched_for(each) for each in layouts]
            found = fit_coarse(rough, data, problem, roughly, config, first)
            return [*map(Searched, layouts, rough, found)]

        tried, auto = searched(candidates(config)), config.model.name == AUTO
        compared, chosen = compare(tried, few, seen=auto)
        single, kinds = chosen, len(tried)
        for number, (richer, left, off) in enumerate(RICHER if auto else (), 1):
            if (compared[chosen].cost or 0.0) <= left and (compared[chosen].picture or 0.0) <= off:
                break
            bases = [tried[k].layout.material for k in (single, promising(compared, single, kinds))]
            known = [each.layout.model for each in tried]
            if more := [model for model in richer(config, *bases) if model not in known]:
                tried += searched(more, f"richer models, round {number}")
                compared, chosen = compare(tried, few, single, kinds, seen=True)
    give_freed_memory_back()  # of programs that were read meanwhile, and of small grids: what follows is large
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


def finished(
    found: Searched, problem: Problem, measurement: Input, samples: AnySamples, config: Config, clock: Clock,
    report: Report,
) -> Fitted:  # fmt: skip
    """Where a model comes to from the coarse grid's ``problem`` on the last grid."""
    layout, rough, solution = found
    z, last = solution.z, cheaper(layout, COARSE_ORDER)
    if last != rough:  # the conserving split costs forty times as much there, and moves a fit a little
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
    """A solution with its cost on all bins, its errors and the noise of its residuals."""
    predicted = predict_samples(layout, solution.z, samples)
    errors, costs = assess_prediction(predicted, measurement, samples, theta_max)
    whole = replace(solution, cost=float(costs.sum()))
    error = samples.model_error if isinstance(samples, ScatteredSamples) else None
    noise = noise_of(samples, predicted, whole, count_of(samples, predicted), partial(predict_samples, layout))
    return Fitted(layout, whole, costs, noise, errors, [], model_error=error)


def predict_samples(layout: Layout, z: np.ndarray, samples: AnySamples) -> np.ndarray:
    """Prediction with the acquisition's loss, 1/sr, of the shape of the values of ``samples``."""
    return predicted_by(layout.model, layout.values(z), samples)


def count_of(samples: AnySamples, predicted: np.ndarray) -> float:
    """Effective sample count of the residuals."""
    if isinstance(samples, ScatteredSamples):
        return scattered_errors.effective_count(samples, predicted)
    return error_metrics.effective_count(np.sqrt(samples.weight) * (samples.value - predicted), samples.weight > 0)
