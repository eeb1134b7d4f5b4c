"""Work on all cores: NumPy and XLA let go of Python's lock while they compute, and a call of either uses one core."""

import platform
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TypeVar

from threadpoolctl import threadpool_limits

from .affinity import cores_of

S = TypeVar("S")
T = TypeVar("T")
CORES = len(cores_of())
SHARES = 8  # that work is divided into at the most: what a sum comes to does not depend on the number of cores
# Ours are the threads: those that BLAS adds of its own wait for each other busily, on busy cores for seconds a product.
one_core_a_call = threadpool_limits.wrap(limits=1, user_api="blas")


@cache
def _pool() -> ThreadPoolExecutor:
    """Made when it is first needed: who imports this gets no threads."""
    return ThreadPoolExecutor(CORES, "merlfit")


def machine() -> str:
    """Cores that may be used, and of what."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    return f"{CORES} cores, {model}"


def side_by_side(compute: Callable[[S], T], parts: Iterable[S]) -> list[T]:
    """Results for all parts, every part in a thread of its own. ``compute`` must not come here again."""
    every = list(parts)
    return [compute(every[0])] if len(every) == 1 else list(_pool().map(compute, every))
