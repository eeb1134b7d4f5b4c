"""The report of all 100 materials: how long its pages take, and how large its index is."""

import os
import resource
import shutil
import time
from pathlib import Path

from .processes import MERLFIT, watch
from .record import RECONSTRUCTIONS, Record, Target

COUNTS = (100,)
VARIABLE = "MERLFIT_RESULTS"


def size(site):
    """MiB of what the index loads, and of the whole site."""
    index = [site / "index.html", *(site / "assets").iterdir(), *(site / "pictures").glob("*.small-*")]
    index = [path for path in index if path.name != "compare.js"]
    every = [path for path in site.rglob("*") if path.is_file()]
    return (sum(path.stat().st_size for path in paths) / 2**20 for paths in (index, every))


def of_processes():
    """Seconds of processors that all ended processes have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(folder, out, every):
    """A row a number of materials; the results are those in the folder that MERLFIT_RESULTS names (`make report`)."""
    results = Path(os.environ.get(VARIABLE, "out/merl100"))
    found = sorted(path for path in results.glob("*.json"))
    if len(found) < COUNTS[-1]:
        raise SystemExit(f"{results}: {len(found)} results; `make report` makes all 100, {VARIABLE} names their folder")
    record = Record(
        "report", "Pages of many results", RECONSTRUCTIONS,
        ["`merlfit report RUN_DIR` of results without posteriors, their files at hand, in as many processes as there "
         "are cores: wall time of the whole call, compiled programs in the cache. The time of all processes over "
         "the number of cores is what the call takes where nothing else runs. The index is what a browser loads to "
         "show it: the page, scripts, style, and thumbnails of file and fit."],
        {"minutes": Target("pages of 100 materials", 1.5, "minutes"),
         "cpu": Target("the same, time of all processes over the number of cores", 1.5, "minutes"),
         "index": Target("their index", 3, "MB")},
        folder=out,
    )  # fmt: skip
    for count in COUNTS:
        kept = folder / f"report-{count}"
        kept.mkdir(parents=True, exist_ok=True)
        for path in found[:: len(found) // count][:count]:
            shutil.copy(path, kept)
        start, used = time.monotonic(), of_processes()
        done = watch([MERLFIT, "report", str(kept)])
        seconds, used = time.monotonic() - start, of_processes() - used
        index, whole = size(kept / "report")
        record.add({
            "materials": count, "seconds": seconds, "of all processes": used, "of them a page": used / count,
            "index MB": index * 1.048576,
            "whole site MB": whole * 1.048576, "largest process GiB": done.peaks_mib[0] / 1024,
        })  # fmt: skip
    record.set("minutes", record.column("seconds")[-1] / 60)
    record.set("cpu", record.column("of all processes")[-1] / 60 / record.machine["cores"])
    record.set("index", record.column("index MB")[-1])
    record.finish()
