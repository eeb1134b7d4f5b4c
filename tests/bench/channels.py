"""Growth of a fit's time and memory with the number of channels of a table of scattered directions."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load

from .. import spectral
from .processes import resident_peak, worker
from .record import Record, exponent

MATERIAL = "plastic"
COUNTS = (3, 8, 16, 31)


def table(folder, count):
    """The material at so many wavelengths, evenly over the range."""
    model, truth = spectral.CASES[MATERIAL]
    chosen = np.linspace(0, len(spectral.WAVELENGTHS_UM) - 1, count).round().astype(int)
    some = {name: x[chosen] if np.ndim(x) else x for name, x in truth.items()}
    um, angles = spectral.WAVELENGTHS_UM[chosen], spectral.directions()
    path = Path(folder, f"channels-{count}.csv")
    values = spectral.values_of(model, some, angles, um)
    spectral.write_csv(path, angles, values, [f"{round(1e3 * x)}nm" for x in um])
    return path


def measure(path):
    """Of a fit: seconds, seconds of processors, the peak (MiB); after one of a step each, which compiles."""
    config = load(body=MATERIAL, posterior=False)
    short = replace(config, fit=replace(config.fit, coarse_steps=1, max_steps=1))
    with tempfile.TemporaryDirectory() as out:
        fit_file(path, out, short)
        Path("/proc/self/clear_refs").write_text("5")  # forgets the largest resident set so far
        clock, cpu = time.perf_counter(), time.process_time()
        result = fit_file(path, out, config)
    return {
        "samples": result.fit.bins, "status": result.fit.status, "seconds": time.perf_counter() - clock,
        "cpu": time.process_time() - cpu, "peak": resident_peak(),
        "stages": {name: round(x, 2) for name, x in result.seconds.items()},
    }  # fmt: skip


def run(folder, out, every):
    """Every number of channels in processes of its own; exponents among the notes."""
    record = Record(
        "channels", "Growth with the number of channels",
        f"synthetic: the {MATERIAL} of results/spectral.md, without noise",
        [f"`merlfit fit TABLE.csv --body {MATERIAL}`, other settings as they are by default, each table in a process "
         "of its own that has its programs already. CPU: seconds of processors, user and system, which other work on "
         "the machine changes little. Peak: largest resident set during the fit."],
        folder=out,
    )  # fmt: skip
    for count in COUNTS:
        path = table(folder, count)
        found, _ = worker("channels", path)
        record.add({
            "channels": count, "samples": found["samples"], "status": found["status"], "s": found["seconds"],
            "CPU s": found["cpu"], "CPU s a channel": found["cpu"] / count, "peak GiB": found["peak"] / 1024,
        }, found["stages"])  # fmt: skip
    counts = record.column("channels")
    grows = {name: exponent(counts, record.column(name)) for name in ("CPU s", "peak GiB")}
    record.notes.append(
        f"Processor time grows as channels^{grows['CPU s']:.2f}, peak memory as channels^{grows['peak GiB']:.2f}."
    )
    record.finish()
