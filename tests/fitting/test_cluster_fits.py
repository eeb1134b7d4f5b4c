"""`merlfit fit` on a real cluster, whole: its worker is killed in the middle, and every value is that of `--jobs 1`."""

import subprocess
import sys

import psutil
import pytest
from merlfit.fitting.results.storage import read_result

from tests.support.clusters import children, scheduler, until, workers

MATERIALS = ("nickel", "chrome", "aluminium")
SETTINGS = """
[effects]
index = "complex"
body = "none"
[fit]
grid = "coarse"
starts = 2
"""
PATIENCE = 900.0  # seconds, where programs have to be compiled, on a busy machine


def merlfit(*words):
    """The command, run to its end."""
    done = subprocess.run(
        [sys.executable, "-m", "merlfit", *map(str, words)], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def values(path):
    """What a result says, without when and how long."""
    held = read_result(path).model_dump()
    for key in ("run", "seconds"):
        held.pop(key)
    return held


@pytest.mark.slow
def test_fits_of_a_cluster_that_loses_its_worker_are_those_of_one_job(tmp_path):
    files = [tmp_path / f"{name}.binary" for name in MATERIALS]
    for name, path in zip(MATERIALS, files, strict=True):
        merlfit("synth", name, "-o", path)
    config = tmp_path / "settings.toml"
    config.write_text(SETTINGS)
    options = ("--no-posterior", "--config", config)
    merlfit("fit", *files, "-o", tmp_path / "here", *options, "--jobs", 1)
    command = [sys.executable, "-m", "merlfit", "fit", *files, "-o", tmp_path / "there", *options, "--executor"]
    with scheduler(tmp_path) as (_, address), workers(address, tmp_path, threads=2) as given:
        running = subprocess.Popen(
            [*map(str, command), address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        until(lambda: "chrome: coarse grid" in running.stdout.readline(), "the second file was not begun", PATIENCE)
        at_work = max(children(given.pid), key=lambda process: process.memory_info().rss)
        at_work.kill()
        _, said = running.communicate(timeout=PATIENCE)
        assert not psutil.pid_exists(at_work.pid)
    assert running.returncode == 0, said
    assert "was lost while fitting chrome; another worker starts it again" in said
    for name in MATERIALS:
        assert values(tmp_path / f"there/{name}.json") == values(tmp_path / f"here/{name}.json")
