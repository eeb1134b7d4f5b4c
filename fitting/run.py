"""From a file to a result: the whole line, one call a stage."""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from ..merl_io.atomic import write_atomically
from ..merl_io.binary import Measurement, read
from ..merl_io.grid import merl_grid
from ..merl_io.samples import Samples, thin
from ..model.effects import BODIES, Body, Effects
from . import export, metrics
from .config import Config
from .levenberg_marquardt import Solution, solve
from .outcome import Fitted, make_result
from .problem import Problem, directions, energy, make_problem, weighted_samples
from .residuals import predict
from .selection import bic
from .starts import starting_points
from .threads import CORES, side_by_side
from .transforms import layout_of

if TYPE_CHECKING:  # the sampler's libraries take a second to load
    from .posterior import Posterior

# Runs of bins along theta_h, theta_d, phi_d that one bin stands for (merl_io.samples.thin). Near the mirror direction
# every row counts: a lobe narrower than the first kept row would be invisible, and any height of it a perfect fit.
COARSE = ((1, 1, 3, *(5,) * 17), 5, 1)  # 20 x 18 rows of all azimuths
GRIDS = {"fine": (1, 1, 1), "medium": ((*(1,) * 12, *(3,) * 26), 3, 1), "coarse": COARSE}  # of the last steps
COARSE_AZIMUTHS, COARSE_ORDER = 4, 16  # nodes of a row, order of the convolution
SAMPLING = ((1, 1, 1, 2, 3, 4, 6, 6, 6, *(10,) * 6), 6, 30)  # 15 x 15 x 3 bins, for the posterior
SAMPLING_ORDER = 16  # of the convolution in the posterior: median error 2e-4
TRIAL_STEPS = 25  # that a screened start is followed before the best is chosen
LEAST_BINS = 30  # fewer bins with light than this, of all or of a thinned grid, cannot carry a dozen parameters
BLACK = 1e-30  # 1/sr: no more light than this is none
Report = Callable[[str], None]


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
    fitted = fit(measurement, samples, config, report, clock)
    result = make_result(measurement, samples, fitted, None, config, clock.times())
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{measurement.name}.json"
    export.write_result(target, result)  # before the sampling, which may be interrupted
    if fitted is not None and config.posterior.enabled and fitted.status.succeeded:
        with clock.stage("posterior"):
            try:
                chain = sample_posterior(fitted, samples, config, report)
            except Exception as error:  # raised again: whatever stops a sampler, the fit is kept and named
                raise RuntimeError(f"the sampler: {error}; {target} holds the fit without a posterior") from error
            save_chain(out / f"{measurement.name}.chain.npz", fitted, chain)
        result = make_result(measurement, samples, fitted, chain, config, clock.times())
        export.write_result(target, result)
    return result


def fit(measurement: Measurement, samples: Samples, config: Config, report: Report, clock: _Clock) -> Fitted | None:
    """Coarse grid first for every body asked for, then all valid bins for the best; None without enough light."""
    grids = (COARSE, SAMPLING) if config.posterior.enabled else (COARSE,)
    sets = [samples, *(thin(samples, runs) for runs in grids)]
    if min(int(np.any((s.weight > 0) & (s.value > BLACK), axis=0).sum()) for s in sets) < LEAST_BINS:
        return None
    with clock.stage("coarse"):
        bodies: tuple[Body, ...] = BODIES if config.effects.body == "auto" else (config.effects.body,)
        report(f"coarse grid: {', '.join(bodies)}")
        coarse = thin(samples, COARSE)
        problem = make_problem(coarse, COARSE_AZIMUTHS)
        cheap = [cheaper(config.effects_of(body), COARSE_ORDER) for body in bodies]
        with ThreadPoolExecutor(max_workers=CORES) as pool:
            found = list(pool.map(lambda effects: fit_coarse(effects, coarse, problem, config), cheap))
        candidates = compare(cheap, found, coarse)
        chosen = min(range(len(bodies)), key=lambda i: np.inf if (b := candidates[i].bic) is None else b)
    with clock.stage("full"):
        settings = config.fit
        report(f"{settings.grid} grid: {bodies[chosen]}")
        effects = config.effects_of(bodies[chosen])
        whole = make_problem(thin(samples, GRIDS[settings.grid]), settings.azimuths, settings.precision)
        solution = solve(effects, found[chosen].z, whole, settings.max_steps, backend=settings.backend)
    with clock.stage("metrics"):
        return replace(judge(effects, solution, measurement, samples), candidates=candidates)


