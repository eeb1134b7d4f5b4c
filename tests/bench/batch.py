"""Many files: one `merlfit fit` call of N files, one and two processes, all 100."""

import tempfile
from pathlib import Path

from .materials import TWELVE, file
from .materials import every as every_material
from .processes import MERLFIT, watch
from .record import RECONSTRUCTIONS, Record, Target, exponent

COUNTS = (1, 2, 4, 8)
FILES = 100


def fit_all(shares):
    """One `merlfit fit` process a share of files, side by side: seconds and peaks."""
    with tempfile.TemporaryDirectory() as scratch:
        done = watch(
            *([MERLFIT, "fit", *map(str, share), "-o", str(Path(scratch) / str(k)), "--no-posterior"]
              for k, share in enumerate(shares)), codes=(0, 1),
        )  # fmt: skip
        written = len(list(Path(scratch).glob("*/*.json")))
    if written != sum(map(len, shares)):
        raise RuntimeError(f"{written} results of {sum(map(len, shares))} files: {done.outputs}")
    return done


def row(files, processes, done):
    """A row of the table; an exit code of 1 says that a fit ended at its step limit."""
    return {
        "files": files, "processes": processes, "seconds": done.seconds, "s a file": done.seconds / files,
        "largest peak GiB": max(done.peaks_mib) / 1024, "sum of peaks GiB": sum(done.peaks_mib) / 1024,
    }  # fmt: skip


def run(folder, out, every):
    """Rows by number of files, then of processes; with ``every`` all 100."""
    record = Record(
        "batch", "Many files in one call", RECONSTRUCTIONS,
        ["`merlfit fit FILE ... --no-posterior`, body `auto` (five kinds of interface and body on the coarse grid, the "
         "best on all bins), "
         "wall time of the whole process, compiled programs in the cache. Two processes: half of the files "
         "each, together."],
        {"files": Target(f"all {FILES} materials in one call, no posterior", 10, "minutes")},
        folder=out,
    )  # fmt: skip
    mixed = [
        m for pair in zip(list(TWELVE)[:6], list(TWELVE)[6:], strict=True) for m in pair
    ]  # conductor, plastic, ...
    files = [file(folder, material) for material in mixed[: max(COUNTS)]]
    fit_all([files])  # every body that they choose is compiled
    for count in COUNTS:
        record.add(row(count, 1, fit_all([files[:count]])))
    counts, seconds = record.column("files"), record.column("seconds")
    further = (seconds[-1] - seconds[0]) / (counts[-1] - counts[0])
    record.notes.append(
        f"Time grows as files^{exponent(counts, seconds):.2f}: {seconds[0]:.3g} s for the first, {further:.3g} s for "
        f"each further one; peak memory as files^{exponent(counts, record.column('largest peak GiB')):.2f}."
    )
    record.add(row(max(COUNTS), 2, fit_all([files[::2], files[1::2]])))
    if every:
        hundred = [file(folder, material) for material in every_material()]
        record.add(row(len(hundred), 1, fit_all([hundred])))
        record.add(row(len(hundred), 2, fit_all([hundred[::2], hundred[1::2]])))
        record.set("files", record.column("seconds", files=FILES, processes=1)[0] / 60)
    else:
        record.notes.append(f"All {FILES} files were left out (`--few`).")
    record.finish()
