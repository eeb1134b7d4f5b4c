"""What a tier of the diffraction lobe errs by and costs where it is evaluated.

Errors are those of the BRDF against `exact` (Eq. 27), for conductors with parameters drawn between the bounds of the
fit, in directions drawn from all bins of MERL's grid above the horizon. ``tests/tier_errors.py`` does the same at
length; the table of docs/cost.md is this one's.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.experimental.compilation_cache import compilation_cache
from merlfit.fitting.cost import calibration
from merlfit.fitting.cost.frontier import Percentiles
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.merl_io.binary import read
from merlfit.merl_io.grid import merl_grid
from merlfit.model.geometry import Geometry
from merlfit.model.measured import Measured
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.two_scale import TwoScale, two_scale

from .processes import worker
from .record import Record

SEED, SETS, DIRECTIONS = 20261122, 40, 64
WHAT = f"synthetic: {SETS} conductors drawn between the bounds of the fit, {DIRECTIONS} directions of MERL's grid each"
TIERS = {
    "off": TwoScale(diffraction="off"),
    "lobe": TwoScale(diffraction="lobe"),
    "quadrature 8": TwoScale(order=8),
    "quadrature 16": TwoScale(order=16),
    "quadrature 32": TwoScale(),
    "quadrature 64": TwoScale(order=64),
    "exact": TwoScale(diffraction="exact"),
}
LISTED = 2048  # directions of the list that is timed: beyond what is made once for all of them
LISTED_EXACT = 16
REPEATS = 5
TYPICAL = {"beta": 0.12, "p": 0.6, "b": 4.8, "c": 2.2, "sigma_s": 0.027, "n": np.full(3, 1.8), "k": np.full(3, 3.0)}
"""Parameters at which times are taken; those of no tier depend on them."""


def errors() -> dict[str, dict[str, float]]:
    """Percentiles of the relative errors of every tier but `exact`."""
    values, wavelength, geometry = _draws()
    target = _evaluate(TIERS["exact"], values, wavelength, geometry)
    found = {name: _evaluate(TIERS[name], values, wavelength, geometry) for name in TIERS if name != "exact"}
    lit = target > 0
    return {name: Percentiles.of(np.abs(x - target)[lit] / target[lit]).model_dump() for name, x in found.items()}


def _draws() -> tuple[dict[str, Array], np.ndarray, Geometry]:
    """Parameters (S,) each, wavelengths (S,), directions (S, N)."""
    rng = np.random.default_rng(SEED)
    values = {q.name: q.between(jnp.asarray(rng.uniform(size=SETS))) for q in TwoScale().parameters}
    return values, rng.choice(WAVELENGTHS_UM, SETS), _directions(rng, (SETS, DIRECTIONS))


def _directions(rng: np.random.Generator, shape: tuple[int, ...]) -> Geometry:
    grid = merl_grid()
    bins = np.argwhere(grid.above)
    h, d, p = np.moveaxis(bins[rng.integers(len(bins), size=shape)], -1, 0)
    return Geometry.from_half_difference(grid.theta_h[h], grid.theta_d[d], grid.phi_d[p])


def _evaluate(effects: TwoScale, values: dict[str, Array], wavelength: np.ndarray, geometry: Geometry) -> np.ndarray:
    """BRDF of every set in its directions at its wavelength, (S, N)."""

    def one(case: tuple[dict[str, Array], Array, Geometry]) -> Array:
        v, wavelength, g = case
        return two_scale({k: x[None] if k in ("n", "k") else x for k, x in v.items()}, g, effects, wavelength[None])[0]

    return np.asarray(jax.jit(partial(jax.lax.map, one))((values, jnp.asarray(wavelength), geometry)))


def times(name: str, file: Path) -> dict[str, Any]:
    """Nanoseconds a direction of a list and a bin of a file, seconds of compilation (`frontier.Tier`)."""
    effects = TIERS[name]
    fits = {} if name == "exact" else _fit_times(effects, file)
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()  # which may have been asked already
    count = LISTED_EXACT if name == "exact" else LISTED
    g = _directions(np.random.default_rng(SEED), (count,))
    typical = {k: jnp.asarray(v) for k, v in TYPICAL.items()}
    value = jax.jit(lambda v, g: two_scale(v, g, effects))
    gradient = jax.jit(lambda v, g: _with_derivatives(lambda v: two_scale(v, g, effects), v))
    (first, took), (first_gradient, took_gradient) = _clock(value, typical, g), _clock(gradient, typical, g)
    return {
        "value_ns": took / count * 1e9, "gradient_ns": took_gradient / count * 1e9,
        "compile_seconds": (first - took, first_gradient - took_gradient), **fits,
    }  # fmt: skip


def _with_derivatives(evaluate: Callable[[dict[str, Array]], Array], values: dict[str, Array]) -> tuple[Array, Array]:
    """Value and its derivatives, one tangent a parameter: no channel depends on another's entry of n or k."""
    at, slope = jax.linearize(evaluate, values)
    moving = [{k: jnp.full_like(v, k == moved) for k, v in values.items()} for moved in values]
    return at, jax.vmap(slope)(jax.tree.map(lambda *x: jnp.stack(x), *moving))


def _fit_times(effects: TwoScale, file: Path) -> dict[str, float]:
    """Cost and normal equations of all bins as a fit evaluates them."""
    problem, bins = make_problem(weighted_samples(read(file))), merl_grid().above.size
    fitted = Measured(TwoScale(effects.body, effects.diffraction, effects.order))
    layout = layout_of(fitted)
    objective = Objective(layout, problem)
    z = jnp.asarray(layout.free({**TYPICAL, "grazing_exponent": 0.5, "grazing_exponent_diffracted": 0.3}))
    _, value = _clock(lambda z: objective.costs(layout.values(z)), z)
    _, gradient = _clock(objective.normal_equations, z)
    return {"fit_value_ns": value / bins * 1e9, "fit_gradient_ns": gradient / bins * 1e9}


def _clock(compute: Callable[..., Any], *args: Any) -> tuple[float, float]:
    """Seconds of the first call, which compiles, and the median of those after it."""
    seconds = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        jax.block_until_ready(compute(*args))
        seconds.append(time.perf_counter() - start)
    return seconds[0], float(np.median(seconds[1:]))


def measure(name: str, file: str = "") -> dict[str, Any]:
    """Of a process of its own: errors of all tiers, or the times of one."""
    return times(name, Path(file)) if file else errors()


def run(folder: Path, out: Path, every: bool) -> None:
    """Every tier's errors and times."""
    record = Record(
        "tiers", "Tiers of the diffraction lobe", f"{WHAT}; a bin of a fit: a synthetic material",
        ["Relative errors of the BRDF against exact; ns for three channels; seconds to compile the list's programs."],
        folder=out,
    )  # fmt: skip
    found, file = worker("tiers", "all")[0], calibration.make(calibration.names()[0], folder)
    for name in TIERS:
        error, taken = found.get(name, {}), worker("tiers", name, file)[0]
        compiled = dict(zip(("compile s", "with gradient  "), taken.pop("compile_seconds"), strict=True))
        heads = {"value_ns": "a direction ns", "gradient_ns": "with gradient", "fit_value_ns": "a bin of a fit ns",
                 "fit_gradient_ns": "with gradient "}  # fmt: skip
        record.add({
            "tier": name, **{f"error: {k}": error.get(k) for k in ("median", "p95", "worst")},
            **{head: taken.get(key) for key, head in heads.items()}, **compiled,
        })  # fmt: skip
    record.finish()
