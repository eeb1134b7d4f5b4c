"""kill -9 at random moments, and what is there afterwards."""

import os
import random
import shutil
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.merl_io.binary import write
from merlfit.model.measured import Measured
from merlfit.model.reflectance import evaluate
from merlfit.model.two_scale import TwoScale

from .programs import MERLFIT, STAND_IN, faults_at_end, faults_of, gone, kill, ran, results, start

KINDS = ("the program", "a worker", "all its processes")
DIMS, NOISE = (30, 30, 60), 0.05
SURFACE = TwoScale("none", diffraction="off")
TRUTH = {
    "beta": 0.12, "p": 0.6, "n": np.array([1.9, 1.7, 1.6]), "k": np.array([3.5, 3.2, 2.4]), "grazing_exponent": 0.35
}  # fmt: skip
SETTINGS = ("--dims", "30x30x60", "--preset", "microfacet", "--index", "complex", "--body", "none")
A_ROUND = 5  # kills at the most, until a run is let come to its end
SLOWER = 1.3  # times what an undisturbed run took: until then a run is killed, for others may use the machine
STARTING = 2.0  # seconds that a program needs until it could write something, at the least


def killed(tried, what, command, longest, count, prepare, undisturbed, cached, kinds=KINDS):
    """Rounds of run, kill and run again until all is done, until there were ``count`` kills.

    Args:
        command: of the program, by folder and whether it goes on. longest: seconds of an undisturbed run.
        prepare: makes a folder to begin with. undisturbed: the values that have to be found.
    """
    rng = random.Random(what)
    came, wrong, rounds = Counter(), [], 0
    while sum(came.values()) < count:
        with tempfile.TemporaryDirectory() as place:
            folder, rounds = Path(place, "out"), rounds + 1
            prepare(folder)
            code, again, most = None, False, min(count, sum(came.values()) + A_ROUND)
            while code is None:
                running = start(*command(folder, again), MERLFIT_CACHE_DIR=str(cached))
                end, kind = time.monotonic() + SLOWER * longest, None
                while sum(came.values()) < most:
                    left = end - time.monotonic()
                    with suppress(TimeoutError):
                        _wait(running, STARTING + rng.uniform(0, max(left - STARTING, 0)))
                        break
                    kind = kill(running, rng, kinds)
                    if kind:
                        came[kind] += 1
                    if kind != "a worker":
                        break
                _, said = running.communicate()
                code = running.returncode if running.returncode >= 0 else None
                if code == 1 and "its process was killed" in said and ", twice\n" in said:  # given up, as it should be
                    code = None
                if not gone(running.pid):
                    wrong.append("processes that outlive the program")
                if code not in (0, None) or "Traceback" in said:
                    wrong.append(f"exit code {code}: {said}")
                again = True
                wrong += faults_of(folder, undisturbed)
            wrong += faults_at_end(folder, undisturbed)
            for error in wrong[len(wrong) - 5 :]:
                print(f"{what}, round {rounds}: {error}", flush=True)
    said = ", ".join(f"{times} of {kind}" for kind, times in sorted(came.items()))
    tried.add("kills", what, sum(came.values()),
              f"runs brought to their end: {rounds}; killed on the way: {said}; values as of an undisturbed run",
              len(wrong))  # fmt: skip


def _wait(running, seconds):
    """Return when the program ends, raise TimeoutError when the time is over; what it says does not hold it up."""
    end = time.monotonic() + seconds
    while running.poll() is None:
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.005)


def stand_ins(tried, folder, count):
    """Batches of many files with a stand-in for the fit."""
    files = []
    for n in range(24):
        files.append(folder / f"file-{n:02}.binary")
        files[-1].write_bytes(os.urandom(64))
    out = folder / "undisturbed"
    began = time.monotonic()
    code, said = ran(STAND_IN, "fit", *files, "-o", out, "-j", 2)
    longest = time.monotonic() - began
    assert code == 0, said
    command = lambda out, again: (STAND_IN, "fit", *files, "-o", out, "-j", 2, "--resume")  # noqa: E731
    killed(tried, "batches of 24 files, a stand-in for the fit", command, longest, count, Path.mkdir, results(out),
           folder / "cache")  # fmt: skip


def material(path, seed):
    """A small MERL-like file of a known conductor without diffraction, with noise: synthetic data."""
    truth = {**TRUTH, "beta": TRUTH["beta"] * (1 + seed / 4)}
    values = tabulate(lambda g: evaluate(Measured(SURFACE), truth, g), DIMS)
    noise = np.random.default_rng(seed).standard_normal(values.shape)
    write(path, values * np.exp(NOISE * noise), dims=DIMS)
    return path


def undisturbed(folder, command, finished):
    """Folder of a run without faults, and its seconds; the one before it compiles.

    Args:
        command: as of `killed`. finished: prepares a folder for it.
    """
    for name in ("compiles", "undisturbed"):
        finished(folder / name)
        began = time.monotonic()
        code, said = ran(*command(folder / name, again=False), MERLFIT_CACHE_DIR=str(cache(folder)))
        assert code == 0, said
    return folder / "undisturbed", time.monotonic() - began


def cache(folder):
    """Of compiled programs."""
    return Path(os.environ.get("MERLFIT_CACHE_DIR", folder / "cache"))


def batch(tried, folder, count):
    """A batch of fits with their posteriors, which begin anew when they are run again."""
    files = [material(folder / f"file-{n}.binary", n) for n in range(4)]
    command = lambda out, again: (MERLFIT, "fit", *files, "-o", out, *SETTINGS, "-j", 2, "--resume")  # noqa: E731
    out, longest = undisturbed(folder, command, Path.mkdir)
    killed(tried, "batches of 4 fits with posteriors, files of 30x30x60 bins", command, longest, count, Path.mkdir,
           results(out), cache(folder))  # fmt: skip


def posterior(tried, folder, count):
    """The sampling of a posterior, which goes on with the chain that is there."""
    file, fitted = material(folder / "file.binary", 0), folder / "fitted"
    code, said = ran(MERLFIT, "fit", file, "-o", fitted, *SETTINGS, "--no-posterior", MERLFIT_CACHE_DIR=cache(folder))
    assert code == 0, said
    command = lambda out, again: (MERLFIT, "sample", out / "file.json")  # noqa: E731
    prepare = lambda out: shutil.copytree(fitted, out)  # noqa: E731
    out, longest = undisturbed(folder, command, prepare)
    killed(tried, "`merlfit sample` of a fit, a file of 30x30x60 bins", command, longest, count, prepare, results(out),
           cache(folder), ("the program",))  # fmt: skip


TRIALS = {"posterior": posterior, "batch": batch, "stand_ins": stand_ins}


def run(tried, only, few=False, times=None):
    """Trials by name, all without one."""
    count = times or (4 if few else 50)
    for name in only or TRIALS:
        with tempfile.TemporaryDirectory() as place:
            TRIALS[name](tried, Path(place), count)
