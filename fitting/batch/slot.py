"""What is done in a worker of a Dask cluster: one unit at a time, in a folder of its own that goes with it.

Scheduler and workers import this file, so it imports little: orders come as bytes, which the scheduler does not read,
and JAX is imported when the first unit is there, on the worker's cores alone.
"""

from __future__ import annotations

import pickle
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from distributed import Worker, get_worker

from ...merl_io.source import MerlError, sha1_of, whole
from ..support.affinity import begun_on, cores_of
from ..support.allocation import keep_freed_memory
from .admission import TOPIC

if TYPE_CHECKING:
    from .unit import Ended, Task, Unit

PERIOD = 2.0  # seconds between two steps of one stage that are reported: all of them pass through the scheduler
_halted: set[str] = set()  # runs that are to end


@dataclass(frozen=True)
class Order:
    """A unit for a worker.

    Attributes:
        run, number: names of the run, and of the unit in it. path: of the file, absolute. sha1: that it must have.
    """

    unit: Unit
    task: Task
    run: str
    number: int
    path: Path
    sha1: str


@dataclass(frozen=True)
class Brought:
    """What comes back.

    Attributes:
        ended: its ``result`` is what was written, whatever the kind. chain: bytes of the file. log: text.
    """

    ended: Ended
    chain: bytes | None = None
    log: str = ""


def present() -> None:
    """In a scheduler: this file is there."""


def listen(topic: str, client: str, dask_scheduler: Any = None) -> None:  # noqa: ANN401 - a scheduler
    """In a scheduler: a client hears of this topic from now on; its own request may come after what it asks about."""
    dask_scheduler.subscribe_topic(topic, client)


def halt(run: str) -> None:
    """In a worker: the unit of this run ends at its next report."""
    _halted.add(run)


def fit(order: bytes, data: bytes | None) -> Brought | None:
    """In a worker: fit a unit.

    Args:
        order: a pickled `Order`. data: of the file, if it is sent.

    Returns:
        None if the file is not here, or another of that name.
    """
    worker = get_worker()
    _begin(worker.state.nthreads)
    given: Order = pickle.loads(order)
    with TemporaryDirectory(prefix="merlfit-", dir=worker.local_directory, ignore_cleanup_errors=True) as scratch:
        path, out = given.path, Path(scratch) / "out"
        if data is not None:
            path = Path(scratch) / "in" / given.path.name
            path.parent.mkdir()
            path.write_bytes(data)
        elif _sha1(path) != given.sha1:
            return None
        out.mkdir()
        unit = replace(given.unit, path=path, out=out)
        return _brought(given, unit, given.task(unit, _reports(worker, given)))


def _sha1(path: Path) -> str | None:
    """None where there is no file that can be read."""
    with suppress(MerlError):
        return sha1_of(path)


@cache
def _begin(cores: int) -> None:
    """Once a process: libraries, with a thread for each of the worker's cores."""
    keep_freed_memory()
    every, worker = cores_of(), get_worker()
    with begun_on(every[:cores]):
        from ..support.compilation import begin_libraries
    begin_libraries(every[:cores], every, lambda text: worker.log_event(TOPIC, {"note": f"{platform.node()}: {text}"}))


def _reports(worker: Worker, order: Order) -> Callable[[str], None]:
    """Reports that the client hears, and that end the unit where its run is to end."""
    from ..support.terminal import Stopped

    last = ["", 0.0]

    def report(stage: str) -> None:
        if order.run in _halted:
            raise Stopped
        begun, now = stage.split(":")[0], time.monotonic()
        if begun != last[0] or now > last[1] + PERIOD:
            last[:] = begun, now
            said = {"unit": order.number, "stage": str(stage), "share": getattr(stage, "share", None)}
            worker.log_event(TOPIC, {"by": order.run, **said})

    return report


def _brought(order: Order, unit: Unit, ended: Ended) -> Brought:
    """What a unit left in the worker's folder; messages have the client's names for files."""
    from ..pipeline.draws import chain_of
    from ..results.storage import ResultError, read_result

    def said(text: str) -> str:
        return text.replace(str(unit.out), str(order.unit.out)).replace(str(unit.path), str(order.unit.path))

    result, chain, log = ended.result, None, ""
    with suppress(ResultError, OSError):
        result = read_result(unit.target)
    with suppress(MerlError):
        chain = whole(chain_of(unit.target))
    with suppress(MerlError):
        log = whole(unit.log).decode(errors="replace")
    return Brought(replace(ended, result=result, error=said(ended.error), said=said(ended.said)), chain, said(log))
