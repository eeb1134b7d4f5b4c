"""What a cluster's scheduler and network have to do for a file: `python -m tests.cluster_cost`, results/cluster.md.

The workers do not fit: they write a result at once, so that scheduler and client have as much to do as can be.
"""

import pickle
import tempfile
import time
from pathlib import Path

import psutil
import typer
from merlfit.fitting.batch.cluster import Cluster
from merlfit.fitting.batch.slot import Brought
from merlfit.fitting.batch.unit import Unit
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.settings.config import Config

from .bench.record import Record
from .support.clusters import scheduler, until, workers
from .support.worker_tasks import task

RESULTS = Path(__file__).parents[1] / "results"
WORKERS = 4
MERL = 35_000_000  # bytes of a file, as near as matters


class Counted(Cluster):
    """A cluster that counts what it sends and gets: bytes of orders and results, messages of workers."""

    sent = got = messages = 0

    def _brought(self, k, future, came):
        brought = super()._brought(k, future, came)
        if isinstance(brought, Brought):
            self.got += len(pickle.dumps(brought))
        return brought

    def _tell(self, said, tell):
        self.messages += "stage" in said
        super()._tell(said, tell)


def cpu(process):
    """Seconds."""
    times = process.cpu_times()
    return times.user + times.system


def measured(folder, count, size, send):
    """A row: so many files of so many bytes, each of its own content, by path or sent."""
    folder.mkdir()
    files = [folder / f"quick-{n}.binary" for n in range(count)]
    for n, path in enumerate(files):
        path.write_bytes(n.to_bytes(8, "little") + bytes(size - 8))
    out = folder / "out"
    out.mkdir()
    with scheduler(folder) as (its, address), workers(address, folder, WORKERS):
        said = folder / "worker/said"
        until(lambda: said.read_bytes().count(b"Registered to") >= WORKERS, "no workers")
        cluster, process = Counted(address, task=task), psutil.Process(its.pid)
        submit = cluster._client.submit

        def counted(function, order, data, **more):
            cluster.sent += len(order) + len(data or b"")
            return submit(function, order, data, **more)

        cluster._client.submit = counted
        if send:
            cluster._unseen.add(folder)
        before, wall, own = cpu(process), time.perf_counter(), time.process_time()
        ended = dict(cluster.ended([Unit(path, out, Config()) for path in files], lambda k, stage: None))
        wall, own, after = time.perf_counter() - wall, time.process_time() - own, cpu(process)
        peak = int(next(x for x in Path(f"/proc/{its.pid}/status").read_text().splitlines() if "VmHWM" in x).split()[1])
    if any(each.kind is not Ending.FITTED for each in ended.values()):
        raise RuntimeError(next(each.error for each in ended.values() if each.error))
    written = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return {
        "files": count, "MB a file": size / 1e6, "way": "sent" if send else "by path", "s": wall,
        "files/s": count / wall,
        "scheduler CPU ms a file": 1e3 * (after - before) / count, "client CPU ms a file": 1e3 * own / count,
        "kB to the cluster": cluster.sent / count / 1e3, "kB back": cluster.got / count / 1e3,
        "messages a file": cluster.messages / count, "kB on disk": written / count / 1e3,
        "scheduler peak MiB": peak / 1024,
    }  # fmt: skip


def main(out: Path = RESULTS) -> None:
    """Measure."""
    record = Record(
        "cluster", "What a file costs scheduler and client", "synthetic results, of no fit",
        [f"A scheduler and {WORKERS} workers of one thread, processes of this machine, which write a stand-in for a "
         "result at once: no time is that of a fit. Client: `merlfit fit`, which reads each file for its SHA-1 and "
         "writes results with fsync. Bytes are those of pickled orders, with the file if it is sent, and of what comes "
         "back; a real result with a posterior has some 30 kB, and a chain. CPU times "
         "are what counts: others used the machine, and wall times say little. Those of few files contain what a "
         "scheduler does anyhow."],
        folder=out, command="python -m tests.cluster_cost",
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        for n, (count, size, send) in enumerate(((200, 1000, False), (12, MERL, False), (8, MERL, True))):
            record.add(measured(Path(place, str(n)), count, size, send))
    record.finish()


if __name__ == "__main__":
    typer.run(main)
