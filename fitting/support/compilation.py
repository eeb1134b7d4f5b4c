"""Where compiled programs are kept between runs."""

import gc
import glob
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Lock, get_ident
from typing import TextIO

import jax
import platformdirs
import psutil

from .affinity import begun_on, spread
from .allocation import few_arenas, give_freed_memory_back
from .clock import Report, Stage
from .processes import NEED
from .terminal import note

NEW = "/jax/compilation_cache/cache_misses"  # JAX's event when it has compiled a program that is kept
READY = "/jax/core/compile/backend_compile_duration"  # and after that, or when it has loaded one
SLOW = 2.0  # seconds of compiling that are worth a word
FIRST_FIT, FIRST_RIVAL = 130, 90  # programs of a first fit of a MERL file, about: of the two-scale model, of others
UNKEPT = re.compile("Error writing persistent compilation cache entry for ")  # JAX's warnings
DAMAGED = re.compile("Error reading persistent compilation cache entry for '([^']+)'")


def cache_folder() -> Path:
    """The user's cache folder, or ``MERLFIT_CACHE_DIR``."""
    return Path(os.environ.get("MERLFIT_CACHE_DIR") or platformdirs.user_cache_dir("merlfit"))


def use_persistent_cache(say: Callable[[str], None] = note) -> Path:
    """Keep compiled programs in the cache folder: only the first run waits, and is told so by ``say``.

    Damaged entries are deleted, that they may be compiled anew.
    """
    folder = cache_folder() / "xla"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home, or one that cannot be written
        _tell_unkept(folder, say)
        return folder
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # hundreds of small ones take 15 s together
    _tell_of_compilation(folder, say)
    _mend(folder, say)
    return folder


def begin_libraries(first: Sequence[int], cores: Sequence[int], say: Callable[[str], None]) -> None:
    """Once a process: libraries with a thread for each of the first cores, which then run on all of these."""
    few_arenas(len(cores))
    with begun_on(first):
        jax.devices()  # makes its threads
    spread(cores)
    use_persistent_cache(say)


def use_cache() -> None:
    """The same from a program of somebody's own, unless it has set a cache of its own."""
    if not jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue] - made when it runs
        use_persistent_cache()


class Programs:
    """Programs of this process.

    Attributes:
        ready: how many there are, compiled or loaded. seconds: it took to compile those that were not kept.
        hear: are called with how many are ready, when one was compiled and that takes long.
    """

    def __init__(self) -> None:
        self.ready, self.seconds = 0, 0.0
        self.hear: list[Callable[[int], None]] = []
        self._new: set[int] = set()  # threads that have compiled one

    def event(self, event: str, **_: str | int) -> None:
        """Hear of an event of JAX's."""
        if event == NEW:
            self._new.add(get_ident())

    def duration(self, event: str, duration_secs: float, **_: str | int) -> None:
        """Hear of a duration that JAX has measured."""
        if event != READY:
            return
        self.ready += 1
        if get_ident() not in self._new:
            return
        self._new.remove(get_ident())
        self.seconds += duration_secs
        if self.seconds > SLOW:
            for hear in [*self.hear]:
                hear(self.ready)


_programs = Programs()


def programs_ready() -> int:
    """Programs that were compiled or loaded in this process since this was first asked."""
    _listen()
    return _programs.ready


@contextmanager
def programs_told(report: Report, of: int | None = None) -> Iterator[Report]:
    """The same reports, and while programs are compiled how many are ready.

    Args:
        of: how many there will be, about, if that is known.
    """
    last, one = [Stage("")], Lock()  # several threads compile

    def reported(stage: str) -> None:
        last[0] = stage if isinstance(stage, Stage) else Stage(stage)
        with one:
            report(stage)

    def hear(ready: int) -> None:
        count, share = str(ready), last[0].share
        if of is not None and ready <= of:
            count, share = f"{ready} of about {of}", ready / of
        with one:
            report(Stage(f"{last[0].split(':')[0]}: {count} programs compiled", share))

    _programs.hear.append(hear)
    try:
        yield reported
    finally:
        _programs.hear.remove(hear)


@cache
def _tell_of_compilation(folder: Path, say: Callable[[str], None]) -> None:
    """Once a process, and only if there is much to compile."""

    def hear(_: int) -> None:
        _programs.hear.remove(hear)
        say(f"compiling, once: this can take some minutes; later runs reuse the programs in {folder}")

    _programs.hear.append(hear)
    _listen()


@cache
def _listen() -> None:
    jax.monitoring.register_event_listener(_programs.event)
    jax.monitoring.register_event_duration_secs_listener(_programs.duration)


@cache
def _mend(folder: Path, say: Callable[[str], None]) -> None:
    """Answer JAX's warnings: of a damaged entry, which it would leave as it is, and of one that it cannot write."""
    show, told = warnings.showwarning, []

    def shown(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
        line: str | None = None,
    ) -> None:  # fmt: skip
        if UNKEPT.match(str(message)):
            _tell_unkept(folder, say)
            return
        if not (found := DAMAGED.match(str(message))):
            show(message, category, filename, lineno, file, line)
            return
        with suppress(OSError):  # a folder that cannot be written, of which the other warning is
            for entry in folder.glob(f"{glob.escape(found[1])}-*-cache"):
                entry.unlink()
                if not told:
                    told.append(True)
                    say(f"damaged programs in {folder} were deleted and are compiled again, once")

    warnings.showwarning = shown


@cache
def _tell_unkept(folder: Path, say: Callable[[str], None]) -> None:
    say(
        f"compiled programs cannot be kept in {folder}, and every run compiles them again: "
        "name a folder that can be written in MERLFIT_CACHE_DIR"
    )


MAPPINGS = 30_000  # of memory, of the 65 530 that Linux allows a process; a compiled program takes up to some hundreds
forgetting: list[Callable[[], None]] = []  # by whom else programs are held


def make_room() -> None:
    """Forget compiled programs where LLVM would soon find no mappings for more, or the machine's memory is short.

    They come back from the cache on disk, in some seconds.
    """
    try:
        with open("/proc/self/maps", "rb") as file:
            many = sum(1 for _ in file) > MAPPINGS
    except OSError:
        many = False
    if many or psutil.virtual_memory().available < NEED:
        forget_programs()
        gc.collect()
        give_freed_memory_back()


def forget_programs() -> None:
    """Forget what is compiled in this process."""
    for forget in forgetting:
        forget()
    jax.clear_caches()
