"""From a file to a result: the whole line, one call a stage."""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ..merl_io.atomic import write_atomically
from ..merl_io.binary import Measurement, read
from ..merl_io.samples import Samples, thin
from ..model.effects import BODIES, Body
from ..model.parameters import WAVELENGTHS_UM
from . import export, metrics
from .config import Config
from .levenberg_marquardt import Solution, Status, solve
from .posterior import Posterior, laplace_covariance, sample
from .residuals import Forward, Problem, make_problem, predict, weighted_samples
from .selection import bic
from .starts import starting_points
from .transforms import AT_BOUND

# Runs of bins along theta_h, theta_d, phi_d that one bin stands for (merl_io.samples.thin). Near the mirror direction
# every row counts: a lobe narrower than the first kept row would be invisible, and any height of it a perfect fit.
COARSE = ((1, 1, 3, *(5,) * 17), 5, 10)  # 20 x 18 x 9 bins
SAMPLING = ((1, 1, 1, 2, 3, 4, 6, 6, 6, *(10,) * 6), 6, 30)  # 15 x 15 x 3 bins, for the posterior
SAMPLING_ORDER = 16  # of the convolution in the posterior: median error 2e-4
TRIAL_STEPS = 25  # that a screened start is followed before the best is chosen
LEAST_BINS = 30  # fewer bins with light than this, of all or of a thinned grid, cannot carry a dozen parameters
Report = Callable[[str], None]


@dataclass(frozen=True)
class Fitted:
    """A fit on all bins.

    Attributes:
        forward: what was fitted. solution: where it ended. counts: effective sample counts per channel (C,).
        errors: metrics. status: how it ended. candidates: bodies that were compared on the coarse grid.
    """

    forward: Forward
    solution: Solution
    counts: np.ndarray
    errors: metrics.Errors
    status: Status
    candidates: list[export.Candidate]


class _Clock:
    """Seconds by stage, and of everything since the start."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def times(self) -> dict[str, float]:
        return {**self.seconds, "total": round(time.perf_counter() - self.start, 3)}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - start, 3)


def fit_file(path: str | os.PathLike[str], out: Path, config: Config, report: Report = lambda _: None) -> export.Result:
    """Fit one MERL file, sample its posterior, write ``out/NAME.json`` (and the chain beside it).

    Args:
        report: told in a few words what is being done.

    Raises:
        merlfit.merl_io.binary.MerlError: the file cannot be used.
    """
    clock = _Clock()
    with clock.stage("read"):
        report("reading")
        measurement = read(path)
        samples = weighted_samples(measurement)
    fitted = fit(samples, config, report, clock)
    result = make_result(measurement, samples, fitted, None, config, clock.times())
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{measurement.name}.json"
    export.write_result(target, result)  # before the sampling, which may be interrupted
    if fitted is not None and config.posterior.enabled and fitted.status.succeeded:
        with clock.stage("posterior"):
            chain = sample_posterior(fitted, samples, config, report)
            save_chain(out / f"{measurement.name}.chain.npz", fitted, chain)
        result = make_result(measurement, samples, fitted, chain, config, clock.times())
        export.write_result(target, result)
    return result


def fit(samples: Samples, config: Config, report: Report, clock: _Clock) -> Fitted | None:
    """Coarse grid first for every body asked for, then all valid bins for the best; None without enough light."""
    sets = [samples, *(thin(samples, runs) for runs in (COARSE, SAMPLING))]
    if min(int(np.any((s.weight > 0) & (s.value > 0), axis=0).sum()) for s in sets) < LEAST_BINS:
        return None
    with clock.stage("coarse"):
        bodies: tuple[Body, ...] = BODIES if config.fit.body == "auto" else (config.fit.body,)
        report(f"coarse grid: {', '.join(bodies)}")
        coarse = thin(samples, COARSE)
        problem = make_problem(coarse)
        with ThreadPoolExecutor(max_workers=2) as pool:
            found = list(pool.map(lambda body: fit_coarse(config.forward(body), coarse, problem, config), bodies))
        lowest = int(np.argmin(np.nan_to_num([s.cost for s in found], nan=np.inf)))
        forward = config.forward(bodies[lowest])
        counts = counts_of(coarse, predict_samples(forward, found[lowest].z, coarse, problem))
        candidates = [
            export.Candidate(
                body=body, cost=export.finite(s.cost), bic=export.finite(bic(s.normal[:, -1, -1], counts, len(s.z)))
            )
            for body, s in zip(bodies, found, strict=True)
        ]
        chosen = min(range(len(bodies)), key=lambda i: np.inf if (b := candidates[i].bic) is None else b)
    with clock.stage("full"):
        report(f"all bins: {bodies[chosen]}")
        forward, whole = config.forward(bodies[chosen]), make_problem(samples)
        solution = solve(forward, found[chosen].z, whole, config.fit.max_steps, backend=config.fit.backend)
    with clock.stage("metrics"):
        predicted = predict_samples(forward, solution.z, samples, whole)
        counts = counts_of(samples, predicted)
        axes = (samples.theta_h, samples.theta_d, samples.phi_d)
        used = np.all(samples.weight > 0, axis=0)
        errors = metrics.errors(samples.value, predicted, used, axes, samples.cos_i, samples.cos_o)
    return Fitted(forward, solution, counts, errors, judge(forward, solution), candidates)


def fit_coarse(forward: Forward, samples: Samples, problem: Problem, config: Config) -> Solution:
    """Screen the starting points by cost, follow the best few for a while, and the best of these to the end."""

    def follow(z: np.ndarray, steps: int) -> Solution:
        return solve(forward, z, problem, steps, backend=config.fit.backend)

    points = starting_points(forward, samples)
    costs = [solve(forward, z, problem, 1).cost for z in points]
    order = np.argsort(np.nan_to_num(costs, nan=np.inf))[: config.fit.starts]
    trials = [follow(points[i], min(TRIAL_STEPS, config.fit.coarse_steps)) for i in order]
    best = min(trials, key=lambda s: s.cost if np.isfinite(s.cost) else np.inf)
    rest = config.fit.coarse_steps - best.steps
    return best if best.converged or rest <= 0 else follow(best.z, rest)


_predict = partial(jax.jit, static_argnums=0)(predict)


def predict_samples(forward: Forward, z: np.ndarray, samples: Samples, problem: Problem) -> np.ndarray:
    """Prediction with the acquisition's loss on the grid of ``samples``, (C, H, D, P), 1/sr."""
    blocks = np.asarray(_predict(forward, forward.layout.values(jnp.asarray(z)), problem))
    return np.moveaxis(blocks, 1, 0).reshape(samples.value.shape)


