"""Units in worker processes of this machine.

A worker that dies, whatever killed it, takes with it the one unit that it worked on: `concurrent.futures` would give up
all of them, and pools that begin it anew (pebble, multiprocessing) lose the others to a lock that it held. So every
worker has a pipe of its own, of which the end is seen, and shares no lock.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from ..results.manifest import Ending
from ..support.affinity import begun_on, cores_of
from ..support.clock import Stage
from ..support.compilation import begin_libraries
from ..support.outputs import open_log
from ..support.processes import end_with_parent
from ..support.terminal import Stopped, stoppable
from .unit import Ended, Task, Unit, fit_unit

PATIENCE = 20.0  # seconds that workers have to write what they hold when they are told to stop
TOLD = 128 + signal.SIGTERM  # exit code of a worker that stopped
GRACE = 0.5  # seconds after which a stop that came to one worker was for that one alone
NOTHING = Ended(Ending.STOPPED)
Tell = Callable[[int, str], None]  # of the unit with this number, what is being done
Note = Callable[[str], None]


@dataclass
class _Worker:
    """A process, our end of its pipe, the number of the unit that it works on, what there is of it if it stopped."""

    process: SpawnProcess
    pipe: Connection
    cores: list[int]
    unit: int | None = None
    last: Ended = NOTHING

    def heard(self) -> Stage | str | Ended:
        """What is being done, a note of no unit, or what came of the unit; `Ending.LOST` if the process is no more."""
        with suppress(EOFError, OSError):
            said = self.pipe.recv()
            if not isinstance(said, Ended) or said.kind is not Ending.STOPPED:
                return said
            self.last = said
            time.sleep(GRACE)  # where all are told to stop, so are we now
        return Ended(Ending.LOST, error=_why(self.process))

    def tell_to_stop(self) -> None:
        """As job schedulers do it; one that was halted goes on, since it could not hear it."""
        self.process.terminate()
        if self.process.pid is not None and self.process.is_alive():
            with suppress(OSError):
                os.kill(self.process.pid, signal.SIGCONT)


class Pool:
    """Units in ``jobs`` processes at once, each with its share of the cores.

    Attributes:
        note: called with what concerns the run and not one unit alone, once with each text.
    """

    name = "Pool"

    def __init__(self, jobs: int, task: Task = fit_unit, note: Note = print) -> None:
        self.jobs, self.task, self.note = jobs, task, cache(note)
        self._workers: list[_Worker] = []

    def ended(self, units: Sequence[Unit], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end.

        A unit whose worker died is tried once more, after all others and alone on the machine.
        """
        lost: list[int] = []
        for k, ended in self._all(units, range(len(units)), self.jobs, tell):
            if ended.kind is Ending.LOST:
                lost.append(k)
                self.note(f"{ended.error}; it is tried once more when the others are done, alone")
            else:
                yield k, ended
        for k in lost:
            for _, ended in self._all(units, [k], 1, tell):
                yield k, replace(ended, error=f"{ended.error}, twice") if ended.kind is Ending.LOST else ended
        self._end(time.monotonic() + PATIENCE)

    def stop(self) -> list[tuple[int, Ended]]:
        """End all workers; of each that was at work: its unit, and what there is of it."""
        until = time.monotonic() + PATIENCE
        for worker in self._workers:
            worker.tell_to_stop()
        for worker in self._workers:
            with suppress(EOFError, OSError):
                while worker.pipe.poll(max(0.0, until - time.monotonic())):
                    if isinstance(said := worker.pipe.recv(), Ended):
                        worker.last = said
        found = [(worker.unit, worker.last) for worker in self._workers if worker.unit is not None]
        self._end(until)
        return found

    def _all(self, units: Sequence[Unit], numbers: Iterable[int], jobs: int, tell: Tell) -> Iterator[tuple[int, Ended]]:
        waiting = list(numbers)[::-1]
        self._staff(min(jobs, len(waiting)))
        while waiting or any(worker.unit is not None for worker in self._workers):
            for worker in self._workers:
                if worker.unit is None and waiting:
                    worker.unit = waiting.pop()
                    with suppress(OSError):  # it has died while it was idle, which is heard below
                        worker.pipe.send(units[worker.unit])
            ready = wait([worker.pipe for worker in self._workers])
            for n, worker in [each for each in enumerate(self._workers) if each[1].pipe in ready]:
                said, unit = worker.heard(), worker.unit
                if isinstance(said, Ended):
                    worker.unit = None
                    if said.kind is Ending.LOST:
                        self._workers[n] = self._worker(worker.cores)
                    if unit is not None:
                        lost = said.kind is Ending.LOST
                        yield unit, replace(said, error=f"{units[unit].path}: {said.error}") if lost else said
                elif not isinstance(said, Stage):
                    self.note(said)
                elif unit is not None:
                    tell(unit, said)

    def _staff(self, jobs: int) -> None:
        """So many workers; those that are there stay if their number does."""
        if len(self._workers) != jobs:
            self._end(time.monotonic() + PATIENCE)
            self._workers = [self._worker(cores_of()[n::jobs]) for n in range(jobs)]

    def _worker(self, cores: list[int]) -> _Worker:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, self.task, cores_of()), daemon=True)
        with begun_on(cores):  # libraries see these alone, and have a thread for each
            process.start()
        theirs.close()
        return _Worker(process, ours, cores)

    def _end(self, until: float) -> None:
        """End all workers, by force those that have not ended by then (`time.monotonic`)."""
        for worker in self._workers:
            worker.pipe.close()
            worker.tell_to_stop()
        for worker in self._workers:
            worker.process.join(max(0.0, until - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
        self._workers = []


def _why(process: SpawnProcess) -> str:
    """Why a worker died, as far as that can be told."""
    process.join(PATIENCE)
    code = process.exitcode or 0
    if code == -signal.SIGKILL:
        return "its process was killed (SIGKILL, as the system does when memory runs out)"
    if code == TOLD:
        return "its process was told to stop (SIGTERM, as some systems do when memory is short)"
    return f"its process ended ({signal.strsignal(-code) if code < 0 else f'exit code {code}'})"


def _work(pipe: Connection, task: Task, cores: list[int]) -> None:
    """The loop of a worker: units from the pipe, one after the other, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all its processes: ours says what to do
    end_with_parent()
    one = threading.Lock()  # several threads compile, and tell of it

    def send(said: str) -> None:
        with one, suppress(OSError):
            pipe.send(said)

    def tell(stage: str) -> None:
        send(Stage(stage, getattr(stage, "share", None)))

    begin_libraries(cores_of(), cores, send)
    with suppress(EOFError, OSError, Stopped), stoppable():
        while True:
            unit: Unit = pipe.recv()
            _print_into(unit.log)
            ended = task(unit, tell)
            pipe.send(ended)
            if ended.kind is Ending.STOPPED:
                sys.exit(TOLD)


def _print_into(path: Path) -> None:
    """What this process prints from now on, and libraries written in other languages, goes to a log."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # it was closed before we began: there is none
            stream.flush()
    try:
        file = open_log(path)
    except OSError:
        file = open(os.devnull, "ab")  # noqa: SIM115
    with file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
