"""Fits batched over materials on a GPU (`make bench-gpu`); where JAX sees none, one line says so."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import Part, Problem, make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.stacked import AT_ONCE
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.run import compare
from merlfit.fitting.pipeline.search import (
    COARSE,
    GRIDS,
    Searched,
    fit_coarse,
    make_coarse,
    searched_for,
    thinned,
)
from merlfit.fitting.pipeline.together import fit_together, prepare
from merlfit.fitting.pipeline.together import on_cpu as cpu_threads
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.binary import read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.model.geometry import Geometry
from merlfit.model.published import SOURCES, evaluate, materials

from .record import Record, Target, exponent, machine

COUNTS, COUNTS_ON_CPU = (10, 100, 1000), (1, 2)
MOST = 100  # materials of one batch: of more, one batch after the other
SOURCE = "sgd"
TOLD = ("beta", "p", "b", "sigma_s")  # parameters that are compared with the CPU's
SECONDS = 10.0
ON_CPU = 1 << 16  # directions at once, where a CPU stands in for the GPU
ROWS = 10  # of theta_h evaluated at a time
LEFT = 1e-9  # of the energy: of what leaves less, costs are rounding
GAIN = 0.3  # standard deviation of the logarithm of what colours of materials beyond the published ones are times
ABSENT = "bench-gpu: skipped, JAX sees no GPU, only {}; it needs a jax for one, such as `pip install 'jax[cuda13]'`"


def tabulated(name):
    """BRDF of a published material on MERL's grid, NaN below the horizon."""
    grid, parts = merl_grid(), []
    for rows in np.array_split(np.arange(len(grid.theta_h)), len(grid.theta_h) // ROWS):
        angles = (grid.theta_h[rows, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :])
        parts.append(np.asarray(evaluate(name, SOURCE, Geometry.from_half_difference(*angles), rescaled=True)))
    return np.where(grid.above, np.concatenate(parts, 1), np.nan)


def files(folder, count):
    """Files of so many materials at the most, made unless they are there."""
    names = materials(SOURCE)[:count]

    def made(name):
        path = folder / f"{name}.binary"
        if not path.is_file():
            write(path, tabulated(name))
        return path

    return cpu_threads(made, names)


def varied(material, number):
    """The material itself, or as it is with colours times random numbers: the same weights, light in other units."""
    if number == 0:
        return material
    gains = np.exp(GAIN * np.random.default_rng(number).normal(size=3))
    energy = (material.whole.target**2).sum((0, 2, 3, 4)) + material.whole.rest
    unit = np.sqrt(gains**2 @ energy / energy.sum())
    colours = (gains / unit)[:, None, None, None]

    def lit(each):
        return each._replace(
            root=each.root / unit, target=each.target * colours, rest=each.rest * (gains / unit) ** 2
        )  # fmt: skip

    parts = [
        Part(p.directions, jnp.asarray(p.root / unit), jnp.asarray(p.target * colours))
        for p in material.candidates.parts
    ]
    rest = jnp.asarray(material.candidates.rest * (gains / unit) ** 2)
    return replace(
        material,
        few=replace(material.few, value=material.few.value * gains[:, None, None, None]),
        candidates=Problem(tuple(parts), rest, material.candidates.scatter),
        **{name: lit(getattr(material, name)) for name in ("roughly", "coarse", "whole")},
    )


def weighted(path, config):
    """Samples of a file."""
    return weighted_samples(read(path), config.exponents[0], config.fit.theta_max)


def one_by_one(path, config):
    """A fit of one file on the CPU as `run.fit` makes it, before its errors: cost, kind, and some parameters."""
    samples = weighted(path, config)
    layouts = [layout_for(config, model) for model in candidates(config)]
    rough = [searched_for(each) for each in layouts]
    found = fit_coarse(rough, start_hints(samples), *make_coarse(samples), config)
    _, chosen = compare([*map(Searched, layouts, rough, found)], thinned(samples, COARSE))
    problem = make_problem(thinned(samples, GRIDS[config.fit.grid]), config.fit.azimuths)
    return told(layouts[chosen], solve(Objective(layouts[chosen], problem), found[chosen].z, config.fit.max_steps))


def told(layout, solution):
    """What is compared of a fit."""
    values = layout.values(solution.z)
    return {
        "kind": layout.model.variant, "cost": solution.cost, "steps": solution.steps,
        "converged": solution.converged, **{name: float(values[name]) for name in TOLD},
    }  # fmt: skip


def measure(*paths):
    """Of a process of its own, on the CPU: fits one by one, a few at a time, the seconds of all, and the machine."""
    config, begun = load(posterior=False), time.perf_counter()
    with ThreadPoolExecutor(max(1, len(os.sched_getaffinity(0)) // 2)) as pool:
        fits = list(pool.map(lambda path: one_by_one(path, config), paths))
    return {"fits": fits, "seconds": time.perf_counter() - begun, "machine": machine()}


def on_the_cpu(folder, paths):
    """What `measure` finds in a process that sees no GPU, kept beside the files, maybe of elsewhere."""
    kept = folder / f"{len(paths)}_on_the_cpu.json"
    if not kept.is_file():
        program = [sys.executable, "-m", f"{__package__}.worker", "gpu", *map(str, paths)]
        done = subprocess.run(
            program, env={**os.environ, "JAX_PLATFORMS": "cpu"}, stdout=subprocess.PIPE, text=True, check=True
        )
        kept.write_text(done.stdout.splitlines()[-1])
    return json.loads(kept.read_text())


def peak_gib():
    """Largest use of the device's memory so far, if it tells."""
    stats = jax.devices()[0].memory_stats() or {}
    return stats["peak_bytes_in_use"] / 2**30 if "peak_bytes_in_use" in stats else None


def fitted(some, config, device):
    """Fits of one batch, and the seconds of that."""
    begun = time.perf_counter()
    found = fit_together(some, config, device, AT_ONCE if device.platform == "gpu" else ON_CPU)
    return found, time.perf_counter() - begun


def compared(record, mine, alone):
    """Sets the targets of equality, and says what differs."""
    same = [k for k, (a, b) in enumerate(zip(mine, alone, strict=True)) if a["kind"] == b["kind"]]
    costs = np.array([abs(mine[k]["cost"] / alone[k]["cost"] - 1) for k in same])
    left = np.array([alone[k]["cost"] > LEFT for k in same])
    record.set("cost", costs[left].max())
    record.set("kinds", len(mine) - len(same))
    away = {name: max(abs(mine[k][name] / alone[k][name] - 1) for k in same) for name in TOLD}
    record.notes.append(
        f"Costs of {len(same)} materials of the same kind: median difference {np.median(costs):.1g}, "
        f"{int((costs <= 1e-6).sum())} within 1e-6; of the {int((~left).sum())} that leave less than {LEFT:g} of the "
        f"energy, up to {costs[~left].max(initial=0.0):.2g}, which is rounding. Largest relative difference of "
        "parameters: " + ", ".join(f"{name} {x:.1g}" for name, x in away.items()) + "."
    )
    return mine


def run(folder, out, every, on_cpu=False):
    """Batches of growing size; the costs of the published materials beside those of fits one by one on the CPU."""
    use_persistent_cache()
    device = jax.devices()[0]
    if device.platform != "gpu" and not on_cpu:
        print(ABSENT.format(", ".join(str(d) for d in jax.devices())))
        return
    counts = COUNTS if device.platform == "gpu" else COUNTS_ON_CPU
    paths = files(folder, min(MOST, max(counts)))
    config = load(posterior=False)
    record = Record(
        "gpu", "Fits batched over materials",
        f"synthetic: published parameters on MERL's grid ({SOURCES[SOURCE].citation}); beyond {len(paths)} materials "
        f"the same with colours times random numbers (log-normal, {GAIN:g})",
        [f"Device: {device.device_kind} ({device.platform}). `fitting/pipeline/together.py`: default settings, five "
         "kinds of interface and body, all bins, float64. Seconds are those of the fits: starting points, search, "
         "choice of the kind, last steps on all bins, and data to the device; after compilation, one repeat. Apart "
         "from them are reading, weighing and gathering of the files by the CPU, with a thread for each core. Neither "
         f"has the errors on all bins that `merlfit fit` writes. More than {MOST} materials are fitted {MOST} at a "
         "time. Steps: of the last stage, of the slowest material and of the mean one."],
        {"seconds": Target("100 materials in one call, without compilation", SECONDS, "s"),
         "cost": Target(f"cost differs from that of the CPU, largest where {LEFT:g} are left", 1e-6, "relative"),
         "kinds": Target("materials of another kind than on the CPU", 0, "")},
        folder=out,
    )  # fmt: skip
    begun = time.perf_counter()
    ready = cpu_threads(lambda path: prepare(weighted(path, config), config), paths)
    preparing = time.perf_counter() - begun
    found = []
    for count in counts:
        first, ended, whole = None, [], 0.0
        if count <= len(paths):
            first = fitted(ready[:count], config, device)[1]
        for k in range(-(-count // len(paths))):
            batch = ready[: count - len(ended)]
            more, seconds = fitted(cpu_threads(lambda m, k=k: varied(m, k), batch), config, device)
            ended, whole = ended + more, whole + seconds
        found = ended if count <= len(paths) else found
        if count == 100:
            record.set("seconds", whole)
        steps = [f.solution.steps for f in ended]
        record.add(
            {
                "materials": count, "seconds": whole, "ms a material": 1e3 * whole / count, "first time s": first,
                "converged": sum(f.solution.converged for f in ended), "most steps": max(steps),
                "mean steps": float(np.mean(steps)), "device peak GiB": peak_gib(),
            },
            {"costs": [f.solution.cost for f in ended], "steps": steps},
        )  # fmt: skip
    record.notes.append(
        f"Reading, weighing and gathering of {len(paths)} files: {preparing:.3g} s, programs to compile or to read "
        "among them."
    )
    growth = exponent(counts, record.column("seconds")) if len(counts) > 1 else 1.0
    record.notes.append(f"Time grows as materials^{growth:.2f} from {counts[0]} to {counts[-1]}.")
    alone = on_the_cpu(folder, paths[: len(found)])
    mine = cpu_threads(lambda f: told(f.layout, f.solution), found)
    compared(record, mine, alone["fits"])
    where = alone["machine"]
    record.notes.append(
        f"The same fits without a GPU: {where['cores']} cores of {where['processor']}, jax {where['jax']}, load before "
        f"{where['load_before']}; {alone['seconds']:.0f} s with reading, gathering, and programs to compile or to read."
    )
    record.rows[-1]["details"] |= {"fits": mine, "on the CPU": alone["fits"]}
    record.finish()
