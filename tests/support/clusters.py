"""A real Dask scheduler and workers, processes of this machine, for tests."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
from merlfit.fitting.batch.unit import Unit
from merlfit.fitting.settings.config import Config

ROOT = Path(__file__).parents[2]
_PROGRAM = f"""
import signal, sys
sys.path.insert(0, {str(ROOT)!r})
signal.signal(signal.SIGINT, signal.default_int_handler)
from merlfit.fitting.commands import cli
from merlfit.fitting.batch import cluster
from tests.support.worker_tasks import task
made = cluster.Cluster.__init__
cluster.Cluster.__init__ = lambda self, where, jobs=None, task=task, note=print: made(self, where, jobs, task, note)
cli.main()
"""
PROGRAM = [sys.executable, "-c", _PROGRAM]  # merlfit, its fit that of worker_tasks.py
SBATCH = {
    "takes": 'echo "Submitted batch job 123"',
    "starts": """cp "$1" "$0.$$" && setsid sh "$0.$$" >> "$0.said" 2>&1 < /dev/null &
echo "Submitted batch job $!"
echo "$!" >> "$0.jobs"
""",
    "refuses": """echo "sbatch: error: Batch job submission failed: Invalid account" >&2
exit 1
""",
}
SCANCEL = """echo "$1" >> "$0.jobs"
kill -TERM -- "-$1"
"""
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
            env=os.environ | {"PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
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


@contextmanager
def slurm(folder, sbatch):
    """A stand-in for SLURM: ``sbatch`` of this text, ``scancel``; the environment in which they are found.

    Both write the numbers of jobs, which are processes of this machine, to files beside them, ``*.jobs``.
    """
    folder.mkdir()
    for name, text in (("sbatch", sbatch), ("scancel", SCANCEL)):
        (folder / name).write_text(f"#!/bin/sh\n{text}")
        (folder / name).chmod(0o755)
    settings = {
        "CORES": "1", "PROCESSES": "1", "MEMORY": "3GiB", "LOCAL_DIRECTORY": str(folder / "scratch"),
        "SCHEDULER_OPTIONS": '{"dashboard_address": ":0"}',
    }  # fmt: skip
    yield os.environ | {
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT),
        **{f"DASK_JOBQUEUE__SLURM__{name}": value for name, value in settings.items()},
    }  # fmt: skip
    for job in jobs(folder / "sbatch"):
        with suppress(ProcessLookupError):
            os.killpg(job, signal.SIGKILL)


def started(environment, out, *names, count=1):
    """A run on SLURM with a stand-in for the fit, going on."""
    command = [*PROGRAM, "fit", *(str(unit.path) for unit in units(out, *names)), "-o", str(out)]
    return subprocess.Popen(
        [*command, "--executor", "dask-slurm", "--jobs", str(count)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def jobs(program):
    """Numbers of jobs that a stand-in wrote down."""
    with suppress(FileNotFoundError):
        return [int(line) for line in Path(f"{program}.jobs").read_text().split()]
    return []


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
