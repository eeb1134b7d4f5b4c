"""Disks that are full, folders that cannot be written or go away, folders of two, and clocks that jump."""

import os
import random
import shutil
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

from .programs import STAND_IN, faults_at_end, faults_of, ran, results, start

FAKETIME = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
JUMPS = ("+1d", "-1d", "+30y", "-20y", "+1h", "-2s")


@contextmanager
def small_disk(place, kib):
    """A file system of so many KiB at ``place``."""
    place.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", place], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def remount(place, options):
    """Other options for a file system."""
    subprocess.run(["mount", "-o", f"remount,{options}", place], check=True)


class Bench:
    """Files, what an undisturbed batch of them gives, and batches that go wrong."""

    def __init__(self, tried, folder):
        self.tried, self.folder = tried, folder
        self.files = [folder / f"file-{n}.binary" for n in range(8)]
        for path in self.files:
            path.write_bytes(os.urandom(64))
        self.undisturbed = results(self.finished(folder / "undisturbed"))
        self.wrong = []

    def finished(self, out):
        """The folder of a batch that has to succeed."""
        code, said = ran(STAND_IN, *self.arguments(out))
        if code != 0 or "Traceback" in said:
            raise AssertionError(said)
        return out

    def arguments(self, out):
        """Of the program."""
        return "fit", *self.files, "-o", out, "-j", 2, "--resume"

    def judge(self, what, code, said, names, failed=True):
        """What is wrong about a batch that went wrong: ``names`` is to be named."""
        if "Traceback" in said or "Error:" in said:
            self.wrong.append(f"{what}: traceback: {said}")
        elif failed and (code == 0 or str(names) not in said):
            self.wrong.append(f"{what}: exit code {code}, said: {said}")

    def mended(self, what, out):
        """All is well once the fault is mended."""
        code, said = ran(STAND_IN, *self.arguments(out))
        if code != 0:
            self.wrong.append(f"{what}: exit code {code} when mended: {said}")
        self.wrong += [f"{what}: {error}" for error in faults_at_end(out, self.undisturbed)]

    def row(self, what, times, outcome):
        """A row, and what was wrong in it."""
        for error in self.wrong:
            print(error, flush=True)
        self.tried.add("folders", what, times, outcome, len(self.wrong))
        self.wrong = []


def full(bench, count):
    """Disks with room for nothing, for some of the results, and for nearly all."""
    disk, rng, failed = bench.folder / "disk", random.Random("full"), 0
    for n in range(count):
        size = 4 * rng.randint(1, 80)
        with small_disk(disk, size):
            out = disk / "out"
            code, said = ran(STAND_IN, *bench.arguments(out))
            bench.judge(f"disk of {size} KiB", code, said, out, failed=code != 0)
            bench.wrong += [f"disk {n}: {error}" for error in faults_of(out, bench.undisturbed)]
            if code == 0:
                bench.wrong += faults_at_end(out, bench.undisturbed)
            failed += code != 0
            remount(disk, "size=4096k")
            bench.mended(f"disk of {size} KiB", out)
    bench.row("disks of 4 to 320 KiB that get full", count, f"{failed} were too small; whole after --resume")


def read_only(bench, count):
    """A file system that cannot be written from the beginning, or from some moment on."""
    disk, rng = bench.folder / "disk", random.Random("read-only")
    for n in range(count):
        with small_disk(disk, 4096):
            out = disk / "out"
            out.mkdir()
            if n % 2 == 0:
                remount(disk, "ro")
                code, said = ran(STAND_IN, *bench.arguments(out))
            else:
                running = start(STAND_IN, *bench.arguments(out))
                _until(lambda out=out: any(out.glob("*.json")), running)
                time.sleep(rng.uniform(0, 0.3))
                while running.poll() is None:
                    if subprocess.run(["mount", "-o", "remount,ro", disk], capture_output=True).returncode == 0:
                        break  # refused while a file is open for writing
                said, code = running.communicate()[1], running.returncode
            bench.judge("read-only", code, said, out, failed=n % 2 == 0 or code != 0)
            remount(disk, "rw")
            bench.wrong += [f"read-only {n}: {error}" for error in faults_of(out, bench.undisturbed)]
            bench.mended("read-only", out)
    bench.row("file systems that are read-only, from the start or from some moment on", count, "whole after --resume")


