"""The calibration materials of ``merlfit cost``, all of them synthetic, and what one fit of one of them comes to.

Half are drawn: the two-scale model itself with random parameters of plausible materials, every body in turn, times
log-normal noise of 3 %. The others are published parameters of other models, which no fit can meet.
"""

import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...merl_io.binary import write
from ...merl_io.grid import merl_grid
from ...merl_io.inputs import Input
from ...model.effects import KINDS, TWO_SCALE
from ...model.measured import Measured
from ...model.two_scale import TwoScale
from ..fit.outcome import Fitted
from ..fit.problem import Problem, directions
from ..fit.residuals import predict
from ..pipeline.models import layout_for, variant
from ..pipeline.run import assess, fit_file
from ..pipeline.search import AnySamples
from ..pipeline.synthesis import from_published
from ..settings.choice import REFERENCE, Choice
from ..settings.config import Config, load
from ..support.compilation import programs_ready
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
    """Names of all calibration materials."""
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


def measure(choice: Choice, path: Path, references: Path, repeats: int) -> dict[str, Any]:
    """One point on one material; the reference fit leaves its outcome in the folder ``references``."""
    config, kept = load(posterior=False), references / f"{path.stem}.npz"
    seconds, last = _timed(choice, config, path, repeats)
    fitted, measurement, samples, problem, estimated, estimate_seconds = last
    model, reference = (fitted.layout, fitted.solution.z), REFERENCE.settings(config)
    if choice == REFERENCE:
        references.mkdir(parents=True, exist_ok=True)
        best = assess(*resume_fit(model, reference, samples), measurement, samples)
        np.savez(
            kept, z=best.solution.z, values=best.values, errors=best.standard_errors,
            free=[bound == "no" for bound in best.at_bound], variant=best.material.variant,
        )  # fmt: skip
    with np.load(kept, allow_pickle=False) as file:
        best = dict(file)
    chosen, same = str(best["variant"]), str(best["variant"]) == fitted.material.variant
    target = layout_for(reference, variant(reference, TWO_SCALE, chosen)), best["z"]
    away = (np.abs(fitted.values - best["values"]) / best["errors"])[best["free"]] if same else None
    return {
        "body": fitted.material.variant, "status": fitted.status.name, "cost": fitted.solution.cost,
        "rmse": fitted.errors.rmse, "error": distance(model, target, problem), "estimate": estimated,
        "seconds": seconds, "estimate_seconds": estimate_seconds, "other_body": not same,
        "parameters": None if away is None else float(np.max(away, initial=0.0)), "megabytes": _peak_megabytes(),
    }  # fmt: skip


Seen = tuple[Fitted, Input, AnySamples, Problem, float, float]  # a fit's end, the estimate of its error, its seconds


def _timed(choice: Choice, config: Config, path: Path, repeats: int) -> tuple[float, Seen]:
    """Median seconds of fits during which nothing was compiled, without their estimates; the last fit."""
    seen: list[Seen] = []

    def finish(fitted: Fitted, measurement: Input, samples: AnySamples) -> tuple[Fitted, None]:
        start, problem = time.perf_counter(), reference_problem(samples)
        error = estimate((fitted.layout, fitted.solution.z), problem, config)
        seen[:] = [(fitted, measurement, samples, problem, error, time.perf_counter() - start)]
        return fitted, None

    clean: list[float] = []
    with tempfile.TemporaryDirectory() as out:
        for _ in range(repeats + ATTEMPTS):
            before = programs_ready()
            spent = fit_file(path, Path(out), choice.settings(config), finish=finish).seconds
            if not seen:
                raise ValueError(f"{path}: has too little light to be fitted; see `merlfit check`")
            clean += [spent["total"] - spent["accuracy"]] if programs_ready() == before else []
            if len(clean) == repeats:
                return float(np.median(clean)), seen[0]
    raise RuntimeError(f"{path}: after {ATTEMPTS} fits programs are still being compiled")


def _peak_megabytes() -> float:
    """Largest memory that this process has held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
