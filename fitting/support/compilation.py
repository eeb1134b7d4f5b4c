"""Where compiled programs and tables are kept between runs."""

import glob
import os
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TextIO

import jax
import platformdirs

from . import tables
from .terminal import note

NEW = "/jax/compilation_cache/cache_misses"  # JAX's event when it has compiled a program that is kept
DAMAGED = re.compile("Error reading persistent compilation cache entry for '([^']+)'")


def cache_folder() -> Path:
    """The user's cache folder, or ``MERLFIT_CACHE_DIR``."""
    return Path(os.environ.get("MERLFIT_CACHE_DIR") or platformdirs.user_cache_dir("merlfit"))


def use_persistent_cache(say: Callable[[str], None] = note) -> Path:
    """Keep compiled programs in the cache folder: only the first run waits, and is told so by ``say``.

    So with the table of ``diffraction = "scaled"``, which is computed when it is first asked for. Damaged entries are
    deleted, that they may be compiled anew.
    """
    cache = cache_folder()
    folder = cache / "xla"
    tables.keep_in(cache)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # hundreds of small ones take 15 s together
    _tell_of_compilation(folder, say)
    _mend(folder, say)
    return folder


def use_cache() -> None:
    """The same from a program of somebody's own, unless it has set a cache of its own."""
    if not jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue] - made when it runs
        use_persistent_cache()


@cache
def _tell_of_compilation(folder: Path, say: Callable[[str], None]) -> None:
    """Once a process, and only if there is something to compile."""
    told = []

    def listen(event: str, **_: str | int) -> None:
        if event == NEW and not told:
            told.append(True)
            say(f"compiling, once: this can take some minutes; later runs reuse the programs in {folder}")

    jax.monitoring.register_event_listener(listen)


@cache
def _mend(folder: Path, say: Callable[[str], None]) -> None:
    """Answer JAX's warning of a damaged entry, which it would leave as it is and warn of in every run."""
    show, told = warnings.showwarning, []

    def shown(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
        line: str | None = None,
    ) -> None:  # fmt: skip
        if not (found := DAMAGED.match(str(message))):
            show(message, category, filename, lineno, file, line)
            return
        for entry in folder.glob(f"{glob.escape(found[1])}-*-cache"):
            entry.unlink(missing_ok=True)
        if not told:
            told.append(True)
            say(f"damaged programs in {folder} were deleted and are compiled again, once")

    warnings.showwarning = shown


MAPPINGS = 30_000  # of memory, of the 65 530 that Linux allows a process; a compiled program takes up to some hundreds


def make_room() -> None:
    """Forget compiled programs where they take so many mappings that LLVM would soon find no memory for more.

    They come back from the cache on disk. Where mappings cannot be counted, nothing is done.
    """
    try:
        with open("/proc/self/maps", "rb") as file:
            many = sum(1 for _ in file) > MAPPINGS
    except OSError:
        return
    if many:
        jax.clear_caches()
