"""Units on a Dask cluster, as many at once as there are workers; this process writes what comes back.

Dask gives the unit of a worker that is lost to another one, and gives it up when several were lost with it
(``distributed.scheduler.allowed-failures``). A worker takes a file from where it sees it under the same path with the
same SHA-1; otherwise the file is sent. Results come back as values and bytes: folder, manifest and logs belong to this
process alone, and nothing need be shared.
"""

from __future__ import annotations

import pickle
import queue
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from ...merl_io.atomic import WriteError, write_bytes
from ...merl_io.source import MerlError, sha1_of, whole
from ..pipeline.draws import chain_of
from ..pipeline.place import place_of
from ..results.manifest import Ending
from ..results.schema_run import this_run
from ..results.storage import versions, write_result
from ..support.clock import Stage
from ..support.outputs import log
from ..support.terminal import why_ended
from .connection import CONNECT, SLURM, ClusterError, address_of, connected, library, line
from .pool import NOTHING, PATIENCE, Note, Tell
from .slurm import Queue
from .unit import Ended, Task, Unit, fit_unit

if TYPE_CHECKING:
    from distributed import Future

    from .admission import Admission
    from .slot import Brought

TICK = 0.1  # seconds between two looks for what came back
LOOK = 0.5  # and between two questions to the scheduler, at the least
SHARE = 20  # so many times as long as an answer took it waits for the next: a scheduler of thousands has other work
QUIET = 120.0  # seconds that a scheduler may be silent
WAIT = 900.0  # seconds without a worker that could do anything; a queue's come when it is their turn
LARGEST = 2**30  # bytes of a file that is sent
KEPT = "what came back is written"


