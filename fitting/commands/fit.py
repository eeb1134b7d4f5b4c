"""Fits of files, as the commands `merlfit fit` and `merlfit demo` make them."""

import os
import shlex
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer
from rich.progress import Progress, TaskID

from ...merl_io.atomic import WriteError
from ...merl_io.binary import MerlError
from ...merl_io.inputs import is_scattered
from ...merl_io.source import sha1_of
from ..batch.cluster import Cluster, ClusterError
from ..batch.here import Here
from ..batch.pool import Pool
from ..batch.unit import Ended, Unit
from ..cost.accuracy import Aim, aim
from ..cost.request import request
from ..pipeline.models import candidates
from ..pipeline.place import Completeness, claimed, completeness, results_beside
from ..results.manifest import Ending, Journal
from ..results.schema import Result
from ..results.storage import valid_result
from ..settings.config import Config
from ..show.terminal_tables import Outcome, accuracy_line, summary_table
from ..support.choices import Device
from ..support.numbers import counted
from ..support.processes import jobs_for
from ..support.terminal import (
    BAD_INPUT,
    FAILED_FIT,
    Stopped,
    console,
    fail,
    note,
    progress_display,
    reporter,
    writable_folder,
)

if TYPE_CHECKING:  # it loads JAX
    from ..batch.gpu import Gpu

DEVICES = ("gpu", "cpu")
Aims = dict[bool, Aim]
"""What files are taken to, by whether they hold scattered directions; empty where nothing was asked for."""


def aims_of(settings: Config, accuracy: float | None, within: str | None, files: list[Path]) -> Aims:
    """Choose settings for an accuracy or a time, and print them."""
    if accuracy is None and within is None:
        return {}
    if within is not None and (scattered := next(filter(is_scattered, files), None)):
        raise fail(
            f"{scattered}: holds scattered directions, and what settings take is calibrated on MERL's grid: leave "
            "--time out"
        )
    asked = request(accuracy, within)
    aims = {kind: aim(asked, settings, kind) for kind in sorted(set(map(is_scattered, files)))}
    for each in aims.values():
        console.print(each.summary)
    return aims


def numbered(k: int, of: int, name: str) -> str:
    """Which of several files it is; of one its name is enough."""
    return f"[{k + 1}/{of}] {name}" if of > 1 else name


def refuse_same_names(files: list[Path]) -> None:
    """End with an error where two results would have one name."""
    twice = [name for name, count in Counter(path.stem for path in files).items() if count > 1]
    if twice:
        raise fail(
            f"several files are named {twice[0]}, and a result is named after its file: fit them into different folders"
        )


def device_of(asked: str | None, settings: Config, *others: str) -> Device | None:
    """The device on which all files are fitted together; None for the CPU, a file at a time in each process.

    Args:
        others: options that were given and cannot be kept there.
    """
    if asked is None:
        return None
    if asked not in DEVICES:
        raise fail(f"--device {asked}: is neither {' nor '.join(DEVICES)}")
    if asked == "cpu":
        os.environ["JAX_PLATFORMS"] = "cpu"
        return None
    import jax

    try:
        device, _ = jax.devices(asked)[0], jax.devices("cpu")
    except RuntimeError:
        if platforms := os.environ.get("JAX_PLATFORMS"):
            raise fail(f"--device {asked}: JAX_PLATFORMS={platforms} leaves out the GPU or the CPU: unset it") from None
        raise fail(
            f"--device {asked}: JAX finds no GPU here, only {jax.devices()[0].platform}; with a GPU of NVIDIA, "
            "pip install 'jax[cuda13]' into merlfit's environment"
        ) from None
    from ..batch.gpu import not_offered

    if without := [*others, *filter(None, [not_offered(settings)])]:
        raise fail(f"--device {asked}: all files are fitted together, which is not offered with {without[0]}")
    return device