def vanish(bench, count):
    """The folder for results, that of the logs, or a file to fit goes away in the middle."""
    rng = random.Random("vanish")
    for n in range(count):
        what = ("the folder", "the logs", "a file")[n % 3]
        out = bench.folder / f"vanish-{n}"
        running = start(STAND_IN, *bench.arguments(out))
        _until(lambda out=out: any(out.glob("*.json")), running)
        time.sleep(rng.uniform(0, 0.3))
        target = {"the folder": out, "the logs": out / "logs", "a file": bench.files[-1]}[what]
        content = bench.files[-1].read_bytes()
        if target.is_dir():
            gone = bench.folder / "gone"
            os.rename(target, gone)  # at once, as with a file system that is taken away
            shutil.rmtree(gone, ignore_errors=True)
        else:
            target.unlink(missing_ok=True)
        _, said = running.communicate()
        ended_first = what == "a file" and running.returncode == 0
        bench.judge(what, running.returncode, said, target, failed=what != "the logs" and not ended_first)
        bench.files[-1].write_bytes(content)
        bench.mended(what, out)
    bench.row("the folder for results, that of the logs, or a file to fit goes away", count, "whole after --resume")


def two(bench, count):
    """Two batches with the same folder."""
    rng, refused = random.Random("two"), 0
    for n in range(count):
        out = bench.folder / f"two-{n}"
        first = start(STAND_IN, *bench.arguments(out))
        time.sleep(rng.uniform(0, 2))
        second = start(STAND_IN, *bench.arguments(out))
        ended = [(running.communicate()[1], running.returncode) for running in (first, second)]
        for said, code in ended:
            bench.judge("two", code, said, out, failed=code != 0)
            if code != 0 and "another merlfit is writing there" not in said:
                bench.wrong.append(f"two: {said}")
        refused += sum(code != 0 for _, code in ended)
        if all(code != 0 for _, code in ended):
            bench.wrong.append("two: neither went on")
        bench.wrong += faults_at_end(out, bench.undisturbed)
    bench.row("two batches with one folder, begun up to two seconds apart", count,
              f"{refused} times one refused, {count - refused} times it came after the other; all whole")  # fmt: skip


def clock(bench, count):
    """The clock of the machine jumps while a batch runs, by hours to decades, there and back."""
    rng = random.Random("clock")
    moment = bench.folder / "moment"
    fake = {
        "LD_PRELOAD": str(FAKETIME[0]), "FAKETIME_TIMESTAMP_FILE": str(moment), "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
    }  # fmt: skip
    for n in range(count):
        out = bench.folder / f"clock-{n}"
        moment.write_text("+0")
        running = start(STAND_IN, *bench.arguments(out), **fake)
        jumps = 0
        while running.poll() is None:
            time.sleep(rng.uniform(0, 0.3))
            beside = moment.with_name("next")
            beside.write_text(rng.choice(JUMPS))
            beside.replace(moment)
            jumps += 1
        _, said = running.communicate()
        bench.judge("clock", running.returncode, said, out, failed=running.returncode != 0)
        if running.returncode != 0:
            bench.wrong.append(f"clock: exit code {running.returncode}")
        bench.wrong += faults_at_end(out, bench.undisturbed)
        bench.mended("clock", out)
    bench.row("clocks that jump, to and fro, by up to 30 years, some times a second", count, "all results whole")


def _until(condition, running):
    while not condition() and running.poll() is None:
        time.sleep(0.01)


TRIALS = {"full": full, "read_only": read_only, "vanish": vanish, "two": two, "clock": clock}


def run(tried, only=(), few=False, times=None):
    """Trials by name, all without one, as far as this machine lets them be tried."""
    count = times or (3 if few else 30)
    with tempfile.TemporaryDirectory() as place:
        bench = Bench(tried, Path(place))
        for name in only or TRIALS:
            if name in ("full", "read_only") and os.geteuid() != 0:
                print(f"{name}: not tried, mounting needs root", flush=True)
            elif name == "clock" and not FAKETIME:
                print("clock: not tried, needs libfaketime", flush=True)
            else:
                TRIALS[name](bench, count)
