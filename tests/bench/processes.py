"""Seconds and memory of processes, watched from outside: the largest resident set that Linux notes for each."""

import json
import os
import re
import resource
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

import psutil

MERLFIT = str(Path(sys.executable).with_name("merlfit"))
ROOT = Path(__file__).parents[2]
PERIOD = 0.02  # seconds between two looks: a peak within so much of a process's end may be missed


@dataclass(frozen=True)
class Watched:
    """Processes that ran side by side.

    Attributes:
        seconds: from the start of the first to the end of the last. peaks_mib: largest resident set of each, or of one
        that it started. sums_mib: largest sum over each and all that it started, at one moment.
        outputs: what each printed. cpu: seconds of processors of all together, user and system.
    """

    seconds: float
    peaks_mib: list[float]
    sums_mib: list[float]
    outputs: list[str]
    cpu: float


def watch(*commands, codes=(0,), blas=1):
    """Run commands side by side.

    Args:
        codes: exit codes that are no failure. blas: threads of BLAS; 1 as the command `merlfit` sets it for itself.

    Raises:
        RuntimeError: a command failed; the message ends with what it said.
    """
    peaks, sums = [0.0] * len(commands), [0.0] * len(commands)
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": str(blas)}
    with ExitStack() as files:
        said = [files.enter_context(TemporaryFile("w+")) for _ in commands]  # a pipe would fill
        start, before = time.monotonic(), _spent()
        running = [
            subprocess.Popen(c, cwd=ROOT, stdout=file, env=environment) for c, file in zip(commands, said, strict=True)
        ]
        while any(process.poll() is None for process in running):
            for k, process in enumerate(running):
                with suppress(psutil.NoSuchProcess):
                    all_of = [process.pid, *(p.pid for p in psutil.Process(process.pid).children(recursive=True))]
                    peaks[k] = max(peaks[k], *map(resident_peak, all_of))
                    sums[k] = max(sums[k], sum(resident(pid) for pid in all_of))
            time.sleep(PERIOD)
        seconds = time.monotonic() - start
        outputs = [read_back(file) for file in said]
    for command, process, output in zip(commands, running, outputs, strict=True):
        if process.returncode not in codes:
            raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}: {output[-2000:]}")
    return Watched(seconds, peaks, sums, outputs, _spent() - before)


def _spent():
    """Seconds of processors of all processes that have ended and were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read_back(file):
    """All that was written to an open file."""
    file.seek(0)
    return file.read()


def resident_peak(pid="self"):
    """Largest resident set of a process so far (MiB); 0 of one that has ended."""
    return _status(pid, "VmHWM")


def resident(pid="self"):
    """Resident set of a process now (MiB); 0 of one that has ended."""
    return _status(pid, "VmRSS")


def _status(pid, key):
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    found = re.search(rf"{key}:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


def measuring(section, *arguments):
    """The command of ``measure(*arguments)`` of a section in a process of its own."""
    return [sys.executable, "-m", "tests.bench.worker", section, *map(str, arguments)]


def worker(section, *arguments, blas=1):
    """What `measuring` returns, and the peak of its process (MiB)."""
    done = watch(measuring(section, *arguments), blas=blas)
    return json.loads(done.outputs[0].splitlines()[-1]), done.peaks_mib[0]
