"""A real Dask scheduler and workers, processes of this machine, for tests."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import psutil
from merlfit.fitting.execution.unit import Unit
from merlfit.fitting.settings.config import Config

TESTS = Path(__file__).parent
START = 60.0  # seconds, at the most, until something that was started is there


def until(held, what, patience=START):
    """Wait for it."""
    end = time.monotonic() + patience
    while not (found := held()):
        assert time.monotonic() < end, what
        time.sleep(0.05)
    return found


@contextmanager
def program(*words, folder, **environment):
    """A process of Dask's, in a folder of its own; with all that it started it ends, stopped or not."""
    folder.mkdir()
    with open(folder / "said", "wb") as said:
        running = subprocess.Popen(
            [sys.executable, "-m", "dask", *map(str, words)], cwd=folder, stdout=said, stderr=said,
            env=os.environ | {"PYTHONPATH": str(TESTS), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
            | environment,
        )  # fmt: skip
        try:
            yield running
        finally:
            for process in [running, *children(running.pid)]:
                process.send_signal(signal.SIGCONT)
            running.terminate()
            try:
                running.wait(START)
            except subprocess.TimeoutExpired:
                running.kill()


def children(pid):
    """Processes that this one started, and those which these started; those that are left."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


@contextmanager
def scheduler(folder, port=0, **environment):
    """A scheduler: its process, and its address for ``--executor``."""
    told = folder / f"scheduler-{time.monotonic_ns()}.json"
    words = ("scheduler", "--port", port, "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", told)
    with program(*words, folder=folder / told.stem, **environment) as running:
        address = json.loads(until(lambda: told.exists() and told.read_text(), "no scheduler"))["address"]
        yield running, address.replace("tcp://", "dask://")


@contextmanager
def workers(where, folder, count=1, more=(), threads=1, **environment):
    """So many of them, each begun anew when it is lost."""
    address = where.replace("dask", "tcp")
    words = ("worker", address, "--nworkers", count, "--nthreads", threads, "--no-dashboard", *more)
    with program(
        *words, "--local-directory", folder / "scratch", folder=folder / "worker", **environment
    ) as running:  # fmt: skip
        yield running


def units(out, *names):
    """Of files that are there."""
    out.mkdir(exist_ok=True)
    found = []
    for name in names:
        path = out.parent / f"{name}.binary"
        path.write_bytes(name.encode())
        found.append(Unit(path, out, Config()))
    return found


def ended(cluster, found):
    """How each of these ended, and what was told of them."""
    told = []
    return dict(cluster.ended(found, lambda k, stage: told.append((k, str(stage))))), told
