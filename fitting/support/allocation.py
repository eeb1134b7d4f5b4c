"""Who gets memory that was freed: what needs some next, or the system. Nothing heavy is imported here."""

import ctypes
import os
from contextlib import suppress

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8  # of glibc's mallopt
ELSEWHERE = OSError, AttributeError, TypeError  # where C's library is another one, or, on Windows, has to be named
LARGEST = 32 * 2**20  # bytes: up to here glibc lets a threshold grow by itself in a process that nobody told anything


def keep_freed_memory() -> None:
    """Let glibc keep arrays that are freed, as it does by default, whatever MALLOC_TRIM_THRESHOLD_ says.

    Dask sets it for its workers so that each array goes back to the system at once. Fits free and take the same arrays
    again and again, and every new page is a fault, after which the system fills it with zeros. Elsewhere than in glibc
    nothing is done.
    """
    with suppress(*ELSEWHERE):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(MMAP_THRESHOLD, LARGEST)
        mallopt(TRIM_THRESHOLD, 2 * LARGEST)


def few_arenas(cores: int) -> None:
    """Let the threads to come share as many arenas of glibc's as there are cores, of which it would make eight each.

    What a thread frees goes to its own arena, where no other thread finds it: of the peak of a fit of one MERL file,
    1.8 GiB, it was 0.4. Whoever has set a number in the environment keeps that.
    """
    if "MALLOC_ARENA_MAX" in os.environ or "malloc.arena_max" in os.environ.get("GLIBC_TUNABLES", ""):
        return
    with suppress(*ELSEWHERE):
        ctypes.CDLL(None).mallopt(ARENA_MAX, cores)


def give_freed_memory_back() -> None:
    """Let glibc give to the system what it keeps of freed arrays and programs; elsewhere nothing is done."""
    with suppress(*ELSEWHERE):
        ctypes.CDLL(None).malloc_trim(0)
