"""Runs of the program in folders of their own, and what they leave behind."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
from merlfit.fitting.results.manifest import lines
from merlfit.fitting.results.storage import ResultError, read_result
from merlfit.merl_io.archive import arrays
from merlfit.merl_io.atomic import UNFINISHED
from merlfit.merl_io.source import opened

STAND_IN = [sys.executable, str(Path(__file__).with_name("stand_in.py"))]
MERLFIT = [sys.executable, "-m", "merlfit"]
PATIENCE = 30.0  # seconds, for processes to end
FINISHED = ("fitted", "kept")


def start(command, *arguments, **environment):
    """A process with its own session, by which all of its workers are known."""
    return subprocess.Popen(
        [*command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, env={**os.environ, **environment},
    )  # fmt: skip


def ran(command, *arguments, **environment):
    """Exit code and what was said on standard error, of a run to the end."""
    running = start(command, *arguments, **environment)
    _, said = running.communicate(timeout=900)
    return running.returncode, said


def of_session(number):
    """The processes of a session that still run."""
    found = []
    for process in psutil.process_iter():
        with suppress(OSError, psutil.Error):
            if os.getsid(process.pid) == number and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def kill(running, rng, kinds):
    """kill -9: of the program, of a worker of its, or of all; the kind, or None if it had ended."""
    kind = rng.choice(kinds)
    workers = [p for p in of_session(running.pid) if p.pid != running.pid]
    if running.poll() is not None:
        return None
    if kind == "a worker":
        with suppress(psutil.Error):
            rng.choice(workers).kill() if workers else running.kill()
    elif kind == "all its processes":
        os.killpg(running.pid, signal.SIGKILL)
    else:
        running.kill()
    return kind if kind != "a worker" or workers else "the program"


def gone(number):
    """Whether all processes of a session end by themselves."""
    end = time.monotonic() + PATIENCE
    while of_session(number):
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def values(path):
    """What a result says, without when and how long."""
    held = read_result(path).model_dump()
    for key in ("run", "seconds"):
        held.pop(key)
    return held


def results(folder):
    """Of each result in a folder, its values; what is torn raises."""
    return {path.stem: values(path) for path in sorted(folder.glob("*.json"))}


def faults_of(folder, undisturbed):
    """What is wrong in a folder, after whatever happened to it: torn files, lost results, other values."""
    wrong, found = [], {}
    for path in folder.glob("*.json"):
        try:
            found[path.stem] = values(path)
        except ResultError as error:
            wrong.append(f"torn: {error}")
    for path in folder.glob("*.npz"):
        try:
            with opened(path) as (file, _):
                arrays(file, lambda _: True, texts=("names", "coordinates"))
        except ValueError as error:
            wrong.append(f"torn: {path.name}: {error}")
    for line in lines(folder):
        if line.event == "file" and line.ended in FINISHED and found.get(line.material) is None:
            wrong.append(f"lost: {line.material}")
    for name, held in found.items():
        if held["posterior"] is not None and held != undisturbed.get(name):
            wrong.append(f"other values: {name}")
    return wrong


def faults_at_end(folder, undisturbed):
    """As `faults_of`, of a folder where all should be done."""
    wrong = faults_of(folder, undisturbed)
    wrong += [f"not there: {name}" for name in undisturbed if not (folder / f"{name}.json").is_file()]
    wrong += [f"left: {path.name}" for path in folder.glob(f"{UNFINISHED}*")]
    if not wrong and results(folder) != undisturbed:
        wrong.append("other values at the end")
    return wrong