def compare(effects: list[Effects], found: list[Solution], samples: Samples) -> list[export.Candidate]:
    """Costs of fits of the same samples, and their BICs by the effective counts of the best one's residuals."""
    lowest = int(np.argmin(np.nan_to_num([s.cost for s in found], nan=np.inf)))
    if len(found) == 1:
        return [export.Candidate(body=effects[0].body, cost=export.finite(found[0].cost), bic=None)]
    counts = counts_of(samples, predict_samples(effects[lowest], found[lowest].z, samples))
    return [
        export.Candidate(
            body=e.body, cost=export.finite(s.cost), bic=export.finite(bic(s.normal[:, -1, -1], counts, len(s.z)))
        )
        for e, s in zip(effects, found, strict=True)
    ]


def judge(effects: Effects, solution: Solution, measurement: Measurement, samples: Samples) -> Fitted:
    """A solution with its cost on all bins, its errors and the effective counts of its residuals."""
    predicted = predict_samples(effects, solution.z, samples)
    unfolded = np.concatenate([predicted, predicted[..., ::-1]], -1)  # bins phi_d and pi - phi_d are reciprocal
    errors = metrics.errors(measurement.values, unfolded, measurement.valid, merl_grid())
    costs = np.sum(samples.weight * (samples.value - predicted) ** 2, (1, 2, 3)) / energy(samples)
    normal = solution.normal.copy()
    normal[:, -1, -1] = costs
    exact = replace(solution, cost=float(costs.sum()), normal=normal)
    return Fitted(effects, exact, counts_of(samples, predicted), errors, [])


def fit_coarse(effects: Effects, samples: Samples, problem: Problem, config: Config) -> Solution:
    """Screen the starting points by cost, follow the best few for a while, and the best of these to the end."""

    def follow(z: np.ndarray, steps: int) -> Solution:
        return solve(effects, z, problem, steps, backend=config.fit.backend)

    points = starting_points(effects, samples)
    costs = [solve(effects, z, problem, 1).cost for z in points]
    order = np.argsort(np.nan_to_num(costs, nan=np.inf))[: config.fit.starts]
    trials = [follow(points[i], min(TRIAL_STEPS, config.fit.coarse_steps)) for i in order]
    best = min(trials, key=lambda s: s.cost if np.isfinite(s.cost) else np.inf)
    rest = config.fit.coarse_steps - best.steps
    return best if best.converged or rest <= 0 else follow(best.z, rest)


def cheaper(effects: Effects, order: int) -> Effects:
    """The same with a convolution of no more than this order."""
    return replace(effects, order=min(order, effects.order))


def predict_samples(effects: Effects, z: np.ndarray, samples: Samples) -> np.ndarray:
    """Prediction with the acquisition's loss on the grid of ``samples``, (C, H, D, P), 1/sr."""
    where = directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
    return predict(effects, layout_of(effects).values(jnp.asarray(z)), where)


def counts_of(samples: Samples, predicted: np.ndarray) -> np.ndarray:
    """Effective sample count of every channel's residuals, (C,)."""
    used = np.all(samples.weight > 0, axis=0)
    residuals = np.sqrt(samples.weight) * (samples.value - predicted)
    return np.array(side_by_side(lambda r: metrics.effective_count(r, used), residuals))


def sample_posterior(fitted: Fitted, samples: Samples, config: Config, report: Report) -> "Posterior":
    """The posterior on the sampling grid."""
    from .posterior import sample

    cheap = cheaper(fitted.effects, SAMPLING_ORDER)
    whole, thinned = make_problem(samples), make_problem(thin(samples, SAMPLING))
    return sample(
        (fitted.effects, whole), (cheap, thinned), fitted.solution.z, fitted.solution.normal, fitted.counts,
        config.posterior.max_steps, config.seed,
        lambda done, most: report(f"posterior: {done} of at most {most} steps"),
    )  # fmt: skip


def save_chain(path: Path, fitted: Fitted, chain: "Posterior") -> None:
    """The whole chain in free coordinates and the kept samples in physical units (npz, no pickles)."""
    layout = layout_of(fitted.effects)
    arrays = {
        "names": np.array(layout.names),
        "chain_free": chain.chain.astype(np.float32),
        "log_prob": chain.log_prob,
        "values": chain.values(layout).astype(np.float32),
    }
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))
