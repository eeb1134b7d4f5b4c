"""The calibration materials of ``merlfit cost``, all of them synthetic, and what one fit of one of them comes to.

Half are drawn: the two-scale model itself with random parameters of plausible materials, every body in turn, times
log-normal noise of 3 %. The others are published parameters of other models, which no fit can meet.
"""

import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...merl_io.binary import Measurement, write
from ...merl_io.grid import merl_grid
from ...merl_io.samples import Samples
from ...model.effects import KINDS
from ...model.measured import Measured
from ...model.two_scale import TwoScale
from ..fit.outcome import Fitted
from ..fit.problem import Problem, directions
from ..fit.residuals import predict
from ..pipeline.models import candidates, layout_for
from ..pipeline.run import assess, fit_file
from ..pipeline.synthesis import from_published
from ..settings.choice import REFERENCE, Choice
from ..settings.config import Config, load
from .accuracy import distance, estimate, reference_problem, resume_fit

PLAUSIBLE = {
    "beta": (0.01, 0.5), "p": (0.3, 2.0), "b": (0.3, 30.0), "c": (1.3, 4.0), "sigma_s": (0.005, 0.1),
    "grazing_exponent": (0.1, 0.9), "grazing_exponent_diffracted": (0.05, 0.5),
    "n": (0.2, 3.0), "k": (1.0, 6.0), "eta": (1.2, 2.0), "albedo": (0.02, 0.9),
}  # fmt: skip
"""Ranges of which parameters are drawn, log-uniformly."""
NOISE = 0.03  # standard deviation of the logarithm
DRAWN = range(10)  # seeds
PUBLISHED = (
    ("nickel", "abc-microfacet"), ("chrome", "smooth"), ("alum-bronze", "cook-torrance"), ("gold-paint", "sgd"),
    ("green-metallic-paint", "cook-torrance-ngan"), ("blue-rubber", "sgd"), ("red-fabric", "smooth"),
    ("cherry-235", "abc-microfacet"), ("pvc", "cook-torrance"), ("white-acrylic", "he"),
)  # fmt: skip
WHAT = (
    f"{len(DRAWN) + len(PUBLISHED)} synthetic materials ({len(DRAWN)} of random parameters of the model itself with "
    f"{NOISE:.0%} noise, {len(PUBLISHED)} of published parameters of other models)"
)
COMPILATION = "/jax/core/compile/backend_compile_duration"
ATTEMPTS = 3  # fits that may compile something


def truth(seed: int, rng: np.random.Generator | None = None) -> tuple[Measured, dict[str, jax.Array]]:
    """Model and parameters of a random material."""
    rng = rng or _generator(seed)
    index, body = KINDS[seed % len(KINDS)]
    model = Measured(TwoScale(body, index=index))
    values = {}
    for q in model.parameters:
        low, high = PLAUSIBLE[q.name]
        values[q.name] = jnp.asarray(low * (high / low) ** rng.uniform(size=3 if q.per_channel else ()))
    return model, values


def drawn(seed: int) -> np.ndarray:
    """A random material as MERL's apparatus would have stored it, (3, 90, 90, 180), 1/sr."""
    rng, grid = _generator(seed), merl_grid()
    model, values = truth(seed, rng)
    half = len(grid.phi_d) // 2
    where = directions(grid.theta_h, grid.theta_d, grid.cos_i[..., :half], grid.cos_o[..., :half])
    folded = predict(model, values, where)
    brdf = np.concatenate([folded, folded[..., ::-1]], -1)
    return np.where(grid.above, brdf * np.exp(NOISE * rng.normal(size=brdf.shape)), np.nan)


def _generator(seed: int) -> np.random.Generator:
    return np.random.default_rng([20261122, seed])


def names() -> list[str]:
    """Of all calibration materials."""
    return [f"drawn-{seed}" for seed in DRAWN] + [f"{material}.{source}" for material, source in PUBLISHED]