def executor_of(
    units: int, jobs: int | None = None, where: str | None = None
) -> tuple[Here | Pool | Cluster, int | Literal["one a worker"]]:
    """What fits so many units, and how many at once; a single one needs no process of its own.

    Args:
        where: of a cluster, as `batch.cluster.Cluster` takes it; None for this machine.

    Raises:
        merlfit.fitting.batch.cluster.ClusterError: the cluster cannot be used.
    """
    if where is not None and units:
        return Cluster(where, jobs, note=note), jobs or "one a worker"
    count = jobs_for(units, jobs)
    return (Here(), 1) if units <= 1 else (Pool(count, note=note), count)


def gpu_of(device: Device, units: int, jobs: int | None = None) -> tuple["Gpu", int]:
    """What fits so many units together on a device of JAX's, and in how many processes it writes their results."""
    from ..batch.gpu import Gpu

    count = jobs_for(max(1, units), jobs)
    return Gpu(device, Pool(count, note=note)), count


def fit_files(
    files: list[Path], out: Path, settings: Config, aims: Aims | None = None, jobs: int | None = None,
    resume: bool = False, where: str | None = None, device: Device = None,
) -> list[Outcome]:  # fmt: skip
    """Fit files, and write each result when it is done; whatever one runs into, the others are fitted.

    Args:
        jobs: processes at the same time; None for as many as cores and memory allow.
        resume: leave alone what has a result of the same file, settings and versions.
        where: of a cluster, as `executor_of` takes it. device: as `gpu_of` takes it.

    Returns:
        what came of each file, in their order.
    """
    writable_folder(out)
    refuse_same_names(files)
    found_aims = [(aims or {}).get(is_scattered(path)) for path in files]
    units = [
        Unit(path, out, aim.settings if aim else settings, aim.finish if aim else None)
        for path, aim in zip(files, found_aims, strict=True)
    ]
    chosen = units[0].settings if units else settings
    candidates(chosen)  # said before any file is read, if there is none
    found: dict[int, Outcome] = {}
    start = time.perf_counter()
    with claimed(out), progress_display() as progress:
        for k, result in enumerate(map(_done, units) if resume else ()):
            if result is not None:
                found[k] = Outcome(files[k], result)
        left = [k for k in range(len(units)) if k not in found]
        journal = Journal(out)
        executor, count = executor_of(len(left), jobs, where) if device is None else gpu_of(device, len(left), jobs)
        journal.began(chosen, len(files), count, executor.name)
        for k, outcome in found.items():
            journal.ended(units[k].path, "kept", outcome.result)
        if found:
            done = f"{len(found)} of {counted(len(files), 'file')}"
            console.print(f"done already: {done}, of the same data, settings and versions")
        run = _Run(units, left, found, progress, journal)
        try:
            for k, ended in executor.ended([units[k] for k in left], run.tell):
                run.book(left[k], ended)
                if ended.kind is Ending.STOPPED:
                    raise Stopped(ended.code - 128)
        except Stopped as stop:
            for k, ended in executor.stop():  # some of them came to their end meanwhile
                run.book(left[k], ended)
            journal.closed(True, time.perf_counter() - start)
            words = [_kept(units[k], run.stopped[k]) for k in sorted(run.stopped)]
            run.say_left(f"stopped by {stop}: ", words, "not begun")
            raise typer.Exit(stop.code) from None
        except ClusterError as error:
            journal.closed(True, time.perf_counter() - start)
            fail(str(error))
            run.say_left("", [], "not fitted")
            raise typer.Exit(FAILED_FIT) from None
        except WriteError:  # of the manifest: nobody waits for what others still do
            executor.stop()
            raise
        journal.closed(False, time.perf_counter() - start)
    return [found[k] for k in sorted(found)]


def _done(unit: Unit) -> Result | None:
    """A whole result of the same file, settings and versions, in its place or beside another of its name."""
    try:
        sha1 = sha1_of(unit.path)
    except MerlError:
        return None  # said when it is fitted
    settings = unit.settings.for_scattered if is_scattered(unit.path) else unit.settings
    for path in (unit.target, *results_beside(unit.target)):
        found = valid_result(path, sha1, settings)
        if found is None or not found.fit.succeeded or (found.accuracy is None) != (unit.finish is None):
            continue
        free = sum(q.fitted == "free" for q in found.parameters)
        if found.posterior is not None or not settings.posterior.samples(free):
            return found
    return None


