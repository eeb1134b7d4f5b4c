"""Hundreds of fits in one process: memory, open files, speed; `python -m tests.endurance` writes results/endurance.md.

The fits go round ten kinds of material and settings, so that each round is the same work as every other.
"""

import gc
import os
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from merlfit.fitting.batch.unit import Unit, fit_unit
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.settings.config import Config
from merlfit.fitting.support.compilation import use_persistent_cache

from .bench.materials import file
from .bench.processes import resident
from .bench.record import RECONSTRUCTIONS, Record, Target

RESULTS = Path(__file__).parents[1] / "results"
COARSE = {"grid": "coarse", "starts": 2}
ROUND = (
    ("nickel", {"fit": COARSE}),
    ("gray-plastic", {"fit": COARSE}),
    ("chrome", {"fit": {**COARSE, "grid": "medium"}}),
    ("blue-acrylic", {"fit": {**COARSE, "weights": "log"}}),
    ("red-plastic", {"fit": {**COARSE, "precision": "float32"}}),
    ("brass", {"fit": COARSE, "model": {"name": "ggx"}}),
    ("white-marble", {"fit": {**COARSE, "grid": "fine"}}),
    ("gold-metallic-paint2", {"fit": {**COARSE, "weights": "none"}}),
    ("yellow-phenolic", {"fit": COARSE, "effects": {"preset": "preview"}}),
    ("aluminium", {"fit": COARSE, "effects": {"index": "complex", "body": "none"}}),
)
BLOCK = 50  # fits; what is compared is the first and the last so many, but for the first round
COLUMNS = ("wall s", "CPU s", "resident MiB", "open files", "threads", "mappings")


def state():
    """Of this process now: resident MiB, open files, threads, mappings of memory."""
    mappings = len(Path("/proc/self/maps").read_text().splitlines())
    return resident(), *(len(os.listdir(f"/proc/self/{kind}")) for kind in ("fd", "task")), mappings


def fitted(path, settings, out):
    """A fit: wall and CPU seconds, and `state` after it."""
    wall, cpu = time.perf_counter(), time.process_time()
    ended = fit_unit(Unit(path, out, settings))
    if ended.kind is not Ending.FITTED:
        raise RuntimeError(ended.error)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    gc.collect()
    return wall, cpu, *state()


def rounds(values, begin, end):
    """Sums over the rounds between two fits."""
    return np.reshape(values[begin:end], (-1, len(ROUND))).sum(1)


def judge(record, table):
    """Targets, of what each fit left (fits, columns)."""
    size, count = len(ROUND), len(table)
    wall, cpu, memory, files, threads, _ = table.T
    early, late = slice(BLOCK - size, BLOCK), slice(count - size, count)
    record.set("memory", 100 * (np.median(memory[late]) / np.median(memory[early]) - 1))
    record.set("files", files[late].max() - files[early].max())
    record.set("threads", threads[late].max() - threads[early].max())
    slower = [
        100 * (np.median(rounds(each, count - BLOCK, count)) / np.median(rounds(each, size, size + BLOCK)) - 1)
        for each in (cpu, wall)
    ]
    record.set("speed", slower[0])
    record.notes.append(f"Wall time of the last 50 over that of the first 50: {slower[1]:+.1f} %.")


def main(
    fits: Annotated[int, typer.Option(help="How many, a multiple of 50.")] = 500,
    files: Annotated[Path | None, typer.Option(help="Folder to keep the MERL files in, 35 MB each.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = RESULTS,
) -> None:
    """Fit, and look at the process after each."""
    if fits < 3 * BLOCK or fits % BLOCK:
        raise typer.BadParameter(f"--fits {fits} should be a multiple of {BLOCK}, {3 * BLOCK} at the least")
    record = Record(
        "endurance", f"{fits} fits in one process", RECONSTRUCTIONS,
        ["`fit_unit`, the whole way from a file to a JSON, over and over in one process, as a worker of a batch does "
         f"it. Ten kinds of material and settings take turns ({', '.join(name for name, _ in ROUND)}): the two-scale "
         "model on the coarse grid, on the medium and the fine one, with three kinds of weights, in float32, with the "
         "preset `preview`, of one kind alone; GGX. No posterior. Compiled programs come from the cache.",
         "Rows: sums over the 50 fits before, and the process after them. Memory: medians over the ten fits up to "
         "fit 50 and over the last ten. Speed: of a round of ten fits the median of the five rounds after the first "
         "one, which is left out, and of the last five. CPU time of all threads decides, since others used the "
         "machine; wall time is beside it."],
        {"memory": Target("growth of the resident memory from fit 50 to the end", 5, "%"),
         "files": Target("open files more at the end than at fit 50", 0, "files"),
         "threads": Target("threads more at the end than at fit 50", 0, "threads"),
         "speed": Target("CPU time of the last 50 fits over that of the first 50", 10, "%")},
        folder=out, command="python -m tests.endurance",
    )  # fmt: skip
    use_persistent_cache()
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = files or Path(scratch)
        each = [
            (file(folder, name), Config(**{"posterior": {"enabled": False}, **settings})) for name, settings in ROUND
        ]
        out_of_fits = Path(scratch, "out")
        out_of_fits.mkdir()
        for k in range(fits):
            found.append(fitted(*each[k % len(each)], out_of_fits))
            if (k + 1) % BLOCK == 0:
                block = np.array(found[-BLOCK:])
                row = dict(zip(COLUMNS, [*block[:, :2].sum(0), *map(int, block[-1, 2:])], strict=True))
                record.add({"fits": k + 1, **row}, {"each": np.round(block, 3).tolist()})
    judge(record, np.array(found))
    record.finish()


if __name__ == "__main__":
    typer.run(main)
