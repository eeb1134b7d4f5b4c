"""From file to JSON after compilation, and the memory of a process that fits one file."""

import tempfile
import time
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load

from .materials import BODIES, file
from .processes import MERLFIT, watch, worker
from .record import RECONSTRUCTIONS, Record, Target
from .start import REPEATS

STAGES = ("read", "coarse", "full", "metrics")


def measure(body, folder, *materials):
    """Fits of one body in one process, the first of which compiles and is done once more."""
    return {material: fit_runs(Path(folder) / f"{material}.binary", body, details=True) for material in materials}


def fit_runs(path, body, details=False):
    """Seconds from file to JSON, repeatedly, without the first fit, in which programs may be compiled."""
    config, runs, stages = load(body=body, posterior=False), [], []
    with tempfile.TemporaryDirectory() as out:
        for _ in range(REPEATS + 1):
            start = time.perf_counter()
            result = fit_file(path, Path(out), config)
            runs.append(time.perf_counter() - start)
            stages.append([result.seconds[stage] for stage in STAGES])
    if not details:
        return runs[1:]
    return {
        "runs": runs[1:], "first": runs[0], "stages": np.median(stages[1:], 0).tolist(), "status": result.fit.status,
        "steps": result.fit.steps, "cost": result.fit.cost,
    }  # fmt: skip


def run(folder, out, every):
    """Median seconds of a fit after compilation, by stage, and peak memory of a fresh process."""
    record = Record(
        "fit", "From file to JSON", f"{RECONSTRUCTIONS}: 12 materials",
        ["`merlfit fit FILE --body BODY --no-posterior`: all bins, float64, default settings. Seconds: after "
         f"compilation, median of {REPEATS} in one process, by stage. Peak memory: largest resident set of a fresh "
         "`merlfit fit` of that one file, compiled programs in the cache; its seconds beside it."],
        {"seconds": Target("a fit from file to JSON after compilation, median of the materials", 5, "s"),
         "memory": Target("its peak memory, median of the materials", 1.5, "GiB")},
        folder=out,
    )  # fmt: skip
    for body, materials in BODIES.items():
        for material in materials:
            file(folder, material)
        timed, _ = worker("fit", body, folder, *materials)
        for material in materials:
            with tempfile.TemporaryDirectory() as scratch:
                options = ["-o", scratch, "--body", body, "--no-posterior"]
                fresh = watch([MERLFIT, "fit", str(file(folder, material)), *options], codes=(0, 1))
            t = timed[material]
            record.add(
                {
                    "material": material, "body": body, "seconds": float(np.median(t["runs"])),
                    **dict(zip(STAGES, t["stages"], strict=True)), "peak GiB": fresh.peaks_mib[0] / 1024,
                    "fresh process s": fresh.seconds, "steps": t["steps"], "status": t["status"], "cost": t["cost"],
                },
                {"runs": t["runs"], "first_in_process": t["first"]},
            )  # fmt: skip
            record.set("seconds", np.median(record.column("seconds")))
            record.set("memory", np.median(record.column("peak GiB")))
    record.finish()
