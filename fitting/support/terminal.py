"""What the commands say: tables and errors, what is being done and for how long, and how they are stopped."""

import io
import os
import signal
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import typer
from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text
from typer.core import TyperGroup

from ...merl_io.atomic import WriteError
from ...merl_io.source import PLAIN, MerlError, shortened
from .clock import Stage

BAD_INPUT, FAILED_FIT = 2, 1  # exit codes
BAR = 6  # columns of a progress bar: beside it there is room for the longest name of MERL
WORDS = 34  # columns that are left to running text in a table before it gets a table of its own
NAMES = 0.75  # of the console at the most are names of rows that stay whole; longer ones are folded
CLOSE = (0, 1, 0, 0)  # padding of a table that is drawn closer
INDENT = "  "  # of the further lines of a message: no name in it can look like another one
STOPS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Stopped(BaseException):
    """Somebody stopped the program: by Ctrl-C, or by SIGTERM as job schedulers do.

    No ``KeyboardInterrupt``, which libraries answer in ways of their own.

    Attributes:
        code: what to exit with, 128 and the signal's number, as shells expect it.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(STOPS[signal.Signals(number)])
        self.code = 128 + number


@contextmanager
def stoppable() -> Iterator[None]:
    """Ctrl-C and SIGTERM raise :class:`Stopped` in here; a second one ends the program on the spot."""

    def stop(number: int, frame: FrameType | None) -> None:
        for each in STOPS:
            signal.signal(each, signal.SIG_DFL)
        stopped.append(Stopped(number))
        raise stopped[0]

    stopped: list[Stopped] = []
    before = {each: signal.getsignal(each) for each in STOPS}
    heard = [each for each, handler in before.items() if handler != signal.SIG_IGN]  # nohup and the like stay deaf
    for each in heard:
        signal.signal(each, stop)
    try:
        yield
    except Exception:
        if stopped:  # what a library made of it while it was imported
            raise stopped[0] from None
        raise
    finally:
        for each in heard:
            signal.signal(each, before[each])


class Screen(Console):
    """A console without markup, to which all fits, which no text can steer and no reader can stop from working.

    On a terminal lines of text end between words, which stay whole, that they can be copied; elsewhere a line stays a
    line. Tables that are too wide are drawn closer, and divided if need be. Nothing is cut off.

    Names of files, messages and keys of JSON come from anywhere: their escape sequences are shown, not obeyed, and
    ``:name:`` is no picture. A pipe that was closed (``| head``) or a full disk ends what is printed, not what is
    computed.

    Attributes:
        lost: why nothing more is printed, if so.
    """

    lost: OSError | None = None

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - rich's own options, handed on
        super().__init__(markup=False, emoji=False, soft_wrap=True, **options)

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401 - rich's own options, handed on
        """As rich does, harmless before it is measured for a column."""
        return super().render_str(text.translate(PLAIN), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """As rich does, and whatever came as a text of its own is harmless, too."""
        for each in super().render(renderable, options):
            yield each if each.control else Segment(each.text.translate(PLAIN), each.style)

    def print(self, *objects: object, **options: object) -> None:
        """As rich prints, but so that it fits."""
        parts = [part for each in objects for part in self._fitting(each)]
        with self._unbroken():
            super().print(*parts, **options)  # pyright: ignore[reportArgumentType] - rich's own options, handed on

    def _fitting(self, shown: object) -> list[object]:
        if isinstance(shown, Table):
            title, caption = (
                [Text(wrapped(each, self.width), style)] if isinstance(each, str) else []
                for each, style in ((shown.title, "table.title"), (shown.caption, "table.caption"))
            )
            return [*title, *_divided(shown, self), *caption]
        if isinstance(shown, str) and (self.is_terminal or self.is_jupyter):
            return [wrapped(shown, self.width)]
        return [shown]

    def flush(self) -> None:
        """Now, while a failure can still be told, and not when the interpreter ends."""
        with self._unbroken():
            self.file.flush()

    def on_broken_pipe(self) -> None:
        """Rich would end the program."""
        self._lose(BrokenPipeError())

    @contextmanager
    def _unbroken(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        self.lost, self.quiet = error, True
        with suppress(OSError, ValueError):  # what is still buffered goes nowhere, and exit does not stumble over it
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())
        if not self.stderr and not isinstance(error, BrokenPipeError):
            fail(f"standard output cannot be written ({error.strerror or error}); files are written all the same")


def wrapped(text: str, width: int, indent: str = "") -> str:
    """Lines that end between words, all but the first with an indent; a word that is longer stays whole."""
    return "\n".join(
        textwrap.fill(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False,
            replace_whitespace=False,
        )
        for line in text.translate(PLAIN).split("\n")
    )  # fmt: skip


def _divided(table: Table, console: Console) -> list[Table]:
    """The same table, or several that begin with its first column, none of which is wider than the console."""

    def part(columns: Sequence[int], closer: bool = True) -> Table:
        made = copy(table)
        made.columns = [replace(table.columns[k], _index=i, overflow="fold") for i, k in enumerate(columns)]
        made.box, made.title, made.caption = box.SIMPLE_HEAD, None, None
        if closer:
            made.padding = CLOSE
        return made

    def width(columns: Sequence[int], closer: bool = True) -> int:
        return Measurement.get(console, console.options.update(width=10_000), part(columns, closer)).maximum

    def needed(columns: Sequence[int], closer: bool = True) -> int:
        """Width with running text wrapped, and with names folded if they are too long."""
        least = {0: width([0]) if whole else console.width // 2}
        return width(columns, closer) - sum(max(width([k]) - least.get(k, WORDS), 0) for k in columns)

    whole, every = width([0]) <= NAMES * console.width, range(len(table.columns))
    closer = needed(every, closer=False) > console.width
    parts = [[0]]
    for k in every[1:]:
        if needed([*parts[-1], k], closer) > console.width and len(parts[-1]) > 1:
            parts.append([0])
        parts[-1].append(k)
    found = [part(columns, closer) for columns in parts]
    for each in found:
        each.columns[0].no_wrap = whole
    return found


console = Screen()
if not console.is_terminal:
    console = Screen(width=140)  # tables in logs and pipes are not squeezed to 80 columns
errors = Screen(stderr=True, force_jupyter=False)  # in a notebook, too, it is no output of a cell
_shown: list[Progress] = []  # the display that is on the terminal now


class Commands(TyperGroup):
    """The commands; an error that says what to mend ends one with a line, those of typer are said as by `Screen`."""

    def make_context(self, *words: Any, **named: Any) -> Any:  # noqa: ANN401, D102 - as typer's
        with _errors_said():
            return super().make_context(*words, **named)

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401, D102 - as typer's
        with _errors_said():
            return super().invoke(ctx)


@contextmanager
def _errors_said() -> Iterator[None]:
    try:
        yield
    except (MerlError, WriteError) as error:
        raise fail(str(error)) from None
    except Exception as error:
        if isinstance(message := getattr(error, "message", None), str):
            with suppress(AttributeError):  # of another library, which does not let it be set
                error.message = message.translate(PLAIN)  # pyright: ignore[reportAttributeAccessIssue] - it has one
        raise


def fail(message: str) -> typer.Exit:
    """Print one line; what to raise unless others go on."""
    note(message, style="red")
    return typer.Exit(BAD_INPUT)


def why_ended(path: Path, error: BaseException, said: str | None = None) -> str:
    """One line on what ends the work on this file and on no other: with its name, if nobody foresaw it.

    Args:
        said: what the error says, if not in its own words.
    """
    if isinstance(error, MerlError | WriteError):
        return str(error)
    return f"{path}: failed unexpectedly: {type(error).__name__}: {error if said is None else said}"


def note(message: str, style: str | None = None) -> None:
    """Print one line where errors go, clear of the progress display."""
    for progress in _shown:
        progress.stop()
    line = shortened(" ".join(message.split("\n")))  # a name cannot add a line of its own
    line = wrapped(f"merlfit: {line}", errors.width, INDENT) if errors.is_terminal else f"merlfit: {line}"
    errors.print(line, style=style, highlight=False)
    for progress in _shown:
        progress.start()


class Left(TimeRemainingColumn):
    """Time that is left, with a word that says so; how long it has been while nobody knows."""

    def render(self, task: Task) -> Text:  # noqa: D102
        known = task.total is not None and task.time_remaining is not None
        return Text.assemble(super().render(task), " left") if known else TimeElapsedColumn().render(task)


@contextmanager
def progress_display() -> Iterator[Progress]:
    """What is being done, how much of it is done, for how long it has been and how long it will still be."""
    words, time = Column(ratio=1, no_wrap=True, overflow="ellipsis"), Column(width=len("00:00 left"))
    progress = Progress(
        SpinnerColumn(), TextColumn("{task.description}", markup=False, table_column=words),
        BarColumn(BAR, table_column=Column(width=BAR)), Left(compact=True, table_column=time),
        console=console, transient=True, expand=True, disable=not console.is_terminal,
    )  # fmt: skip
    _shown.append(progress)
    try:
        with progress:
            yield progress
    finally:
        _shown.remove(progress)


def writable_folder(out: Path) -> None:
    """Make the folder now: an hour of fits is not to end with nowhere to go."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise fail(f"{out}: results cannot be written there ({error.strerror or error})") from None


