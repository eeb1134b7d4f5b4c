"""Files on a Dask cluster of this machine, beside a plain loop over the same ones."""

import tempfile
from pathlib import Path

import numpy as np
import psutil
from merlfit.fitting.support.threads import CORES

from ..support.clusters import scheduler, until, workers
from .batch import LOOP, MIXED, fitted
from .materials import TWELVE, file
from .materials import every as every_material
from .record import RECONSTRUCTIONS, Record, Target

FILES, TURNS = 16, 3
DASK = "merlfit fit --executor dask"


def spent(process):
    """Seconds of processors of a process and of all that it started, those that ended included."""
    times = [each.cpu_times() for each in (process, *process.children(recursive=True))]
    return sum(t.user + t.system for t in times) + sum(t.children_user + t.children_system for t in times)


def on_cluster(files):
    """Seconds; seconds of processors of `merlfit fit`, and of scheduler and worker, which fitted nothing before."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with scheduler(folder) as (one, address), workers(address, folder, threads=CORES) as other:
            until(lambda: b"Registered to" in (folder / "worker/said").read_bytes(), "no worker")
            cluster = [psutil.Process(each.pid) for each in (one, other)]
            before = sum(map(spent, cluster))
            done = fitted(files, "--executor", address)
            return done.seconds, done.cpu, sum(map(spent, cluster)) - before


def in_loop(files):
    """The same of a plain loop."""
    done = fitted(files)
    return done.seconds, done.cpu, 0.0


def run(folder, out, every):
    """By turns; targets are of the medians so far."""
    record = Record(
        "cluster", "Files on a cluster", RECONSTRUCTIONS,
        [f"`merlfit fit FILE ... --no-posterior --executor dask://...` of {FILES} files: a scheduler and a worker with "
         "all cores, processes of this machine, both new. Their start belongs to the cluster and is not counted; that "
         "the worker imports merlfit and reads compiled programs is. The plain loop: one process of Python that fits "
         "one file after the other, its start included. Run by turns, and the one that begins changes; targets are of "
         f"the medians of {TURNS}. Seconds of processors (CPU) are those of `merlfit fit`, scheduler and worker "
         "together; where others use the machine, they are what can be compared."],
        {"clock": Target("a Dask worker against the plain loop, clock", 10, "%"),
         "cpu": Target("a Dask worker against the plain loop, processors", 10, "%")},
        folder=out,
    )  # fmt: skip
    others = [material for material in every_material() if material not in TWELVE]
    files = [file(folder, material) for material in [*MIXED, *others][:FILES]]
    fitted(files)  # every body that they choose is compiled
    for turn in range(1, TURNS + 1):
        both = {LOOP: in_loop, DASK: on_cluster}
        for by in both if turn % 2 else reversed(both):
            seconds, own, cluster = both[by](files)
            cpu = own + cluster
            record.add({
                "turn": turn, "by": by, "s": seconds, "CPU s": cpu, "of scheduler and worker": cluster,
                "CPU s a file": cpu / FILES,
            })  # fmt: skip
        for target, name in (("clock", "s"), ("cpu", "CPU s")):
            loop, dask = (np.median(record.column(name, by=by)) for by in (LOOP, DASK))
            record.set(target, 100 * (dask / loop - 1))
        record.write()
    record.finish()
