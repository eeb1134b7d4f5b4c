"""Growth of a fit's time and memory with the number of channels and of directions of scattered samples."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load

from .. import spectral
from .processes import resident_peak, worker
from .record import Record, Target, exponent
from .start import REPEATS

MATERIAL, NOISE = "plastic", 0.01
SIZES = ((3, 2_000), (8, 2_000), (16, 2_000), (31, 2_000), (3, 8_000), (3, 100_000))  # channels, directions
LIMITS = {(3, 8_000): 3.0, (3, 100_000): 6.0, (31, 2_000): 6.0}  # seconds


def table(folder, channels, directions):
    """The material at so many wavelengths, evenly over the range, with noise, as an archive."""
    model, truth = spectral.CASES[MATERIAL]
    chosen = np.linspace(0, len(spectral.WAVELENGTHS_UM) - 1, channels).round().astype(int)
    some = {name: x[chosen] if np.ndim(x) else x for name, x in truth.items()}
    um, angles = spectral.WAVELENGTHS_UM[chosen], spectral.directions(directions // 7)
    values = spectral.values_of(model, some, angles, um)
    values *= 1 + NOISE * np.random.default_rng(0).standard_normal(values.shape)
    path = Path(folder, f"scattered-{channels}-{directions}.npz")
    names = dict(zip(("theta_i_deg", "theta_o_deg", "phi_deg"), angles, strict=True))
    np.savez(path, **names, wavelengths_um=um, values=values.T)
    return path


def measure(path):
    """Medians of fits: seconds, seconds of processors; and the peak (MiB); after one of a step each, which compiles."""
    config, runs = load(posterior=False), []
    short = replace(config, fit=replace(config.fit, coarse_steps=1, max_steps=1))
    with tempfile.TemporaryDirectory() as out:
        fit_file(path, out, short)
        fit_file(path, out, config)
        Path("/proc/self/clear_refs").write_text("5")  # forgets the largest resident set so far
        for _ in range(REPEATS):
            clock, cpu = time.perf_counter(), time.process_time()
            result = fit_file(path, out, config)
            runs.append((time.perf_counter() - clock, time.process_time() - cpu))
    seconds, cpu = np.median(runs, axis=0)
    return {
        "samples": result.fit.bins, "status": result.fit.status, "seconds": seconds, "cpu": cpu,
        "peak": resident_peak(), "stages": {name: round(x, 2) for name, x in result.seconds.items()},
    }  # fmt: skip


def run(folder, out, every):
    """Every size in a process of its own; exponents among the notes."""
    record = Record(
        "channels", "Growth with the number of channels and of directions",
        f"synthetic: the {MATERIAL} of results/spectral.md with noise of {NOISE:.0%}",
        ["`merlfit fit TABLE.npz --no-posterior`, all five kinds of material compared, each table in a process of its "
         f"own that has its programs already; medians of {REPEATS} fits, from reading to the written result. CPU: "
         "seconds of processors, user and system, which other work on the machine changes little; two cores share "
         "the search and the steps, while reading, pictures and scatter have one. Peak: largest resident set during "
         "the fits."],
        {f"{channels} x {directions}": Target(f"fit of {channels} channels, {directions} directions", limit, "s")
         for (channels, directions), limit in LIMITS.items()},
        folder=out,
    )  # fmt: skip
    for channels, directions in SIZES:
        path = table(folder, channels, directions)
        found, _ = worker("channels", path)
        record.add({
            "channels": channels, "directions": directions, "samples": found["samples"], "status": found["status"],
            "s": found["seconds"], "CPU s": found["cpu"], "peak GiB": found["peak"] / 1024,
        }, found["stages"])  # fmt: skip
        if (channels, directions) in LIMITS:
            record.set(f"{channels} x {directions}", found["seconds"])
    for what, of in (("channels", "directions"), ("directions", "channels")):
        least = record.rows[0][of]
        rows = [row for row in record.rows if row[of] == least]
        sizes = [row[what] for row in rows]
        grows = {name: exponent(sizes, [row[name] for row in rows]) for name in ("CPU s", "peak GiB")}
        record.notes.append(
            f"Processor time grows as {what}^{grows['CPU s']:.2f}, peak memory as {what}^{grows['peak GiB']:.2f}."
        )
    record.finish()