def reporter(progress: Progress, task: TaskID, label: str) -> Callable[[str], None]:
    """Stages to the progress display on a terminal, to plain lines elsewhere (a new stage, not every step)."""
    last, before = [""], [0.0]
    (own,) = (each for each in progress.tasks if each.id == task)

    def report(stage: str) -> None:
        share = stage.share if isinstance(stage, Stage) else None
        if share is None or share < before[0]:  # another thing is done now, or the same anew
            progress.reset(task)
            own.total = None  # which rich takes for "as it is" if it is told so
        before[0] = share or 0.0
        progress.update(task, description=f"{label}: {stage}", total=share and 1.0, completed=before[0])
        if not console.is_terminal and stage.split(":")[0] != last[0]:
            last[0] = stage.split(":")[0]
            console.print(f"{label}: {stage}")

    return report


@contextmanager
def reporting(name: str, label: str) -> Iterator[Callable[[str], None]]:
    """A progress display of one piece of work; yields what its stages are told to."""
    with progress_display() as progress:
        yield reporter(progress, progress.add_task(name, total=None), label)


def run(app: Callable[[], None]) -> None:
    """Run the command line; what it prints can always be encoded, and whoever stops it is told so in one line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files that are no UTF-8
    try:
        with stoppable():
            app()
    except Stopped as stop:
        note(f"stopped by {stop}; files that were written before are whole")
        sys.exit(stop.code)
    except SystemExit as end:
        console.flush()
        unsaid = console.lost is not None and not isinstance(console.lost, BrokenPipeError)
        sys.exit(end.code or (FAILED_FIT if unsaid else 0))
