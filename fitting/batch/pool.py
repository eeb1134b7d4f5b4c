"""Units in worker processes of this machine.

A worker that dies, whatever killed it, takes with it the one unit that it worked on: `concurrent.futures` would give up
all of them. So every worker has a pipe of its own, of which the end is seen, and no lock is shared with another.
"""

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from ..results.manifest import Ending
from ..support.affinity import begun_on, cores_of, spread
from ..support.clock import Stage
from ..support.outputs import open_log
from ..support.processes import end_with_parent
from ..support.terminal import Stopped, stoppable
from .unit import Ended, Task, Unit, fit_unit

PATIENCE = 20.0  # seconds that workers have to write what they hold when they are told to stop
TOLD = 128 + signal.SIGTERM  # exit code of a worker that stopped
GRACE = 0.5  # seconds after which a stop that came to one worker was for that one alone
Tell = Callable[[int, str], None]  # of the unit with this number, what is being done
Note = Callable[[str], None]


NOTHING = Ended(Ending.STOPPED)


@dataclass
class _Worker:
    """A process, our end of its pipe, the number of the unit that it works on, what there is of it if it stopped."""

    process: SpawnProcess
    pipe: Connection
    cores: list[int]
    unit: int | None = None
    last: Ended = NOTHING

    def tell_to_stop(self) -> None:
        """As job schedulers do it; one that was halted goes on, since it could not hear it."""
        self.process.terminate()
        if self.process.pid is not None and self.process.is_alive():
            with suppress(OSError):
                os.kill(self.process.pid, signal.SIGCONT)


class Pool:
    """Units in ``jobs`` processes at once, each with its share of the cores.

    Attributes:
        note: called with what concerns the run and not one unit alone.
    """

    name = "Pool"

    def __init__(self, jobs: int, task: Task = fit_unit, note: Note = print) -> None:
        self.jobs, self.task, self.note = jobs, task, note
        self._workers: list[_Worker] = []
        self._noted: set[str] = set()

    def ended(self, units: Sequence[Unit], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end.

        A unit whose worker died is tried once more, after all others and alone on the machine.
        """
        lost: list[int] = []
        for k, ended in self._all(units, deque(range(len(units))), self.jobs, tell):
            if ended.kind is Ending.LOST:
                lost.append(k)
                self.note(f"{ended.error}; it is tried once more when the others are done, alone")
            else:
                yield k, ended
        for k in lost:
            for _, ended in self._all(units, deque([k]), 1, tell):
                yield k, replace(ended, error=f"{ended.error}, twice") if ended.kind is Ending.LOST else ended
        self._end()

    def stop(self) -> list[tuple[int, Ended]]:
        """End all workers; of each that was at work: its unit, and what there is of it."""
        for worker in self._workers:
            worker.tell_to_stop()
        found, until = [], time.monotonic() + PATIENCE
        for worker in self._workers:
            with suppress(EOFError, OSError):
                while worker.pipe.poll(max(0.0, until - time.monotonic())):
                    message = worker.pipe.recv()
                    worker.last = message if isinstance(message, Ended) else worker.last
            if worker.unit is not None:
                found.append((worker.unit, worker.last))
        self._end(until)
        return found

    def _all(self, units: Sequence[Unit], waiting: deque[int], jobs: int, tell: Tell) -> Iterator[tuple[int, Ended]]:
        self._staff(min(jobs, len(waiting)))
        while waiting or any(worker.unit is not None for worker in self._workers):
            for worker in self._workers:
                if worker.unit is None and waiting:
                    with suppress(OSError):  # it has died while it was idle; what is left of it is seen below
                        worker.pipe.send(units[waiting[0]])
                    worker.unit = waiting.popleft()
            for pipe in wait([worker.pipe for worker in self._workers]):
                n, worker = next((n, w) for n, w in enumerate(self._workers) if w.pipe is pipe)
                try:
                    message = worker.pipe.recv()
                except (EOFError, OSError):
                    message = None
                if isinstance(message, Ended) and message.kind is Ending.STOPPED:
                    worker.last = message
                    time.sleep(GRACE)  # where all are told to stop, so are we now
                    message = None
                if message is None:
                    unit, error = worker.unit, _why(worker.process)
                    self._workers[n] = self._worker(worker.cores)
                    if unit is not None:
                        yield unit, Ended(Ending.LOST, error=f"{units[unit].path}: {error}")
                elif isinstance(message, Ended):
                    unit, worker.unit = worker.unit, None
                    if unit is not None:
                        yield unit, message
                elif isinstance(message, _Note):
                    if message.text not in self._noted:
                        self._noted.add(message.text)
                        self.note(message.text)
                elif worker.unit is not None:
                    tell(worker.unit, message)

    def _staff(self, jobs: int) -> None:
        """So many workers; those that are there stay if their number does."""
        if len(self._workers) == jobs:
            return
        self._end()
        cores = cores_of()
        self._workers = [self._worker(cores[n::jobs]) for n in range(jobs)]

    def _worker(self, cores: list[int]) -> _Worker:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, self.task, cores_of()), daemon=True)
        with begun_on(cores):  # libraries see these alone, and have a thread for each
            process.start()
        theirs.close()
        return _Worker(process, ours, cores)

    def _end(self, until: float | None = None) -> None:
        """End all workers, by force those that have not ended by then (`time.monotonic`)."""
        for worker in self._workers:
            worker.pipe.close()
            worker.tell_to_stop()
        until = time.monotonic() + PATIENCE if until is None else until
        for worker in self._workers:
            worker.process.join(max(0.0, until - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
        self._workers = []


def _why(process: SpawnProcess) -> str:
    """Why a worker died, as far as that can be told."""
    process.join(PATIENCE)
    code = process.exitcode or 0
    if code == TOLD:
        return "its process was told to stop (SIGTERM, as some systems do when memory is short)"
    if code >= 0:
        return f"its process ended (exit code {code})"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    memory = ", as the system does when memory runs out" if -code == signal.SIGKILL else ""
    return f"its process was killed ({name}{memory})"


@dataclass(frozen=True)
class _Note:
    """What a worker says that is not of one unit."""

    text: str


def _work(pipe: Connection, task: Task, cores: list[int]) -> None:
    """Of a worker: units from the pipe, one after the other, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all its processes: ours says what to do
    threading.Thread(target=end_with_parent, daemon=True).start()
    import jax

    from ..support.compilation import use_persistent_cache

    jax.devices()  # makes its threads
    spread(cores)
    one = threading.Lock()  # several threads compile, and tell of it

    def send(message: _Note | str) -> None:
        with one, suppress(OSError):
            pipe.send(message)

    def tell(stage: str) -> None:
        send(stage if isinstance(stage, Stage) else str(stage))

    use_persistent_cache(lambda text: send(_Note(text)))

    with suppress(EOFError, OSError, Stopped), stoppable():
        while True:
            unit: Unit = pipe.recv()
            with _into(unit):
                ended = task(unit, tell)
            pipe.send(ended)
            if ended.kind is Ending.STOPPED:
                sys.exit(TOLD)


@contextmanager
def _into(unit: Unit) -> Iterator[None]:
    """What this process prints, and libraries written in other languages, goes to the unit's log."""
    try:
        file = open_log(unit.log)
    except OSError:
        file = open(os.devnull, "ab")  # noqa: SIM115
    with file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    yield
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # it was closed before we began: there is none
            stream.flush()
