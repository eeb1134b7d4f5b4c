"""Fits batched over materials on a GPU (`make bench-gpu`); where JAX sees none, one line says so."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.run import COARSE_ORDER, cheaper, fit_coarse
from merlfit.fitting.pipeline.synthesis import from_published
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.binary import read, write
from merlfit.model.published import SOURCES, materials

from .record import Record, Target, exponent
from .stacked import fit_batch, prepare, solve_batch

COUNTS, COUNTS_ON_CPU = (1, 4, 16, 64), (1, 2)
BODY, SOURCE = "plastic", "sgd"
ALONE = 4  # materials that are fitted one by one, too, at the most
ABSENT = "bench-gpu: skipped, JAX sees no GPU, only {}; it needs a jax for one, such as `pip install 'jax[cuda12]'`"


def prepared(names, config):
    """Materials of a published table as a fit wants them, and seconds of reading and gathering a file."""
    found, seconds = [], 0.0
    with TemporaryDirectory() as folder:
        path = Path(folder) / "material.binary"
        for name in names:
            write(path, from_published(name, SOURCE)[0])
            begun = time.perf_counter()
            found.append(prepare(weighted_samples(read(path), config.exponents[0], config.fit.theta_max), config))
            seconds += time.perf_counter() - begun
    return found, seconds / len(names)


def timed(compute):
    """Result, seconds of the first time, in which programs are compiled, and of the second."""
    seconds = []
    for _ in range(2):
        begun = time.perf_counter()
        found = compute()
        seconds.append(time.perf_counter() - begun)
    return found, *seconds


def one_by_one(layout, some, config):
    """Costs of the same fits without a batch."""
    cheap, costs = [cheaper(layout, COARSE_ORDER)], []
    for material in some:
        (found,) = fit_coarse(cheap, material.data, material.coarse, material.roughly, config)
        costs.append(solve(Objective(layout, material.problem), found.z, config.fit.max_steps).cost)
    return costs


def peak_gib():
    """Largest use of the device's memory so far, if it tells."""
    stats = jax.devices()[0].memory_stats() or {}
    return stats["peak_bytes_in_use"] / 2**30 if "peak_bytes_in_use" in stats else None


def run(folder, out, every, on_cpu=False):
    """Batches of growing size; the smaller ones beside the same fits one by one on the same device."""
    use_persistent_cache()
    device = jax.devices()[0]
    if device.platform != "gpu" and not on_cpu:
        print(ABSENT.format(", ".join(str(d) for d in jax.devices())))
        return
    counts = COUNTS if device.platform == "gpu" else COUNTS_ON_CPU
    config = load(body=BODY, posterior=False)
    layout = layout_for(config, *candidates(config))
    everything, preparing = prepared(materials(SOURCE)[: max(counts)], config)
    record = Record(
        "gpu", "Fits batched over materials",
        f"synthetic: published parameters on MERL's grid ({SOURCES[SOURCE].citation})",
        [f"Device: {device.device_kind} ({device.platform}). `tests/bench/stacked.py`, body {BODY}, all bins, "
         "float64: successive halving on the coarse grid, then all bins; after compilation, one repeat. One by "
         f"one: the same fits without a batch, on the same device. Reading and gathering a file, {preparing:.2g} s "
         "each on the CPU, is not in it. Steps: of the fine stage, of the slowest material and of the mean one."],
        {"cost": Target("cost differs from that of single fits, largest", 1e-6, "relative")},
        folder=out,
    )  # fmt: skip
    for count in counts:
        some = everything[:count]
        found, first, whole = timed(lambda some=some: fit_batch(layout, some, config))
        z, problems = np.array([s.z for s in found]), [m.problem for m in some]
        *_, equations = timed(lambda z=z, q=problems: solve_batch(layout, z, q, 1))
        alone = None
        if count <= ALONE:
            costs, _, alone = timed(lambda some=some: one_by_one(layout, some, config))
            away = max(abs(s.cost / cost - 1) for s, cost in zip(found, costs, strict=True))
            record.set("cost", max(away, record.targets["cost"].value or 0.0))
        steps = [s.steps for s in found]
        record.add(
            {
                "materials": count, "seconds": whole, "s a material": whole / count, "one by one s": alone,
                "ratio": alone and alone / whole, "normal equations s a material": equations / count,
                "most steps": max(steps), "mean steps": float(np.mean(steps)), "device peak GiB": peak_gib(),
                "first time s": first,
            },
            {"costs": [s.cost for s in found], "converged": [s.converged for s in found], "steps": steps},
        )  # fmt: skip
    growth = exponent(counts, record.column("seconds"))
    record.notes.append(f"Time grows as materials^{growth:.2f} from {counts[0]} to {counts[-1]}.")
    record.finish()
