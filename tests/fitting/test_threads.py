"""The threads are made when there is work for them, and are as many as cores."""

import subprocess
import sys
import threading

from merlfit.fitting.support import threads


def test_nobody_gets_threads_by_an_import():
    said = "from merlfit.fitting.support import threads; print(threads._pool.cache_info().currsize)"
    found = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "0"


def test_parts_are_worked_on_side_by_side():
    names = set(threads.side_by_side(lambda _: threading.current_thread().name, range(8)))
    assert names <= {f"merlfit_{k}" for k in range(threads.CORES)}
    assert threads.side_by_side(lambda _: threading.current_thread().name, [0]) == [threading.current_thread().name]
    assert threads._pool() is threads._pool()
