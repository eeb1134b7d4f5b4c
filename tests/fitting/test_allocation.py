"""Freed memory: Dask's workers keep it, threads share arenas for it; programs are forgotten in good time."""

import platform
import subprocess
import sys

import jax
import numpy as np
import pytest
from merlfit.fitting.support import allocation, compilation

PAGES = 250  # of 4 KiB, in an array
PROGRAM = f"""
import resource, sys
from merlfit.fitting.support.allocation import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
import numpy as np
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
np.ones({PAGES} * 512)
before = faults()
for _ in range(10):
    np.ones({PAGES} * 512)
print(faults() - before)
"""


ARENAS = """
import ctypes, sys, threading
from merlfit.fitting.support.allocation import few_arenas
few_arenas(int(sys.argv[1]))
libc, all_have = ctypes.CDLL(None), threading.Barrier(8)
libc.malloc.restype = ctypes.c_void_p
def work():
    libc.malloc(1000)
    all_have.wait()
threads = [threading.Thread(target=work) for _ in range(8)]
for each in threads:
    each.start()
for each in threads:
    each.join()
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w"))
libc.malloc_info(0, file)
libc.fflush(file)
"""
glibc = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="what glibc does")


@glibc
@pytest.mark.parametrize("cores", [2, 5])
def test_threads_share_as_many_arenas_as_there_are_cores(cores):
    done = subprocess.run([sys.executable, "-c", ARENAS, str(cores)], capture_output=True, text=True, check=True)
    assert done.stdout.count("<heap nr=") == cores


@glibc
def test_a_number_of_arenas_that_was_set_is_kept():
    environment = {"MALLOC_ARENA_MAX": "3"}
    done = subprocess.run(
        [sys.executable, "-c", ARENAS, "2"], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.count("<heap nr=") == 3


def test_a_system_without_glibc_goes_on(monkeypatch):
    asked = []

    def nameless(name):
        asked.append(name)
        raise TypeError("argument of type 'NoneType' is not iterable")  # as on Windows

    monkeypatch.setattr(allocation.ctypes, "CDLL", nameless)
    monkeypatch.delenv("MALLOC_ARENA_MAX", raising=False)
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    allocation.few_arenas(2)
    allocation.keep_freed_memory()
    allocation.give_freed_memory_back()
    assert asked == [None, None, None], "each has tried, and has gone on"


@glibc
def test_arrays_of_a_dask_worker_come_from_pages_that_it_has():
    def faults(how):
        environment = {"MALLOC_TRIM_THRESHOLD_": "65536"}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, how], env=environment, capture_output=True, text=True, check=True
        )
        return int(done.stdout)

    given_back = faults("given back")
    assert given_back > 9 * PAGES
    assert faults("kept") < given_back / 4


def test_programs_are_forgotten_where_memory_is_short(monkeypatch):
    doubled = jax.jit(lambda x: 2 * x)
    doubled(np.ones(3))
    monkeypatch.setattr(compilation, "MAPPINGS", 10**9)
    monkeypatch.setattr(compilation, "NEED", 0)
    compilation.make_room()
    assert doubled._cache_size() == 1
    monkeypatch.setattr(compilation, "NEED", 2**60)
    compilation.make_room()
    assert doubled._cache_size() == 0
    assert doubled(np.ones(3))[0] == 2
