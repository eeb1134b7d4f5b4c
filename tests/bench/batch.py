"""Many files: `merlfit fit` of N files with one and two jobs, a plain loop beside it, all 100."""

import tempfile
import time
from pathlib import Path

from merlfit.fitting.batch.unit import Unit, fit_unit
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.settings.config import load

from .materials import TWELVE, file
from .materials import every as every_material
from .processes import MERLFIT, measuring, watch
from .record import RECONSTRUCTIONS, Record, Target, exponent

COUNTS = (1, 2, 4, 8)
FILES = 100
REPEATS = 3
MIXED = [m for pair in zip(list(TWELVE)[:6], list(TWELVE)[6:], strict=True) for m in pair]  # conductor, plastic, ...
LOOP, POOL = "plain loop", "merlfit fit"


def measure(out, *files):
    """Of a process of its own: seconds of a plain loop over files, one after the other with all cores."""
    settings, start = load(posterior=False), time.perf_counter()
    ended = [fit_unit(Unit(Path(path), Path(out), settings)) for path in files]
    if any(each.kind is not Ending.FITTED for each in ended):
        raise RuntimeError(f"not all are fitted: {[each.error for each in ended]}")
    return time.perf_counter() - start


def fitted(files, *options):
    """What a call was like that fits files in a process of its own: a plain loop, or `merlfit fit` with options.

    An exit code of 1 says that a fit ended at its step limit.
    """
    with tempfile.TemporaryDirectory() as out:
        program = [MERLFIT, "fit", *map(str, files), "-o", out, "--no-posterior", *options]
        done = watch(program if options else measuring("batch", out, *files), codes=(0, 1) if options else (0,))
        written = len(list(Path(out).glob("*.json")))
    if written != len(files):
        raise RuntimeError(f"{written} results of {len(files)} files")
    return done


def row(files, jobs=None):
    """Of a table: by ``jobs`` processes, None for a plain loop."""
    done = fitted(files, *(() if jobs is None else ("-j", jobs)))
    return {
        "files": len(files), "by": LOOP if jobs is None else POOL, "jobs": jobs or "1", "seconds": done.seconds,
        "s a file": done.seconds / len(files), "largest process GiB": done.peaks_mib[0] / 1024,
        "all processes GiB": done.sums_mib[0] / 1024,
    }  # fmt: skip


def median_of(files, jobs=None):
    """The row of the median time of some runs."""
    rows = sorted((row(files, jobs) for _ in range(REPEATS)), key=lambda row: row["seconds"])
    return rows[REPEATS // 2]


def run(folder, out, every):
    """Rows by number of files, then of the ways to fit them; with ``every`` all 100."""
    record = Record(
        "batch", "Many files in one call", RECONSTRUCTIONS,
        ["`merlfit fit FILE ... --no-posterior --jobs N`, five kinds of interface and body on the coarse grid, the "
         "best on all bins; wall time of the whole call with the start of its processes, compiled programs in the "
         "cache. The plain loop: one process of Python that fits one file after the other. "
         f"Up to {max(COUNTS)} files: the median of {REPEATS} runs."],
        {"files": Target(f"all {FILES} materials in one call, no posterior", 10, "minutes"),
         "overhead": Target(f"a file of {max(COUNTS)}: one job against the plain loop", 10, "%"),
         "two": Target(f"a file of {max(COUNTS)}: two jobs against the plain loop", 10, "%")},
        folder=out,
    )  # fmt: skip
    files = [file(folder, material) for material in MIXED[: max(COUNTS)]]
    fitted(files, "-j", "1")  # every body that they choose is compiled
    for count in COUNTS:
        record.add(median_of(files[:count], "1"))
    counts, seconds = record.column("files"), record.column("seconds")
    further = (seconds[-1] - seconds[0]) / (counts[-1] - counts[0])
    record.notes.append(
        f"Time grows as files^{exponent(counts, seconds):.2f}: {seconds[0]:.3g} s for the first, {further:.3g} s for "
        f"each further one; peak memory as files^{exponent(counts, record.column('largest process GiB')):.2f}."
    )
    one = seconds[-1]
    loop, two = median_of(files), median_of(files, "2")
    for each in (loop, two):
        record.add(each)
    record.set("overhead", 100 * (one / loop["seconds"] - 1))
    record.set("two", 100 * (two["seconds"] / loop["seconds"] - 1))
    if every:
        hundred = [file(folder, material) for material in every_material()]
        for jobs in ("1", "2"):
            record.add(row(hundred, jobs))
        record.set("files", min(record.column("seconds", files=FILES)) / 60)
    else:
        record.notes.append(f"All {FILES} files were left out (`--few`).")
    record.finish()