class Cluster:
    """As `pool.Pool`, on the workers of a Dask scheduler, as many as there are and as join while it works.

    Attributes:
        name: address of the scheduler. jobs: units at once, at the most; None for one a worker.
        note: called with what concerns the run and not one unit, once with each text.
    """

    def __init__(self, where: str, jobs: int | None = None, task: Task = fit_unit, note: Note = print) -> None:
        """Connect.

        Args:
            where: ``dask://HOST:PORT``, ``dask+tls://HOST:PORT`` or ``dask-slurm``.
            jobs: of ``dask-slurm`` the workers that are asked for, too.

        Raises:
            ClusterError: no scheduler answers, or a library is missing.
        """
        library("distributed", where, "dask")
        from distributed import as_completed

        self.where = self.name = where
        self.jobs, self.task, self.note = jobs, task, cache(note)
        self._run = uuid.uuid4().hex
        self._units: Sequence[Unit] = ()
        self._given: dict[str, tuple[int, Future]] = {}  # by key, as Dask calls it
        self._unseen: set[Path] = set()  # folders that workers do not see
        self._events: queue.SimpleQueue[tuple[float, Any]] = queue.SimpleQueue()
        self._scheduler, self._workers, self._next = "", {}, 0.0  # at the last look, and when to look again
        self._useful = time.monotonic()  # when there was a worker, or word of one
        self._queue = Queue(where, jobs) if where == SLURM else None
        try:
            its = self._queue
            address, security = (its.address, its.security) if its else (address_of(where), None)
            self._client = connected(where, address, security)
        except BaseException:  # a stop, too: jobs in the queue would outlive the run
            self._leave()
            raise
        self._done = as_completed(loop=self._client.loop, with_results=True, raise_errors=False)
        self._admission = self._admit()

    def _admit(self) -> Admission:
        """Let workers take part, those that come later, too; nobody waits for one that does not answer."""
        import cloudpickle

        from . import admission
        from .slot import listen

        def register() -> None:
            with suppress(OSError):  # of a connection that is lost, as is seen by who waits
                self._client.run_on_scheduler(listen, admission.TOPIC, self._client.id)
                self._client.register_plugin(made)

        cloudpickle.register_pickle_by_value(admission)
        made = admission.Admission(versions())
        for topic in (admission.TOPIC, "all"):
            self._client.subscribe_topic(topic, self._events.put)
        Thread(target=register, daemon=True).start()
        return made

    def ended(self, units: Sequence[Unit], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end.

        Raises:
            ClusterError: the scheduler is gone, or no worker came for a long time.
        """
        from distributed.client import ClosedClientError

        self._units, waiting, self._useful = units, list(range(len(units)))[::-1], time.monotonic()
        try:
            while waiting or self._given:
                room = self.room()
                while waiting and len(self._given) < room:
                    yield from self._give(waiting.pop())
                self._wait(room)
                yield from self._heard(tell)
        except (OSError, ClosedClientError):  # how Dask says it
            self._end()
            raise ClusterError(f"{self.where}: the scheduler is gone; {KEPT}") from None
        self._end()

    def stop(self) -> list[tuple[int, Ended]]:
        """Begin nothing more, and end what goes on at its next report: what there is then of each."""
        from .slot import halt

        until, working = time.monotonic() + PATIENCE, sorted(k for k, _ in self._given.values())
        found: dict[int, Ended] = {}
        with suppress(OSError):  # of a worker that does not answer; the others have heard it
            self._client.run(halt, self._run, on_error="ignore", callback_timeout=CONNECT)
        with suppress(OSError):  # a scheduler that is gone: nothing comes
            while self._given and time.monotonic() < until:
                found |= dict(self._heard(lambda k, stage: None))
        self._end()
        return [(k, found.get(k, NOTHING)) for k in working]

    def room(self) -> int:
        """Units that may be on the cluster at once.

        Raises:
            OSError: the scheduler is gone, silent, or another one than it was.
        """
        if self._client.status != "running":
            raise OSError
        begun = time.monotonic()
        if begun > self._next:
            asked: Any = self._client.scheduler
            found: Any = self._client.sync(asked.identity, callback_timeout=QUIET)
            if found["id"] != (self._scheduler or found["id"]):
                raise OSError
            self._scheduler, self._workers = found["id"], found["workers"]
            self._next = time.monotonic() + max(LOOK, SHARE * (time.monotonic() - begun))
        able = sum(each["status"] == "running" for each in self._admitted().values())
        return able if self.jobs is None else min(able, self.jobs)

    def _admitted(self) -> dict[str, Any]:
        """Workers that may have units, by address."""
        return {at: each for at, each in self._workers.items() if self._admission.name in each["resources"]}

    def _wait(self, room: int) -> None:
        """Say why nothing goes on, and wait for it no longer than is sensible."""
        now = time.monotonic()
        self._useful = now if room else self._useful
        refusals = self._queue.refusals() if self._queue else []
        if said := next(filter(None, refusals), ""):
            if all(refusals):
                self._end()
                raise ClusterError(f"{self.where}: sbatch took no job ({said})")
            self.note(f"{self.where}: sbatch did not take a job ({said}); the others go on")
        if now > self._useful + CONNECT:
            self.note(f"{self.where}: {self._why()}; waiting for another")
        if now > self._useful + WAIT and self._queue is None:
            self._end()
            raise ClusterError(f"{self.where}: {self._why()} for {WAIT / 60:g} minutes; {KEPT}")

    def _why(self) -> str:
        """In words, why no worker can do anything."""
        for address, each in self._admitted().items():
            used, limit = each["metrics"].get("memory", 0) / 2**30, (each["memory_limit"] or 0) / 2**30
            return (
                f"worker {address} takes nothing, since {used:.1f} of {limit:.1f} GiB are in use: give workers more "
                "memory (`dask worker --memory-limit`)"
            )
        count = len(self._workers)
        return f"none of {count} workers has the versions of this process" if count else "no worker is there"

    def _give(self, k: int, send: bool = False) -> Iterator[tuple[int, Ended]]:
        """Hand a unit to the scheduler; of a file that cannot be read, what came of that.

        Args:
            send: the file with it, since the worker does not see it.
        """
        from .slot import Order, fit

        unit = self._units[k]
        path = unit.path.absolute()
        send = send or path.parent in self._unseen
        try:
            sha1, data = sha1_of(unit.path), whole(unit.path, most=LARGEST) if send else None
        except MerlError as error:
            yield k, Ended(Ending.BAD_INPUT, error=str(error))
            return
        order = pickle.dumps(Order(unit, self.task, self._run, k, path, sha1))
        key = f"merlfit-{self._run}-{k}{'-sent' if send else ''}"
        future = self._client.submit(fit, order, data, key=key, resources={self._admission.name: 1}, pure=False)
        self._given[key] = k, future
        self._done.add(future)

    def _heard(self, tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Units that ended; what is said of others is told."""
        with suppress(queue.Empty):
            said = self._events.get(timeout=TICK)[1]
            while True:
                self._tell(said if isinstance(said, dict) else {}, tell)
                said = self._events.get_nowait()[1]
        for future, came in self._done.next_batch(block=False):
            k, _ = self._given.pop(future.key)
            brought = self._brought(k, future, came)
            if brought is None:
                self._unseen.add(self._units[k].path.absolute().parent)
                yield from self._give(k, send=True)
            else:
                yield k, written(self._units[k], brought)

    def _tell(self, said: dict[str, Any], tell: Tell) -> None:
        """What a worker says, and what the scheduler says of one."""
        if "note" in said:
            self.note(said["note"])
        elif "refused" in said and said["by"] == self._admission.name:
            self.note(f"worker {said['refused']}; it gets no files: install there what is here")
        elif "stage" in said and said["by"] == self._run:
            self._useful = time.monotonic()
            if said["unit"] in [k for k, _ in self._given.values()]:
                tell(said["unit"], Stage(said["stage"], said["share"]))
        elif said.get("action") == "remove-worker" and not said["expected"]:
            for key in self._given.keys() & set(said["processing-tasks"]):
                k, future = self._given[key]
                again = "; another worker starts it again" if future.status != "error" else ""
                self.note(f"worker {said['worker']} was lost while fitting {self._units[k].name}{again}")

    def _brought(self, k: int, future: Future, came: Any) -> Brought | None:  # noqa: ANN401 - as Dask has it
        """What a worker returned.

        Raises:
            OSError: the scheduler is gone.
        """
        from distributed import KilledWorker

        from .slot import Brought

        path = self._units[k].path
        if future.status == "finished":
            return came
        if future.status != "error":
            raise OSError
        error = came[1]
        if isinstance(error, KilledWorker):
            said = f"{path}: its worker was lost, at last {error.last_worker.address}"
            return Brought(Ended(Ending.LOST, error=said))
        # of any kind: said with its name, and the next file has its turn
        return Brought(Ended(Ending.FAILED, error=why_ended(path, error, line(error))))

    def _end(self) -> None:
        """Leave the cluster; workers that came from a queue are given back."""
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
    ended.result.source.path, ended.result.run = str(unit.path), this_run()
    try:
        with place_of(unit.out, unit.name) as place:
            if brought.chain is not None:
                write_bytes(chain_of(place.path), brought.chain)
            write_result(place.path, ended.result)
    except WriteError as error:
        return Ended(Ending.FAILED, error=str(error), code=ended.code)
    kept = ended.result if ended.kind in (Ending.FITTED, Ending.STOPPED) else None
    return replace(ended, result=kept, said=place.said)
