"""Units on a Dask cluster, as many at once as there are workers; this process writes what comes back.

Dask gives the unit of a worker that is lost to another one, and gives it up when several were lost with it
(``distributed.scheduler.allowed-failures``). A worker takes a file from where it sees it under the same path with the
same SHA-1; otherwise the file is sent. Results come back as values and bytes: folder, manifest and logs belong to this
process alone, and nothing need be shared.
"""

from __future__ import annotations

import asyncio
import pickle
import queue
import re
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from ...merl_io.atomic import WriteError, write_bytes
from ...merl_io.source import MerlError, whole
from ..pipeline.draws import chain_of
from ..pipeline.place import place_of
from ..results.manifest import Ending
from ..results.schema_run import this_run
from ..results.storage import versions, write_result
from ..support.clock import Stage
from ..support.outputs import log
from ..support.terminal import unexpected
from .connection import CONNECT, SLURM, ClusterError, address_of, connected, library, line
from .pool import PATIENCE, Note, Tell
from .slurm import Queue
from .unit import Ended, Task, Unit, fit_unit
from .watch import Watch

if TYPE_CHECKING:
    from concurrent.futures import Future as Fetched

    from distributed import Future

    from .slot import Brought

LOOK = 0.5  # seconds between two looks at the connection
WAIT = 900.0  # seconds without a worker that could do anything; a queue's come when it is their turn
STUCK = 900.0  # seconds without a word from a worker that computes nothing
LARGEST = 2**30  # bytes of a file that is sent
KEPT = "what came back is written"


@dataclass(frozen=True)
class _Word:
    """What a worker says of a unit."""

    stage: Stage
    worker: str


@dataclass(frozen=True)
class _Back:
    """A unit that ended, and what was fetched of it."""

    future: Future
    fetched: Fetched[Brought | None]


@dataclass(frozen=True)
class _Gone:
    """A worker that was lost, and numbers of the units that it had."""

    worker: str
    units: list[int]


