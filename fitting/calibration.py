"""The calibration materials of ``merlfit cost``, all of them synthetic, and what one fit of one of them comes to.

Half are drawn: the two-scale model itself with random parameters of plausible materials, every body in turn, times
log-normal noise of 3 %. The others are published parameters of other models, which no fit can meet.
"""

import os
import resource
import sys
import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..merl_io.binary import Measurement, write
from ..merl_io.grid import merl_grid
from ..merl_io.samples import Samples
from ..model.effects import BODIES, Effects
from .accuracy import carry_on, distance, estimate, reference_problem
from .choice import REFERENCE, Choice
from .config import Config, load
from .outcome import Fitted
from .problem import Problem, directions
from .residuals import predict
from .run import fit_file, judge
from .synthesis import from_published
from .transforms import layout_of

PLAUSIBLE = {
    "beta": (0.01, 0.5), "p": (0.3, 2.0), "b": (0.3, 30.0), "c": (1.3, 4.0), "sigma_s": (0.005, 0.1),
    "grazing_exponent": (0.1, 0.9), "n": (0.2, 3.0), "k": (1.0, 6.0), "eta": (1.2, 2.0), "albedo": (0.02, 0.9),
}  # fmt: skip
"""Ranges of which parameters are drawn, log-uniformly."""
NOISE = 0.03  # standard deviation of the logarithm
DRAWN = range(10)  # seeds
PUBLISHED = (
    ("nickel", "abc_microfacet"), ("chrome", "smooth"), ("alum-bronze", "cook_torrance"), ("gold-paint", "sgd"),
    ("green-metallic-paint", "cook_torrance_ngan"), ("blue-rubber", "sgd"), ("red-fabric", "smooth"),
    ("cherry-235", "abc_microfacet"), ("pvc", "cook_torrance"), ("white-acrylic", "he"),
)  # fmt: skip
WHAT = (
    f"{len(DRAWN) + len(PUBLISHED)} synthetic materials ({len(DRAWN)} of random parameters of the model itself with "
    f"{NOISE:.0%} noise, {len(PUBLISHED)} of published parameters of other models)"
)
COMPILATION = "/jax/core/compile/backend_compile_duration"
ATTEMPTS = 3  # at a fit during which nothing is compiled


def truth(seed: int, rng: np.random.Generator | None = None) -> tuple[Effects, dict[str, jax.Array]]:
    """Effects and parameters of a random material."""
    rng = rng or _generator(seed)
    effects = Effects(BODIES[seed % len(BODIES)], acquisition="free")
    values = {}
    for q in layout_of(effects).parameters:
        low, high = PLAUSIBLE[q.name]
        values[q.name] = jnp.asarray(low * (high / low) ** rng.uniform(size=3 if q.per_channel else ()))
    return effects, values


def drawn(seed: int) -> np.ndarray:
    """A random material as MERL's apparatus would have stored it, (3, 90, 90, 180), 1/sr."""
    rng, grid = _generator(seed), merl_grid()
    effects, values = truth(seed, rng)
    half = len(grid.phi_d) // 2
    where = directions(grid.theta_h, grid.theta_d, grid.cos_i[..., :half], grid.cos_o[..., :half])
    folded = predict(effects, values, where)
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


@dataclass
class _Probe:
    """Looks at a fit when it ends, and estimates its error as a user's fit would; the reference's is carried on."""

    choice: Choice
    config: Config
    seen: list[tuple[Fitted, Problem, float]] = field(default_factory=list)

    def finish(self, fitted: Fitted, measurement: Measurement, samples: Samples) -> tuple[Fitted, None]:
        problem = reference_problem(samples)
        if self.choice == REFERENCE:
            found = carry_on((fitted.effects, fitted.solution.z), self.choice.settings(self.config), samples)
            fitted = judge(*found, measurement, samples)
        error = estimate((fitted.effects, fitted.solution.z), problem, self.config)
        self.seen.append((fitted, problem, error))
        return fitted, None


def measure(choice: Choice, path: Path, references: Path, repeats: int) -> dict[str, Any]:
    """One point on one material; the reference fit leaves its outcome in the folder ``references``."""
    seconds, probe = _timed(choice, path, repeats)
    if not probe.seen:
        raise ValueError(f"{path}: has too little light to be fitted; see `merlfit check`")
    fitted, problem, estimated = probe.seen[-1]
    kept = references / f"{path.stem}.npz"
    if choice == REFERENCE:
        references.mkdir(parents=True, exist_ok=True)
        free = [bound == "no" for bound in fitted.at_bound]
        np.savez(kept, z=fitted.solution.z, deviation=fitted.deviation, free=free, body=fitted.effects.body)
    with np.load(kept, allow_pickle=False) as reference:
        best = {key: reference[key] for key in reference}
    body = str(best["body"])
    target = REFERENCE.settings(probe.config).effects_of(body), best["z"]  # type: ignore[arg-type]
    same = body == fitted.effects.body
    away = np.abs(fitted.solution.z - best["z"]) / best["deviation"] if same else np.array([])
    return {
        "body": fitted.effects.body, "status": fitted.status.name, "cost": fitted.solution.cost,
        "rmse": fitted.errors.rmse, "estimate": estimated, "seconds": seconds, "other_body": not same,
        "achieved": distance((fitted.effects, fitted.solution.z), target, problem),
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


def _timed(choice: Choice, path: Path, repeats: int) -> tuple[float, _Probe]:
    """Median seconds of fits during which nothing was compiled."""
    config, compiled = load(posterior=False), _compilations()
    probe, clean, others = _Probe(choice, config), [], []
    with tempfile.TemporaryDirectory() as out:
        while len(clean) < repeats and len(others) < ATTEMPTS:
            compiled.clear()
            result = fit_file(path, Path(out), choice.settings(config), finish=probe.finish)
            (others if compiled else clean).append(result.seconds["total"])
    return float(np.median(clean or others[-1:])), probe


def _peak_megabytes() -> float:
    """Largest memory that this process has held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def machine() -> str:
    """What is known of this machine."""
    model = ""
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "")
    return f"{os.cpu_count()} cores{', ' + model if model else ''}"
