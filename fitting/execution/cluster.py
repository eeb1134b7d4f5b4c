"""Units on a Dask cluster: a worker fits one at a time, and this process writes what comes back.

A unit is sent to a worker by name, and only when that has nothing else to do: a worker that is lost takes one unit with
it, and which one is known. Dask itself would give it to other workers until it has killed several.

A worker takes a file from where it sees it under the same path with the same SHA-1; otherwise the file is sent to it.
Results come back as values and bytes: folder, manifest and logs belong to this process alone, and nothing need be shared.
"""

from __future__ import annotations

import asyncio
import pickle
import queue
import re
import shutil
import threading
import time
import uuid
import warnings
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ...merl_io.atomic import WriteError, write_atomically
from ..output.keeping import place_of
from ..pipeline.run import chain_of
from ..results.export import write_result
from ..results.schema import this_run
from ..support.clock import Stage
from ..support.terminal import FAILED_FIT, Stopped
from .pool import PATIENCE, Note, Tell
from .slot import TOPIC, Brought, Order, fit, greet, halt, here, sha1_of
from .unit import Ended, Kind, Task, Unit, fit_unit, log

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
SCHEMES = {"dask": "tcp", "dask+tls": "tls"}
SLURM = "dask-slurm"
CONNECT = 5.0  # seconds for a scheduler to answer
LOOK = 0.5  # seconds between two looks at the connection
PROVIDE = 30.0  # seconds between two looks at the workers that a queue was asked for
AT_ONCE = 4  # files that are sent at the same time: each is held here and by the scheduler
LARGEST = 2**30  # bytes of a file that is sent


class ClusterError(ValueError):
    """A cluster that cannot be used; the message is one line with the mend."""


class Gone(Stopped):
    """The scheduler went away: as if somebody had stopped the run."""

    def __init__(self, where: str) -> None:
        BaseException.__init__(self, f"the loss of its scheduler ({where})")
        self.code = FAILED_FIT


class _Lost(Exception):
    """The worker is gone."""


@dataclass
class _Worker:
    """A worker, and whether it is gone, in a way that was planned.

    Attributes:
        unseen: folders here whose files it does not see.
    """

    address: str
    gone: asyncio.Event = field(default_factory=asyncio.Event)
    planned: bool = False
    unseen: set[Path] = field(default_factory=set)