def make(name: str, folder: Path) -> Path:
    """The MERL file of one calibration material, made in the folder unless it is there."""
    path = folder / f"{name}.binary"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        seed = name.removeprefix("drawn-")
        values = drawn(int(seed)) if seed != name else from_published(*name.split("."))[0]
        write(path, values)
    return path


class _Seen(NamedTuple):
    """A fit as it ended, with the estimate of its error and its seconds, and where carrying on takes it."""

    fitted: Fitted
    problem: Problem
    estimate: float
    seconds: float
    further: Fitted | None


@dataclass
class _Probe:
    """Looks at a fit when it ends, and estimates its error as a user's fit would; carries the reference's on."""

    choice: Choice
    config: Config
    seen: _Seen | None = None

    def finish(self, fitted: Fitted, measurement: Measurement, samples: Samples) -> tuple[Fitted, None]:
        start = time.perf_counter()
        problem = reference_problem(samples)
        error = estimate((fitted.layout, fitted.solution.z), problem, self.config)
        seconds, further = time.perf_counter() - start, None
        if self.choice == REFERENCE:
            found = resume_fit((fitted.layout, fitted.solution.z), self.choice.settings(self.config), samples)
            further = assess(*found, measurement, samples)
        self.seen = _Seen(fitted, problem, error, seconds, further)
        return fitted, None


def measure(choice: Choice, path: Path, references: Path, repeats: int) -> dict[str, Any]:
    """One point on one material; the reference fit leaves its outcome in the folder ``references``."""
    config = load(posterior=False)
    seconds, seen = _timed(choice, config, path, repeats)
    fitted, kept = seen.fitted, references / f"{path.stem}.npz"
    if seen.further is not None:
        references.mkdir(parents=True, exist_ok=True)
        best, free = seen.further, [bound == "no" for bound in seen.further.at_bound]
        np.savez(
            kept, z=best.solution.z, values=best.values, errors=best.standard_errors, free=free,
            variant=best.material.variant,
        )  # fmt: skip
    with np.load(kept, allow_pickle=False) as reference:
        best = {key: reference[key] for key in reference}
    reference = REFERENCE.settings(config)
    (model,) = [each for each in candidates(reference) if each.variant == str(best["variant"])]
    target, same = (layout_for(reference, model), best["z"]), model.variant == fitted.material.variant
    away = np.abs(fitted.values - best["values"]) / best["errors"] if same else np.array([])
    return {
        "body": fitted.material.variant, "status": fitted.status.name, "cost": fitted.solution.cost,
        "rmse": fitted.errors.rmse, "error": distance((fitted.layout, fitted.solution.z), target, seen.problem),
        "estimate": seen.estimate, "seconds": seconds, "estimate_seconds": seen.seconds, "other_body": not same,
        "parameters": float(np.max(away[best["free"]], initial=0.0)) if same else None,
        "megabytes": _peak_megabytes(),
    }  # fmt: skip


@cache
def _compilations() -> list[float]:
    """Seconds of every program that is compiled or loaded from now on."""
    seconds: list[float] = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == COMPILATION:
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seconds


def _timed(choice: Choice, config: Config, path: Path, repeats: int) -> tuple[float, _Seen]:
    """Median seconds of fits during which nothing was compiled, without what the probe takes; the last fit."""
    compiled, probe, clean = _compilations(), _Probe(choice, config), []
    with tempfile.TemporaryDirectory() as out:
        for _ in range(repeats + ATTEMPTS):
            compiled.clear()
            spent = fit_file(path, Path(out), choice.settings(config), finish=probe.finish).seconds
            if probe.seen is None:
                raise ValueError(f"{path}: has too little light to be fitted; see `merlfit check`")
            clean += [] if compiled else [spent["total"] - spent["accuracy"]]
            if len(clean) == repeats:
                return float(np.median(clean)), probe.seen
    raise RuntimeError(f"{path}: after {ATTEMPTS} fits programs are still being compiled")


def _peak_megabytes() -> float:
    """Largest memory that this process has held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