def counts_of(samples: Samples, predicted: np.ndarray) -> np.ndarray:
    """Effective sample count of every channel's residuals, (C,)."""
    used = np.all(samples.weight > 0, axis=0)
    residuals = np.sqrt(samples.weight) * (samples.value - predicted)
    return np.array([metrics.effective_count(r, used) for r in residuals])


def judge(forward: Forward, solution: Solution) -> Status:
    """The status of a fit on all bins."""
    if not np.isfinite(solution.cost):
        return Status.NON_FINITE
    if not solution.converged:
        return Status.STEP_LIMIT
    u = forward.layout.position(solution.z)
    at_bound = np.any((u < AT_BOUND) | (u > 1 - AT_BOUND))
    return Status.AT_BOUND if at_bound else Status.CONVERGED


def sample_posterior(fitted: Fitted, samples: Samples, config: Config, report: Report) -> Posterior:
    """The posterior on the sampling grid."""
    cheap = replace(fitted.forward.effects, order=min(SAMPLING_ORDER, fitted.forward.effects.order))
    forward = replace(fitted.forward, effects=cheap)
    whole, thinned = make_problem(samples), make_problem(thin(samples, SAMPLING))
    return sample(
        (fitted.forward, whole), (forward, thinned), fitted.solution.z, fitted.solution.normal, fitted.counts,
        config.posterior.max_steps, config.seed,
        lambda done, most: report(f"posterior: {done} of at most {most} steps"),
    )  # fmt: skip


