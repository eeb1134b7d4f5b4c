"""`--executor dask-slurm` with stand-ins for `sbatch` and `scancel`: jobs are processes of this machine."""

import os
import signal
import subprocess
import sys

import pytest
from merlfit.fitting.results.manifest import Ending, lines
from merlfit.fitting.results.storage import read_result

from tests.support.clusters import PROGRAM, SBATCH, jobs, slurm, units, until

BOUND = 120.0  # seconds: any of these ends long before
REFUSAL = "sbatch: error: Batch job submission failed: Invalid account"
ONE = f'if mkdir "$0.one" 2> /dev/null; then\n{SBATCH["starts"]}\nelse\n{SBATCH["refuses"]}\nfi\n'


SETTINGS = """
[effects]
index = "complex"
body = "none"
[fit]
grid = "coarse"
starts = 1
"""


def start(environment, out, *names, count=1):
    """A run on SLURM with a stand-in for the fit, going on."""
    files = [str(unit.path) for unit in units(out, *names)]
    return program(environment, *PROGRAM, "fit", *files, "-o", out, "--executor", "dask-slurm", "--jobs", count)


def program(environment, *words):
    return subprocess.Popen(
        [*map(str, words)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_a_file_is_fitted_by_a_job(tmp_path):
    """A genuine fit, of a synthetic file."""
    (tmp_path / "settings.toml").write_text(SETTINGS)
    merlfit, file = (sys.executable, "-m", "merlfit"), tmp_path / "nickel.binary"
    with slurm(tmp_path / "slurm", SBATCH["starts"]) as environment:
        program(environment, *merlfit, "synth", "nickel", "-o", file).communicate()
        options = ("--no-posterior", "--config", tmp_path / "settings.toml", "--executor", "dask-slurm", "--jobs", 1)
        running = program(environment, *merlfit, "fit", file, "-o", tmp_path / "out", *options)
        _, said = running.communicate()
    assert running.returncode == 0, said
    assert read_result(tmp_path / "out/nickel.json").fit.succeeded


def test_a_job_is_submitted_does_the_work_and_is_cancelled(tmp_path):
    with slurm(tmp_path / "slurm", SBATCH["starts"]) as environment:
        running = start(environment, tmp_path / "out", "quick-a", "raises-b", "quick-c")
        _, said = running.communicate(timeout=BOUND)
        asked, cancelled = jobs(tmp_path / "slurm/sbatch"), jobs(tmp_path / "slurm/scancel")
    assert running.returncode == 1
    assert said == f"merlfit: {tmp_path / 'raises-b.binary'}: it raises\n"
    assert read_result(tmp_path / "out/quick-c.json").source.material == "quick-c"
    assert len(asked) == 1
    assert cancelled == asked


def test_a_job_that_ends_is_asked_for_again_and_its_file_is_fitted(tmp_path):
    """As where its time is over."""
    with slurm(tmp_path / "slurm", SBATCH["starts"]) as environment:
        soon = environment | {"DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "1s"}
        running = start(soon, tmp_path / "out", "waits-a")
        until(lambda: running.stdout.readline().strip().split()[-1].isdigit(), "the worker did not say which it is")
        [first] = jobs(tmp_path / "slurm/sbatch")
        os.killpg(first, signal.SIGKILL)
        _, said = running.communicate(timeout=BOUND)
        asked = jobs(tmp_path / "slurm/sbatch")
    assert running.returncode == 0, said
    assert "was lost while fitting waits-a; another worker starts it again" in said
    assert len(asked) == 2


@pytest.mark.parametrize("state", ["waiting", "at work"])
def test_ctrl_c_keeps_what_is_there_and_cancels_the_jobs(state, tmp_path):
    sbatch = SBATCH["takes" if state == "waiting" else "starts"]
    with slurm(tmp_path / "slurm", sbatch) as environment:
        running = start(environment, tmp_path / "out", "quick-a", "patient-b")
        if state == "waiting":
            until(lambda: "waiting" in running.stderr.readline(), "nothing was said")
        else:
            until(lambda: "patient-b: reading" in running.stdout.readline(), "the second file was not begun")
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=BOUND)
        cancelled = jobs(tmp_path / "slurm/scancel")
    assert running.returncode == 128 + signal.SIGINT
    assert said.splitlines()[-1].startswith("merlfit: stopped by Ctrl-C: ")
    assert "Traceback" not in said
    assert (tmp_path / "out/quick-a.json").exists() == (state == "at work")
    assert (tmp_path / "out/patient-b.json").exists() == (state == "at work")
    *_, last = lines(tmp_path / "out")
    assert (last.event, last.stopped) == ("ended", True)
    assert cancelled == ([123] if state == "waiting" else jobs(tmp_path / "slurm/sbatch"))


def test_what_sbatch_says_of_a_job_that_it_refuses_ends_the_run(tmp_path):
    with slurm(tmp_path / "slurm", SBATCH["refuses"]) as environment:
        running = start(environment, tmp_path / "out", "quick-a", count=2)
        _, said = running.communicate(timeout=BOUND)
    assert running.returncode == 1
    assert said == f"merlfit: dask-slurm: sbatch took no job ({REFUSAL})\nmerlfit: not fitted: 1 of 1 file\n"
    began, last = lines(tmp_path / "out")
    assert (began.executor, began.jobs) == ("dask-slurm", 2)
    assert (last.event, last.stopped) == ("ended", True)


def test_a_run_goes_on_with_the_jobs_that_sbatch_takes(tmp_path):
    with slurm(tmp_path / "slurm", ONE) as environment:
        running = start(environment, tmp_path / "out", "quick-a", "quick-b", count=2)
        _, said = running.communicate(timeout=BOUND)
    assert running.returncode == 0, said
    assert said == f"merlfit: dask-slurm: sbatch did not take a job ({REFUSAL}); the others go on\n"
    assert [line.ended for line in lines(tmp_path / "out") if line.event == "file"] == [Ending.FITTED] * 2
