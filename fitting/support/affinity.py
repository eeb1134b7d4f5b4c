"""Which cores this process may use. Nothing is imported here: libraries count cores when they are imported."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress


def cores_of() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


@contextmanager
def begun_on(cores: Sequence[int]) -> Iterator[None]:
    """Threads and processes that are started in here begin on these cores, and count no others."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def spread(cores: Sequence[int]) -> None:
    """Let this process's threads, as many as it began with cores, run on all of these."""
    if not hasattr(os, "sched_setaffinity"):
        return
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setaffinity(int(thread), cores)
