"""The posterior of a fit that is already in a file."""

from dataclasses import replace
from pathlib import Path

from ...merl_io.inputs import Input
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ..fit.levenberg_marquardt import Solution
from ..fit.outcome import Fitted
from ..fit.problem import make_problem
from ..fit.residuals import Objective
from ..fit.weights import weighted_samples
from ..posterior.sampling import sample
from ..results import schema, storage
from ..settings.config import parse
from ..support.clock import Clock, Report, silent
from .draws import chain_of
from .models import layout_for
from .result import posterior_parts, total_scatter_results
from .run import assess


def fitted_of(
    path: Path, result: schema.Result, file: Path | Input
) -> tuple[Fitted, Samples | ScatteredSamples, Input]:
    """The fit that a result is of, with its samples and the measurement.

    Args:
        path: of the result. file: what was fitted, or what was read of it.

    Raises:
        merlfit.merl_io.binary.MerlError: the file is not the one that was fitted.
        merlfit.fitting.results.storage.ResultError: the result has no fit that succeeded.
    """
    if result.edited_from is not None:
        raise storage.ResultError(f"{path}: was {result.edited_words}; it has no posterior: sample that fit")
    if result.model is None or result.fit.weights is None or not result.fit.succeeded:
        raise storage.ResultError(f"{path}: there is no posterior of a fit that ended {result.fit.status}")
    config = parse(result.config, str(path))
    measurement = result.source.read(file) if isinstance(file, Path) else file
    samples = weighted_samples(measurement, result.fit.weights, config.fit.theta_max, result.fit.model_error)
    # the result's model, and not the settings': it may have been carried on with other ones
    layout = layout_for(config, result.model.measured, result.model.bands)
    z, whole = layout.free(result.values()), make_problem(samples, config.fit.azimuths, config.fit.precision)
    normal = Objective(layout, whole).normal_equations(z)
    offset = float("nan") if result.fit.relative_offset is None else result.fit.relative_offset
    solution = Solution(z, float(normal[:, -1, -1].sum()), normal, result.fit.steps, offset, converged=True)
    fitted = assess(layout, solution, measurement, samples, config.fit.theta_max)
    return replace(fitted, exponent=result.fit.weights), samples, measurement


def resample(
    path: Path, result: schema.Result, file: Path | Input, max_steps: int | None = None, report: Report = silent
) -> schema.Result:
    """Sample the posterior of a result, or go on with the chain that lies beside it; the result is written anew.

    Args:
        path: of the result. file: what was fitted, or what was read of it. max_steps: at the most, beside those
            of a finished chain; None for its own.

    Raises:
        merlfit.merl_io.binary.MerlError: the file is not the one that was fitted.
        merlfit.fitting.results.storage.ResultError: the result has no fit to sample.
        merlfit.fitting.posterior.chain.ChainError: the chain is not one of this fit.
        RuntimeError: the sampler failed; the result is as it was.
    """
    clock, chain = Clock(), chain_of(path)
    if result.posterior is not None and not chain.is_file():
        raise storage.ResultError(
            f"{path}: has a posterior, but its chain {chain.name} is not beside it: put it back, or fit again"
        )
    report("reading")
    fitted, samples, measurement = fitted_of(path, result, file)
    config = parse(result.config, str(path))
    with clock.stage("posterior"):
        steps = config.posterior.max_steps if max_steps is None else max_steps
        if result.posterior is not None:  # of which the chain may have gone beyond, if it was stopped before
            steps += result.posterior.steps
        sampled = sample(fitted, samples, steps, result.seed, chain, chain.is_file(), report)
    seconds = result.seconds["total"] + clock.seconds["posterior"]
    spent = result.seconds.get("posterior", 0.0) + clock.seconds["posterior"]
    result = result.model_copy(
        update={
            **posterior_parts(result.parameters, fitted, sampled, measurement.name),
            "tis": total_scatter_results(fitted, measurement, sampled),
            "seconds": {**result.seconds, "posterior": round(spent, 3), "total": round(seconds, 3)},
        }
    )
    storage.write_result(path, result)
    return result