class Cluster:
    """As `pool.Pool`, on the workers of a Dask scheduler, as many as there are and as join while it works.

    Attributes:
        where: ``dask://HOST:PORT``, ``dask+tls://HOST:PORT`` or ``dask-slurm``. count: units at once, as far as known.
    """

    def __init__(self, where: str, jobs: int | None = None, task: Task = fit_unit, note: Note = print) -> None:
        """Connect, and greet the workers that are there.

        Args:
            jobs: units at once, at the most; of ``dask-slurm`` the workers that are asked for.

        Raises:
            ClusterError: no scheduler answers, a library is missing, or no worker has the versions of this process.
        """
        _library("distributed", where, "dask")
        self.where, self.jobs, self.task, self.note = where, jobs, task, note
        self._queue = _slurm(where, jobs) if where == SLURM else None
        self._address = _address(where) if self._queue is None else self._queue.scheduler_address
        self._run = uuid.uuid4().hex
        self._units: Sequence[Unit] = ()
        self._inbox: queue.SimpleQueue[tuple[int | None, Any]] = queue.SimpleQueue()
        self._workers: dict[str, _Worker] = {}
        self._refused: dict[str, str] = {}
        self._losses: Counter[int] = Counter()
        self._busy: dict[int, _Worker] = {}
        self._stopping = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="merlfit-dask", daemon=True)
        self._thread.start()
        try:
            self._call(self._connect())
        except BaseException:
            self._end()
            raise
        self.count = min(jobs or len(self._workers) or 1, len(self._workers) or jobs or 1)

    def ended(self, units: Sequence[Unit], tell: Tell) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end.

        A unit whose worker was lost is tried once more, after all others.
        """
        self._units, left = units, len(units)
        self._loop.call_soon_threadsafe(self._offer, range(len(units)))
        if not self._workers:
            self.note(f"{self.where}: no worker is there yet; waiting for one")
        try:
            while left:
                found = self._heard(self._inbox.get(), tell)
                if found is not None:
                    left -= 1
                    yield found
        except Stopped:  # what is under way is collected by `stop`
            raise
        except BaseException:
            self._end()
            raise
        self._end()

    def stop(self) -> list[tuple[int, Ended]]:
        """Begin nothing more, and end what goes on at its next report: what there is then of each."""
        waiting, found, end = self._call(self._halt()), [], time.monotonic() + PATIENCE
        while waiting and (left := end - time.monotonic()) > 0:
            with suppress(queue.Empty, Gone):
                each = self._heard(self._inbox.get(timeout=left), lambda k, stage: None)
                if each is not None:
                    found.append(each)
                    waiting.discard(each[0])
        self._end()
        return found + [(k, Ended(Kind.STOPPED)) for k in sorted(waiting)]

    def _heard(self, message: tuple[int | None, Any], tell: Tell) -> tuple[int, Ended] | None:
        """Act on a message of the other thread; a unit that ended."""
        k, what = message
        if isinstance(what, Stopped):
            raise what
        if k is None:
            self.note(what)
        elif isinstance(what, str):
            tell(k, what)
        elif isinstance(what, Brought):
            return k, written(self._units[k], what)
        else:  # a file that cannot be read here is judged here
            return k, self.task(self._units[k], lambda stage: tell(k, stage))
        return None

    # What follows runs in the thread of the event loop.

    async def _connect(self) -> None:
        from distributed import Client
        from distributed.versions import VersionMismatchWarning

        warnings.simplefilter("ignore", VersionMismatchWarning)  # a table; what matters is said in a line of ours
        self._waiting: asyncio.Queue[int] = asyncio.Queue()
        self._permits = asyncio.Semaphore(self.jobs or 2**31)
        self._sending = asyncio.Semaphore(AT_ONCE)
        self._client: Client | None = None
        security = self._queue.security if self._queue is not None else None
        try:
            client = Client(self._address, asynchronous=True, timeout=CONNECT, set_as_default=False, security=security)
            self._client = await client
        except (OSError, TimeoutError, ImportError, ValueError, RuntimeError, TypeError) as error:
            why = str(error).splitlines()[0] if isinstance(error, ImportError | ValueError | TypeError) else ""
            raise ClusterError(
                f"{self.where}: no scheduler answers there within {CONNECT:g} s{why and f' ({why})'}; start one with "
                "`dask scheduler`, or check host, port, firewall and TLS"
            ) from None
        client.subscribe_topic("all", self._changed)
        client.subscribe_topic(TOPIC, self._told)
        there = await client.scheduler.identity(n_workers=-1)
        await asyncio.gather(*(self._join(address) for address in there["workers"]))
        if self._refused and not self._workers:
            raise ClusterError(f"{self.where}: {next(iter(self._refused.values()))}")
        self._spawn(self._watch())

    async def _watch(self) -> None:
        """Tell when the scheduler is gone, and ask for workers anew where some of those from a queue were lost."""
        provided = time.monotonic()
        while self._client is not None and self._client.status == "running":
            await asyncio.sleep(LOOK)
            if self._queue is not None and time.monotonic() > provided + PROVIDE:
                provided = time.monotonic()
                self._queue.scale(self.jobs)
        self._inbox.put((None, Gone(self._address)))

    async def _changed(self, event: tuple[float, Any]) -> None:
        """Of the scheduler: a worker came or went."""
        told = event[1]
        if not isinstance(told, dict) or not isinstance(address := told.get("worker"), str):
            return
        if told.get("action") == "add-worker":
            self._spawn(self._join(address))
        elif told.get("action") == "remove-worker" and (worker := self._workers.pop(address, None)) is not None:
            worker.planned = bool(told.get("expected"))
            worker.gone.set()
            if not self._workers and not self._stopping:
                self._inbox.put((None, f"{self.where}: no worker is left; waiting for one"))

    async def _told(self, event: tuple[float, Any]) -> None:
        """Of a worker: what it is doing."""
        told = event[1]
        if "note" in told:
            self._inbox.put((None, told["note"]))
        elif told["run"] == self._run and told["unit"] in self._busy:
            self._inbox.put((told["unit"], Stage(told["stage"], told["share"])))

    async def _join(self, address: str) -> None:
        """Greet a worker; it gets units if it computes as this process would."""
        if address in self._workers or self._stopping:
            return
        worker = self._workers[address] = _Worker(address)
        try:
            refusal = _differences(await self._done(worker, greet, key=f"merlfit-greet-{uuid.uuid4().hex}"))
        except _Lost:
            return
        except Exception as error:  # of its environment: whatever it is, no unit can be fitted there
            refusal = f"cannot run merlfit ({type(error).__name__}: {(str(error).splitlines() or [''])[0]})"
        if not refusal:
            self._spawn(self._employ(worker))
            return
        self._workers.pop(address, None)
        said = f"worker {address} {refusal}; install there what is installed here"
        if refusal not in self._refused and self._workers:
            self._inbox.put((None, f"{said}; it gets no files"))
        self._refused[refusal] = said

    async def _employ(self, worker: _Worker) -> None:
        """Units for a worker, one after the other, until it is gone."""
        with suppress(_Lost):
            while True:
                k = await _unless_gone(worker, self._next())
                try:
                    await self._one(worker, k)
                finally:
                    self._permits.release()

    async def _next(self) -> int:
        await self._permits.acquire()
        try:
            return await self._waiting.get()
        except BaseException:
            self._permits.release()
            raise

    def _offer(self, numbers: Sequence[int]) -> None:
        for k in numbers:
            self._waiting.put_nowait(k)

    async def _one(self, worker: _Worker, k: int) -> None:
        """Have a unit fitted, and hand on what came of it."""
        unit = self._units[k]
        try:
            brought = await self._fit(worker, k)
        except _Lost:
            if not self._stopping:
                self._lost(k, worker)
            return
        except Exception as error:  # of any kind: said with its name, and the next file has its turn
            said = (str(error).splitlines() or [""])[0]
            error = f"{unit.path}: failed unexpectedly on {worker.address}: {type(error).__name__}: {said}"
            brought = Brought(Ended(Kind.FAILED, error=error))
        finally:
            self._busy.pop(k, None)
        if brought is None or not self._stopping or brought.ended.kind is not Kind.LOST:
            self._inbox.put((k, brought))

    def _lost(self, k: int, worker: _Worker) -> None:
        """A unit whose worker is gone has another turn, but a second one only if it can have killed that."""
        said = f"{self._units[k].path}: its worker {worker.address} was lost"
        self._losses[k] += not worker.planned
        if self._losses[k] > 1:
            self._inbox.put((k, Brought(Ended(Kind.LOST, error=said))))
            return
        if not worker.planned:
            self._inbox.put((None, f"{said}; it is tried once more when the others are begun"))
        self._offer([k])

    async def _fit(self, worker: _Worker, k: int) -> Brought | None:
        """What a worker brings of a unit; None if its file cannot be read here.

        Raises:
            _Lost: the worker is gone, or nothing more is to be begun.
        """
        unit = self._units[k]
        path = unit.path.absolute()
        order, found = Order(unit, self.task, self._run, k, path, "", this_run()), None
        if path.parent not in worker.unseen:
            sha1 = await asyncio.to_thread(sha1_of, path) if _regular(path) else None
            if sha1 is None:
                return None
            found = await self._fitted(worker, replace(order, sha1=sha1))
        if found is None:
            worker.unseen.add(path.parent)
            if not _regular(path):
                return None
            if path.stat().st_size > LARGEST:
                return Brought(Ended(Kind.BAD_INPUT, error=f"{unit.path}: is too large to be sent to the workers"))
            found = await self._fitted(worker, order, await self._sent(worker, path))
        return found

    async def _sent(self, worker: _Worker, path: Path) -> Future:
        """Bytes of a file in the memory of a worker."""
        async with self._sending:
            assert self._client is not None
            data = await asyncio.to_thread(path.read_bytes)
            try:
                return await _unless_gone(
                    worker, self._client.scatter(data, workers=[worker.address], hash=False, timeout=PATIENCE)
                )
            except (OSError, TimeoutError, KeyError):  # the scheduler's words for a worker that it lost meanwhile
                await asyncio.wait_for(worker.gone.wait(), PATIENCE)
                raise _Lost from None

    async def _fitted(self, worker: _Worker, order: Order, data: Future | None = None) -> Brought | None:
        if self._stopping:
            raise _Lost
        self._busy[order.number] = worker
        key = f"merlfit-{self._run}-{order.number}-{uuid.uuid4().hex[:8]}"
        return await self._done(worker, fit, pickle.dumps(order), data, key=key)

    async def _done(self, worker: _Worker, function: Callable[..., T], *arguments: object, key: str) -> T:
        """What a function returns in a worker.

        Raises:
            _Lost: the worker is gone.
        """
        from distributed import CancelledError, KilledWorker

        assert self._client is not None
        future = self._client.submit(function, *arguments, key=key, workers=[worker.address], pure=False)
        try:
            return await _unless_gone(worker, future.result())
        except (CancelledError, KilledWorker):  # how Dask says it; its words may come before those that it is gone
            with suppress(TimeoutError):
                await asyncio.wait_for(worker.gone.wait(), CONNECT)
            raise _Lost from None
        finally:
            future.release()

    async def _halt(self) -> set[int]:
        """Units at work, now told to end."""
        self._stopping = True
        busy = dict(self._busy)
        if self._client is None or self._client.status != "running":
            return set(busy)
        if busy:
            workers = [worker.address for worker in busy.values()]
            with suppress(Exception):  # of those that are lost meanwhile nothing comes
                await asyncio.wait_for(self._client.run(halt, self._run, workers=workers, on_error="ignore"), CONNECT)
        return set(busy)

    async def _close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if getattr(self, "_client", None) is not None:
            with suppress(Exception):  # of a scheduler that is gone
                await asyncio.wait_for(self._client.close(), CONNECT)  # pyright: ignore[reportOptionalMemberAccess]

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # And what follows in that of the caller.

    def _call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    def _end(self) -> None:
        """Leave the cluster; workers that came from a queue are given back."""
        if self._loop.is_closed():
            return
        self._call(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        if self._queue is not None:
            self._queue.close()


def written(unit: Unit, brought: Brought) -> Ended:
    """Write what a worker brought; the result last, so that one that is there is whole."""
    if brought.log:
        log(unit, brought.log)
    ended = brought.ended
    if ended.error:
        log(unit, ended.error)
    if ended.result is None:
        return ended
    try:
        with place_of(unit.out, unit.name) as place:
            if brought.chain is not None:
                chain = brought.chain
                write_atomically(chain_of(place.path), lambda file: file.write(chain))
            write_result(place.path, ended.result)
    except WriteError as error:
        return Ended(Kind.FAILED, error=str(error), code=ended.code)
    return replace(ended, result=ended.result if ended.kind in (Kind.FITTED, Kind.STOPPED) else None, said=place.said)


async def _unless_gone(worker: _Worker, awaited: Awaitable[T]) -> T:
    """What it comes to; raises `_Lost` if the worker goes first."""
    task, gone = asyncio.ensure_future(awaited), asyncio.ensure_future(worker.gone.wait())
    try:
        await asyncio.wait({task, gone}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            return task.result()
        raise _Lost
    finally:
        for each in (task, gone):
            each.cancel()
        await asyncio.gather(task, gone, return_exceptions=True)


def _regular(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _differences(theirs: dict[str, str]) -> str:
    """In what a worker differs from this process; nothing if it does not."""
    ours = here()
    told = [f"{name} {theirs.get(name)} instead of {ours[name]}" for name in ours if theirs.get(name) != ours[name]]
    return f"has {', '.join(told)}" if told else ""


def _library(name: str, where: str, extra: str) -> Any:  # noqa: ANN401 - a module
    from importlib import import_module

    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise ClusterError(
            f"--executor {where} needs {name}, which is not installed: pip install 'merlfit[{extra}]'"
        ) from None


def _address(where: str) -> str:
    """As Dask writes it."""
    scheme, _, rest = where.partition("://")
    if scheme not in SCHEMES or not re.fullmatch(r".+:\d+", rest):
        raise ClusterError(f"--executor {where!r} should be dask://HOST:PORT, dask+tls://HOST:PORT or {SLURM}")
    return f"{SCHEMES[scheme]}://{rest}"


def _slurm(where: str, jobs: int | None) -> Any:  # noqa: ANN401 - dask_jobqueue.SLURMCluster, which has no types
    """A scheduler in this process, and workers asked of SLURM as Dask's own files say."""
    made = _library("dask_jobqueue", where, SLURM)
    if jobs is None:
        raise ClusterError(f"--executor {where} needs --jobs N: how many workers SLURM is asked for")
    if shutil.which("sbatch") is None:
        raise ClusterError(f"--executor {where} needs sbatch, which is not found: run merlfit where jobs are submitted")
    try:
        cluster = made.SLURMCluster()
    except (ValueError, TypeError, OSError, RuntimeError) as error:
        why = (str(error).splitlines() or [""])[0]
        raise ClusterError(
            f"--executor {where}: {why}; see docs/clusters.md for ~/.config/dask/jobqueue.yaml"
        ) from None
    cluster.scale(jobs)
    return cluster
