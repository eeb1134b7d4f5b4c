"""kill -9 at random moments, and what is there afterwards."""

import os
import random
import shutil
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from .programs import MERLFIT, STAND_IN, faults_at_end, faults_of, gone, kill, ran, results, start

KINDS = ("the program", "a worker", "all its processes")
MATERIALS = ("nickel", "gray-plastic", "green-latex", "gold-paint")
STARTING = 2.0  # seconds that a program needs until it could write something, at the least


def killed(tried, what, command, longest, count, prepare, undisturbed, cached, kinds=KINDS):
    """Rounds of run, kill and run again until all is done, until there were ``count`` kills.

    Args:
        command: of the program, by folder and whether it goes on. longest: seconds until it is killed, at the most.
        prepare: makes a folder to begin with. undisturbed: the values that have to be found.
    """
    rng = random.Random(what)
    came, wrong, rounds = Counter(), [], 0
    while sum(came.values()) < count:
        with tempfile.TemporaryDirectory() as place:
            folder, rounds = Path(place, "out"), rounds + 1
            prepare(folder)
            code, again = None, False
            while code is None:
                running = start(*command(folder, again), MERLFIT_CACHE_DIR=str(cached))
                end, kind = time.monotonic() + longest, None
                while sum(came.values()) < count:
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
              f"{rounds} runs brought to their end, killed on the way: {said}; values as of an undisturbed run",
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


def batch(tried, folder, count):
    """A batch of fits."""
    files = [folder / f"{name}.binary" for name in MATERIALS]
    for name, path in zip(MATERIALS, files, strict=True):
        code, said = ran(MERLFIT, "synth", name, "-o", path)
        assert code == 0, said
    cached = Path(os.environ.get("MERLFIT_CACHE_DIR", folder / "cache"))
    arguments = ("--no-posterior", "-j", 2, "--resume")
    began = time.monotonic()
    for out in ("compiles", "undisturbed"):
        began = time.monotonic()
        code, said = ran(MERLFIT, "fit", *files, "-o", folder / out, *arguments, MERLFIT_CACHE_DIR=str(cached))
        assert code == 0, said
    longest = time.monotonic() - began
    command = lambda out, again: (MERLFIT, "fit", *files, "-o", out, *arguments)  # noqa: E731
    killed(tried, "batches of 4 fits", command, longest, count, Path.mkdir, results(folder / "undisturbed"), cached)


def posterior(tried, folder, count):
    """The sampling of a posterior, after `batch`."""
    fitted, name = folder / "undisturbed", MATERIALS[0]
    cached = Path(os.environ.get("MERLFIT_CACHE_DIR", folder / "cache"))

    def prepare(out):
        out.mkdir()
        shutil.copy(fitted / f"{name}.json", out)

    for out in ("compiles too", "sampled"):
        prepare(folder / out)
        began = time.monotonic()
        code, said = ran(MERLFIT, "sample", folder / out / f"{name}.json", MERLFIT_CACHE_DIR=str(cached))
        assert code == 0, said
    longest = time.monotonic() - began
    command = lambda out, again: (MERLFIT, "sample", out / f"{name}.json")  # noqa: E731
    killed(tried, "the sampling of a posterior", command, longest, count, prepare, results(folder / "sampled"), cached,
           ("the program",))  # fmt: skip


def run(tried, few=False, times=None):
    """All of them."""
    tried.begin("kills")
    count = times or (4 if few else 50)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        stand_ins(tried, folder, 2 * count)
        shutil.rmtree(folder / "undisturbed")
        batch(tried, folder, count)
        posterior(tried, folder, count)