def save_chain(path: Path, fitted: Fitted, chain: Posterior) -> None:
    """The whole chain in free coordinates and the kept samples in physical units (npz, no pickles)."""
    layout = fitted.forward.layout
    arrays = {
        "names": np.array(layout.names),
        "chain_free": chain.chain.astype(np.float32),
        "log_prob": chain.log_prob,
        "values": chain.values(layout).astype(np.float32),
    }
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def make_result(
    measurement: Measurement,
    samples: Samples,
    fitted: Fitted | None,
    chain: Posterior | None,
    config: Config,
    seconds: dict[str, float],
) -> export.Result:
    """Everything that is known about one material, as it goes to JSON."""
    source = export.Source(
        path=str(measurement.path), material=measurement.name, sha1=measurement.sha1,
        git_blob_sha1=measurement.blob_sha1, genuine_merl=measurement.genuine,
        fraction_valid=float(measurement.valid.mean()),
    )  # fmt: skip
    bins = int(np.any(samples.weight > 0, axis=0).sum())
    common = {
        "source": source, "seconds": seconds, "seed": config.seed,
        "versions": export.versions(), "config": config.model_dump(mode="json"),
    }  # fmt: skip
    if fitted is None or not np.isfinite(fitted.solution.cost):
        status = Status.NO_DATA if fitted is None else Status.NON_FINITE
        fit_part = export.Fit(
            status=status.name, message=status.value, succeeded=False, cost=None, cost_per_channel=None,
            folding_scatter=None, steps=0, relative_offset=None, bins=bins, candidates=[],
        )  # fmt: skip
        return export.Result(
            model=None, parameters=[], fit=fit_part, metrics=export.Metrics(rmse=None, smape=None), posterior=None,
            **common,
        )  # fmt: skip
    s, unit = fitted.solution, float(np.sum(samples.weight * samples.value**2)) + samples.scatter
    fit_part = export.Fit(
        status=fitted.status.name, message=fitted.status.value, succeeded=fitted.status.succeeded, cost=s.cost,
        cost_per_channel=s.normal[:, -1, -1].tolist(), folding_scatter=samples.scatter / unit, steps=s.steps,
        relative_offset=export.finite(s.offset), bins=bins, candidates=fitted.candidates,
    )  # fmt: skip
    errors = export.Metrics(rmse=export.finite(fitted.errors.rmse), smape=export.finite(fitted.errors.smape))
    posterior = None if chain is None else _posterior_part(chain, fitted, measurement.name)
    return export.Result(
        model=_model_part(fitted.forward, s.z), parameters=parameter_results(fitted, chain), fit=fit_part,
        metrics=errors, posterior=posterior, **common,
    )  # fmt: skip


def parameter_results(fitted: Fitted, chain: Posterior | None) -> list[export.ParameterResult]:
    """Every entry with value, Laplace standard error, posterior quantiles, bounds."""
    layout, z = fitted.forward.layout, fitted.solution.z
    deviation = np.sqrt(np.diag(laplace_covariance(fitted.solution.normal, fitted.counts, z)))
    values, slopes = jax.jvp(layout.values, (jnp.asarray(z),), (jnp.ones(len(z)),))
    flat = [np.concatenate([np.ravel(part[q.name]) for q in layout.parameters]) for part in (values, slopes)]
    u = layout.position(z)
    quantiles = None
    if chain is not None and chain.sufficient:
        quantiles = np.quantile(chain.values(layout), [0.05, 0.5, 0.95], axis=0)
    return [
        export.ParameterResult(
            name=name, parameter=q.name, symbol=q.symbol, channel=name.rsplit("_", 1)[-1] if q.per_channel else None,
            meaning=q.meaning, unit=q.unit, value=float(flat[0][i]),
            standard_error=export.finite(abs(flat[1][i]) * deviation[i]) if AT_BOUND <= u[i] <= 1 - AT_BOUND else None,
            quantiles=None if quantiles is None else export.Quantiles(
                q05=float(quantiles[0, i]), q50=float(quantiles[1, i]), q95=float(quantiles[2, i])),
            lower=q.lower, upper=q.upper,
            at_bound="lower" if u[i] < AT_BOUND else "upper" if u[i] > 1 - AT_BOUND else "no",
            prior=q.prior, source=q.source,
        )
        for i, (name, q) in enumerate(zip(layout.names, layout.entries, strict=True))
    ]  # fmt: skip


def _model_part(forward: Forward, z: np.ndarray) -> export.Model:
    e, layout = forward.effects, forward.layout
    return export.Model(
        body=e.body, diffraction=e.diffraction, order=e.order, grazing=forward.grazing,
        grazing_exponent=float(forward.exponent(layout.values(jnp.asarray(z)))), footprint_rad=forward.footprint_rad,
        channels=list(layout.channels), wavelengths_um=list(WAVELENGTHS_UM),
    )  # fmt: skip


def _posterior_part(chain: Posterior, fitted: Fitted, name: str) -> export.PosteriorResult:
    return export.PosteriorResult(
        sufficient=chain.sufficient, message=chain.message, steps=len(chain.chain), walkers=chain.chain.shape[1],
        acceptance=chain.acceptance,
        autocorrelation_steps=np.round(chain.autocorrelation, 2).tolist(),
        effective_size=np.round(chain.effective_size, 1).tolist(),
        effective_bins_per_channel=np.round(fitted.counts, 1).tolist(),
        thinning_error=export.finite(chain.thinning_error), chain_file=f"{name}.chain.npz",
    )  # fmt: skip
