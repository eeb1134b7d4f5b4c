"""How many worker processes this machine has room for, and their end with the process that began them."""

import os
import threading
from multiprocessing import parent_process
from multiprocessing.connection import wait

import psutil

from .threads import CORES

NEED = 3 * 2**30  # bytes of a worker, its programs compiled anew


def jobs_for(units: int, asked: int | None = None) -> int:
    """Worker processes for so many units: as many as asked for, or as cores and free memory allow."""
    room = max(1, int(psutil.virtual_memory().available // NEED))
    return max(1, min(units, CORES, room if asked is None else asked))


def end_with_parent() -> None:
    """This process ends with the one that began it, however that ends."""

    def end(sentinel: int) -> None:
        wait([sentinel])
        os._exit(1)

    if (parent := parent_process()) is not None:
        threading.Thread(target=end, args=(parent.sentinel,), daemon=True).start()