class _Run:
    """What is shown and written down while units are fitted.

    Attributes:
        left: numbers of the units that were not done before. found: what came of each that is done.
        stopped: units that were not fitted to the end, and what there is of them.
    """

    def __init__(
        self, units: list[Unit], left: list[int], found: dict[int, Outcome], progress: Progress, journal: Journal
    ) -> None:
        self.units, self.left, self.found, self.progress, self.journal = units, left, found, progress, journal
        self.stopped: dict[int, Ended] = {}
        self.batch = progress.add_task("", total=len(left), visible=len(left) > 1)
        self._count()
        self.tasks: dict[int, tuple[TaskID, Callable[[str], None]]] = {}

    def label(self, k: int) -> str:
        return numbered(k, len(self.units), self.units[k].name)

    def tell(self, k: int, stage: str) -> None:
        k = self.left[k]
        if k not in self.tasks:
            task = self.progress.add_task(self.units[k].path.name, total=None)
            self.tasks[k] = task, reporter(self.progress, task, self.label(k))
        self.tasks[k][1](stage)

    def book(self, k: int, ended: Ended) -> None:
        """Show and write down what came of a unit, unless it was stopped."""
        if ended.kind is Ending.STOPPED:
            self.stopped[k] = ended
            return
        result, label = ended.result, self.label(k)
        self.journal.ended(self.units[k].path, ended.kind, ended.result, ended.error)
        if result is not None:
            console.print(f"{label}: {result.fit.status}, {result.seconds['total']:.1f} s")
            if result.accuracy is not None:
                console.print(f"{label}: {accuracy_line(result.accuracy)}")
        else:
            fail(_with_command(self.units[k].path, ended.error))
        if ended.said:
            note(ended.said)
        if k in self.tasks:
            self.progress.remove_task(self.tasks.pop(k)[0])
        self.found[k] = Outcome(self.units[k].path, result, ended.error or None, ended.kind is Ending.BAD_INPUT)
        self._count()

    def _count(self) -> None:
        done = len(self.found.keys() & self.left)
        self.progress.update(self.batch, completed=done, description=f"{done} of {counted(len(self.left), 'file')}")

    def say_left(self, why: str, words: list[str], rest: str) -> None:
        """What was not done of a run that ends before all of it is, and a table of what was."""
        if left := len(self.units) - len(self.found) - len(self.stopped):
            words = [*words, f"{rest}: {left} of {counted(len(self.units), 'file')}"]
        if len(self.units) > 1:
            words = [*words, "the same command with --resume goes on"]
        note(why + "; ".join(words))
        outcomes = [self.found[k] for k in sorted(self.found)]
        outcomes += [Outcome(self.units[k].path, each.result) for k, each in self.stopped.items() if each.result]
        if outcomes:
            console.print(summary_table(outcomes))


def _with_command(path: Path, error: str) -> str:
    """What is wrong with a file; of a folder, how the files in it are fitted."""
    if not path.is_dir() or not any(path.glob("*.binary")):
        return error
    return f"{path}: is a folder; name its files: merlfit fit {shlex.quote(str(path))}/*.binary"


def _kept(unit: Unit, ended: Ended) -> str:
    """What there is of a fit that was stopped."""
    if ended.said:
        return ended.said
    found = completeness(unit.target)
    if found == Completeness.NOTHING:
        return f"{unit.name} was not fitted"
    more = "continues it" if found == Completeness.CHAIN else "samples it"
    return f"{unit.target} holds {found.words}; `merlfit sample {unit.target}` {more}"


def summarise(outcomes: list[Outcome]) -> None:
    """Table of all fits; exits with 2 after bad input, with 1 after a fit that failed."""
    console.print(summary_table(outcomes))
    for o in outcomes:
        if o.result is not None and not o.result.fit.succeeded:
            console.print(f"{o.path.stem}: {o.result.fit.message}")
        for caution in o.result.fit.cautions if o.result is not None else ():
            console.print(f"{o.path.stem}: {caution}")
    if any(o.bad_input for o in outcomes):
        raise typer.Exit(BAD_INPUT)
    if any(o.result is None or not o.result.fit.succeeded for o in outcomes):
        raise typer.Exit(FAILED_FIT)
