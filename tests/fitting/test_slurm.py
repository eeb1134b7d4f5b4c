"""`--executor dask-slurm` with stand-ins for `sbatch` and `scancel`, jobs being processes of this machine."""

import subprocess
import sys

import pytest
from merlfit.fitting.results.manifest import lines
from merlfit.fitting.results.storage import read_result

from tests.support.clusters import SBATCH, jobs, slurm, started

BOUND = 120.0  # seconds: any of these ends long before
REFUSAL = "sbatch: error: Batch job submission failed: Invalid account"
SETTINGS = """
[effects]
index = "complex"
body = "none"
[fit]
grid = "coarse"
starts = 1
"""


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
        running = started(environment, tmp_path / "out", "quick-a", "raises-b", "quick-c")
        _, said = running.communicate(timeout=BOUND)
        asked, cancelled = jobs(tmp_path / "slurm/sbatch"), jobs(tmp_path / "slurm/scancel")
    assert running.returncode == 1
    # a job that is slow to begin is waited for, and that is said
    said = [text for text in said.splitlines() if not text.endswith("; waiting for another")]
    assert said == [f"merlfit: {tmp_path / 'raises-b.binary'}: it raises"]
    assert read_result(tmp_path / "out/quick-c.json").source.material == "quick-c"
    assert len(asked) == 1
    assert cancelled == asked


def test_what_sbatch_says_of_a_job_that_it_refuses_ends_the_run(tmp_path):
    with slurm(tmp_path / "slurm", SBATCH["refuses"]) as environment:
        running = started(environment, tmp_path / "out", "quick-a", count=2)
        _, said = running.communicate(timeout=BOUND)
    assert running.returncode == 1
    assert said == f"merlfit: dask-slurm: sbatch took no job ({REFUSAL})\nmerlfit: not fitted: 1 of 1 file\n"
    began, last = lines(tmp_path / "out")
    assert (began.executor, began.jobs) == ("dask-slurm", 2)
    assert (last.event, last.stopped) == ("ended", True)