class Cluster:
    """As `pool.Pool`, on the workers of a Dask scheduler, as many as there are and as join while it works.

    Attributes:
        name: address of the scheduler. jobs: units at once, at the most; None for one a worker.
        note: called with what concerns the run and not one unit.
    """

    def __init__(self, where: str, jobs: int | None = None, task: Task = fit_unit, note: Note = print) -> None:
        """Connect.

        Args:
            where: ``dask://HOST:PORT``, ``dask+tls://HOST:PORT`` or ``dask-slurm``.
            jobs: of ``dask-slurm`` the workers that are asked for, too.

        Raises:
            ClusterError: no scheduler answers, a library is missing, or no worker has the versions of this process.
        """
        library("distributed", where, "dask")
        self.where = self.name = where
        self.jobs, self.task, self.note = jobs, task, note
        self._run = uuid.uuid4().hex
        self._inbox: queue.SimpleQueue[tuple[int | None, Any]] = queue.SimpleQueue()
        self._given: dict[int, Future] = {}
        self._word: dict[int, tuple[float, str]] = {}  # of a unit: when it was last heard of, and from which worker
        self._fetched: dict[int, Fetched[Any]] = {}
        self._unseen: set[Path] = set()  # folders that workers do not see
        self._said: set[str] = set()
        self._units: Sequence[Unit] = ()
        self._useful = time.monotonic()  # when there was a worker, or word of one
        self._queue = Queue(where, jobs) if where == SLURM else None
        try:
            self._client = (
                connected(where, self._queue.address, self._queue.security)
                if self._queue
                else connected(where, address_of(where))
            )
        except BaseException:  # a stop, too: jobs in the queue would outlive the run
            self._leave()
            raise
        self._resource = self._admit()
        self._watch = Watch(self._client, self._resource)

    def _admit(self) -> str:
        """Let workers take part, those that come later, too; name of what they have then."""
        import cloudpickle

        from . import admission

        self._client.subscribe_topic(admission.TOPIC, self._reported)
        self._client.subscribe_topic("all", self._changed)
        cloudpickle.register_pickle_by_value(admission)
        made = admission.Admission(self._run, versions())
        self._aside(lambda: self._client.register_plugin(made))
        return made.name

    def ended(self, units: Sequence[Unit], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end.

        Raises:
            ClusterError: the scheduler is gone, or no worker came for a long time.
        """
        from distributed.client import ClosedClientError

        self._units, waiting, self._useful = units, list(reversed(range(len(units)))), time.monotonic()
        try:
            while waiting or self._given:
                room = self.room()
                while waiting and len(self._given) < room:
                    yield from self._give(waiting.pop(), tell)
                self._wait(room)
                self._free()
                with suppress(queue.Empty):
                    yield from self._heard(self._inbox.get(timeout=LOOK), tell)
        except (OSError, ClosedClientError):  # how Dask says it
            self._end()
            raise ClusterError(f"{self.where}: the scheduler is gone; {KEPT}") from None
        self._end()

    def stop(self) -> list[tuple[int, Ended]]:
        """Begin nothing more, and end what goes on at its next report: what there is then of each."""
        from .slot import halt

        end, found, working = time.monotonic() + PATIENCE, {}, sorted(self._given)
        with suppress(OSError):  # of a worker that does not answer; the others have heard it
            self._client.run(halt, self._run, on_error="ignore", callback_timeout=CONNECT)
        with suppress(OSError):  # a scheduler that is gone: nothing comes
            while self._given and not self._watch.silent(2 * CONNECT) and (left := end - time.monotonic()) > 0:
                with suppress(queue.Empty):
                    found |= dict(self._heard(self._inbox.get(timeout=min(left, LOOK)), _silent))
        self._end()
        return [(k, found.get(k, Ended(Ending.STOPPED))) for k in working]

    def room(self) -> int:
        """Units that may be on the cluster at once.

        Raises:
            OSError: the scheduler is gone.
        """
        if self._client.status != "running" or self._watch.lost or self._watch.silent():
            raise OSError
        able = self._watch.able()
        return able if self.jobs is None else min(able, self.jobs)

    def _wait(self, room: int) -> None:
        """Say why nothing goes on, and wait for it no longer than is sensible."""
        now = time.monotonic()
        if room:
            self._useful = now
        if self._queue is not None and (said := self._queue.refused()):
            if self._queue.empty():
                self._end()
                raise ClusterError(f"{self.where}: sbatch took no job ({said})")
            self._once(f"{self.where}: sbatch did not take a job ({said}); the others go on")
        if now > self._useful + CONNECT:
            self._once(f"{self.where}: {self._watch.why()}; waiting for another")
        if now > self._useful + WAIT and self._queue is None:
            self._end()
            raise ClusterError(f"{self.where}: {self._watch.why()} for {WAIT / 60:g} minutes; {KEPT}")

    def _free(self) -> None:
        """Begin workers anew that are there and do nothing; Dask counts them as lost."""
        now = time.monotonic()
        for k, (heard, address) in list(self._word.items()):
            state = self._watch.workers.get(address)
            if state is None or now < max(heard, state.worked) + STUCK:
                continue
            self._word[k] = now, address
            idle = f"worker {address} has done nothing with {self._units[k].path} for {STUCK / 60:g} minutes"
            self.note(f"{idle}; it is begun anew")
            self._aside(lambda at=address: self._client.restart_workers([at], PATIENCE, False), wait=0)

    def _give(self, k: int, tell: Tell, send: bool = False) -> Iterator[tuple[int, Ended]]:
        """Hand a unit to the scheduler; of a file that cannot be read, what came of that.

        Args:
            send: the file with it, since the worker does not see it.
        """
        from . import admission
        from .slot import Order, fit, sha1_of

        unit = self._units[k]
        path = unit.path.absolute()
        sha1, data = sha1_of(path), None
        if sha1 and (send or path.parent in self._unseen):
            send = True
            with suppress(MerlError):
                data = whole(path, most=LARGEST)
        if sha1 is None:  # said as it would be said without a cluster
            yield k, self.task(unit, lambda stage: tell(k, stage))
            return
        if send and data is None:
            yield (
                k,
                Ended(
                    Ending.BAD_INPUT, error=f"{unit.path}: is too large to be sent to the workers, or is there no more"
                ),
            )
            return
        order = pickle.dumps(Order(unit, self.task, self._run, k, path, sha1, this_run()))
        future = self._client.submit(
            fit, order, data, key=f"{self._resource}-{k}-{uuid.uuid4().hex[:8]}",
            resources={self._resource: 1, admission.ONE: 1}, pure=False,
        )  # fmt: skip
        self._given[k] = future
        future.add_done_callback(lambda future: self._fetch(k, future))

    def _heard(self, message: tuple[int | None, Any], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Act on a message of Dask's threads; a unit that ended."""
        k, what = message
        if isinstance(what, _Gone):
            for text in self._lost(what):
                self.note(text)
        elif k is None:
            self._once(what)
        elif isinstance(what, _Word):
            if k in self._given:
                self._useful = time.monotonic()
                self._word[k] = self._useful, what.worker
                if what.stage:
                    tell(k, what.stage)
        elif self._given.get(k) is what.future:
            for held in (self._word, self._given, self._fetched):
                held.pop(k, None)
            brought = self._brought(k, what)
            if brought is None:
                self._unseen.add(self._units[k].path.absolute().parent)
                yield from self._give(k, tell, send=True)
            else:
                yield k, written(self._units[k], brought)

    def _brought(self, k: int, back: _Back) -> Brought | None:
        """What a worker returned.

        Raises:
            OSError: the scheduler is gone.
        """
        from distributed import KilledWorker

        from .slot import Brought

        path, fetched = self._units[k].path, back.fetched
        error = CancelledError() if fetched.cancelled() else fetched.exception()
        if error is None:
            return fetched.result()
        if back.future.status != "error":
            raise OSError
        if isinstance(error, KilledWorker):
            return Brought(
                Ended(Ending.LOST, error=f"{path}: its worker was lost, at last {error.last_worker.address}")
            )
        # of any kind: said with its name, and the next file has its turn
        return Brought(Ended(Ending.FAILED, error=unexpected(path, error, line(error))))

    # Called in a thread of Dask's.

    def _fetch(self, k: int, future: Future) -> None:
        """Get what a worker holds, while everything else goes on: if it dies now, another begins anew."""

        async def fetch() -> Any:  # noqa: ANN401 - what a task returned
            gathered: Any = self._client.gather(future, asynchronous=True)
            return await gathered

        if self._client.status != "running":
            return  # seen by who waits
        loop: Any = self._client.loop
        fetched = asyncio.run_coroutine_threadsafe(fetch(), loop.asyncio_loop)
        self._fetched[k] = fetched
        fetched.add_done_callback(lambda fetched: self._inbox.put((k, _Back(future, fetched))))

    def _reported(self, event: tuple[float, Any]) -> None:
        """Of a worker: what it is doing."""
        report = event[1]
        if "note" in report:
            self._inbox.put((None, report["note"]))
        elif report["run"] == self._run:
            if "refused" in report:
                self._inbox.put((None, f"worker {report['refused']}; it gets no files: install there what is here"))
            else:
                self._inbox.put((report["unit"], _Word(Stage(report["stage"], report["share"]), report["worker"])))

    def _changed(self, event: tuple[float, Any]) -> None:
        """Of the scheduler: a worker came or went."""
        report = event[1]
        if isinstance(report, dict) and report.get("action") == "remove-worker" and not report.get("expected"):
            found = [re.match(rf"{self._resource}-(\d+)-", key) for key in report["processing-tasks"]]
            gone = _Gone(report["worker"], sorted(int(each[1]) for each in found if each))
            # after what the scheduler says beside it: whether it gives a unit up
            loop: Any = self._client.loop
            loop.add_callback(self._inbox.put, (None, gone))

    # And in that of the caller.

    def _lost(self, gone: _Gone) -> Iterator[str]:
        """What is said of a worker that was lost."""
        if not gone.units:
            yield f"worker {gone.worker} was lost"
        for k in gone.units:
            again = "; another worker starts it again" if k in self._given and self._given[k].status != "error" else ""
            yield f"worker {gone.worker} was lost while fitting {self._units[k].name}{again}"

    def _once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.note(text)

    def _aside(self, call: Callable[[], object], wait: float = CONNECT) -> None:
        """Call what may never return; whether it does is waited for so long, and an error is reported when it comes."""

        def called() -> None:
            try:
                call()
            except Exception as error:  # whatever a worker or the connection runs into: others go on
                self._inbox.put((None, f"{self.where}: {type(error).__name__}: {line(error)}"))

        thread = Thread(target=called, name="merlfit-aside", daemon=True)
        thread.start()
        thread.join(wait)

    def _end(self) -> None:
        """Leave the cluster; workers that came from a queue are given back."""
        from .admission import TOPIC

        self._watch.close()
        if self._client.status == "running":
            for topic in (TOPIC, "all"):  # that this client leaves would be reported to itself
                self._client.unsubscribe_topic(topic)
            self._aside(lambda: self._client.unregister_worker_plugin(self._resource))
        for fetched in list(self._fetched.values()):
            fetched.cancel()
        with suppress(OSError, RuntimeError):
            self._client.close(timeout=CONNECT)
        self._leave()

    def _leave(self) -> None:
        if self._queue is not None:
            self._queue.close()


def written(unit: Unit, brought: Brought) -> Ended:
    """Write what a worker brought; the result last, so that one that is there is whole."""
    if brought.log:
        log(unit.log, brought.log)
    ended = brought.ended
    if ended.error:
        log(unit.log, ended.error)
    if ended.result is None:
        return ended
    try:
        with place_of(unit.out, unit.name) as place:
            if brought.chain is not None:
                write_bytes(chain_of(place.path), brought.chain)
            write_result(place.path, ended.result)
    except WriteError as error:
        return Ended(Ending.FAILED, error=str(error), code=ended.code)
    kept = ended.result if ended.kind in (Ending.FITTED, Ending.STOPPED) else None
    return replace(ended, result=kept, said=place.said)


def _silent(k: int, stage: str) -> None:
    """What nobody is told any more."""
