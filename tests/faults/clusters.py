"""Real clusters of Dask on which something is wrong: a run ends with a line, or goes on, and never waits for ever."""

import os
import signal
import subprocess
import tempfile
import traceback
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from unittest import mock

import psutil
from merlfit.fitting.batch import cluster as module
from merlfit.fitting.batch.cluster import Cluster, ClusterError
from merlfit.fitting.results.manifest import Ending, lines

from ..support.clusters import (
    PROGRAM,
    ROOT,
    SBATCH,
    children,
    ended,
    jobs,
    program,
    scheduler,
    slurm,
    started,
    units,
    until,
    workers,
)
from ..support.worker_tasks import task

BOUND = 90.0  # seconds: any of these ends long before
SOON = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "5s"}  # after which a worker that is silent is given up


def less(folder):
    """Settings of a process of Dask's that has no merlfit."""
    (folder / "less").mkdir()
    (folder / "less/merlfit.py").write_text("raise ModuleNotFoundError(\"No module named 'merlfit'\")\n")
    (folder / "less/sitecustomize.py").write_text(
        "from importlib import metadata\n"
        "found = metadata.version\n"
        "def version(name):\n"
        "    if name == 'merlfit':\n"
        "        raise metadata.PackageNotFoundError(name)\n"
        "    return found(name)\n"
        "metadata.version = version\n"
    )
    return {"PYTHONPATH": f"{folder / 'less'}{os.pathsep}{ROOT}"}


def refused(call, said):
    """It ends with this line."""
    found = "it goes on"
    try:
        call()
    except ClusterError as error:
        found = str(error)
    assert said in found, found


def kills_two(folder):
    """a file that kills two workers is given up, the others go on"""
    noted, found = [], units(folder / "out", "killed-a", "quick-b", "quick-c", "quick-d")
    with scheduler(folder) as (_, where), workers(where, folder, 2):
        came, _ = ended(Cluster(where, task=task, note=noted.append), found)
    assert came[0].kind is Ending.LOST
    assert "its worker was lost" in came[0].error
    assert [came[k].kind for k in (1, 2, 3)] == [Ending.FITTED] * 3
    lost = [text for text in noted if "was lost while fitting killed-a" in text]
    assert ["another worker starts it again" in text for text in lost] == [True, False], noted  # as Dask allows
    assert not (folder / "out/killed-a.json").exists()


def not_fetched(folder):
    """a worker dies with a result that is not fetched yet: another one fits the file anew"""
    at_work, noted = [], []
    with scheduler(folder) as (_, where), workers(where, folder):
        run = Cluster(where, task=task, note=noted.append)
        gather = run._client._gather_remote

        async def dies_first(*of):
            if len(at_work) == 1:
                psutil.Process(at_work[0]).kill()
            return await gather(*of)

        run._client._gather_remote = dies_first
        tell = lambda k, stage: at_work.append(int(stage)) if stage.isdigit() else None  # noqa: E731
        [(_, came)] = run.ended(units(folder / "out", "tells-a"), tell)
    assert came.kind is Ending.FITTED
    assert len(set(at_work)) == 2, at_work


def frozen_worker(folder):
    """a worker that is frozen loses its file to another"""
    at_work = []

    def tell(k, stage):
        if stage.isdigit() and not at_work:
            at_work.append(psutil.Process(int(stage)))
            at_work[0].suspend()

    with scheduler(folder, **SOON) as (_, where), workers(where, folder, 2):
        found = dict(Cluster(where, task=task).ended(units(folder / "out", "waits-a", "quick-b"), tell))
    assert at_work
    assert [found[k].kind for k in (0, 1)] == [Ending.FITTED] * 2


def two_runs(folder):
    """two runs on one scheduler fit no two files in one worker at once"""
    with (
        scheduler(folder) as (_, where),
        workers(where, folder, threads=2),
        ThreadPoolExecutor(2) as threads,
    ):
        runs = [(Cluster(where, task=task), units(folder / f"out-{k}", f"alone-{k}")) for k in range(2)]
        found = [came[0] for came, _ in threads.map(ended, *zip(*runs, strict=True))]
    assert [came.kind for came in found] == [Ending.FITTED] * 2, found


def worker_without(folder):
    """a worker without merlfit is refused, and the others work"""
    noted, bare = [], folder / "bare"
    with scheduler(folder) as (_, where):
        address = where.replace("dask", "tcp")
        with program("worker", address, "--no-dashboard", folder=bare, **less(folder)), workers(where, folder):
            until(lambda: b"Registered to" in (bare / "said").read_bytes(), "not registered")
            found, _ = ended(Cluster(where, task=task, note=noted.append), units(folder / "out", "quick-a"))
    assert found[0].kind is Ending.FITTED
    assert any("merlfit missing instead of" in text and "it gets no files" in text for text in noted), noted


def scheduler_without(folder):
    """a scheduler without merlfit is told"""
    with scheduler(folder, **less(folder)) as (_, where):
        refused(lambda: Cluster(where, task=task), "no scheduler there takes files (ModuleNotFoundError: ")


def none_able(folder, said, count=1, more=(), without=False):
    noted, environment = [], less(folder) if without else {}
    with (
        mock.patch.multiple(module, CONNECT=2.0, WAIT=6.0),
        scheduler(folder) as (_, where),
        workers(where, folder, count, more, **environment),
    ):
        if more:  # a worker looks at its memory every 0.1 s, and takes units before it did
            until(lambda: b"Pausing worker" in (folder / "worker/said").read_bytes(), "the worker is not full")
        run = Cluster(where, task=task, note=noted.append)
        refused(lambda: ended(run, units(folder / "out", "quick-a")), said)
    assert any("waiting for another" in text for text in noted), noted


def scheduler_goes(folder, busy):
    with scheduler(folder) as (its, where), workers(where, folder, int(busy)):
        going = Cluster(where, task=task).ended(
            units(folder / "out", "waits-a"), lambda k, stage: its.kill() if stage.isdigit() else None
        )
        if not busy:
            its.kill()
        refused(lambda: next(going), "the scheduler is gone; what came back is written")


def another_scheduler(folder):
    """a scheduler is begun anew where a run waits: its address is the same, it knows nothing of the run"""
    with scheduler(folder) as (first, where):
        run = Cluster(where, task=task)
        run.room()
        first.kill()
        first.wait()
        with scheduler(folder, where.rsplit(":")[-1]):
            until(lambda: run._client.status in ("running", "closed"), "the client does not find the scheduler")
            refused(lambda: ended(run, units(folder / "out", "quick-a")), "the scheduler is gone")


def frozen_scheduler(folder):
    """a scheduler that is frozen ends the run with a line"""
    with (
        mock.patch.object(module, "QUIET", 6.0),
        scheduler(folder) as (its, where),
        workers(where, folder),
    ):
        freeze = lambda k, stage: its.send_signal(signal.SIGSTOP) if stage.isdigit() else None  # noqa: E731
        going = Cluster(where, task=task).ended(units(folder / "out", "waits-a"), freeze)
        refused(lambda: next(going), "the scheduler is gone")


def ctrl_c(folder, state):
    found = [str(unit.path) for unit in units(folder / "out", "patient-a", "patient-b")]
    command = [*PROGRAM, "fit", *found, "-o", str(folder / "out"), "--executor"]
    environment, count = less(folder) if state == "refused" else {}, int(state != "no worker")
    with scheduler(folder) as (its, where), workers(where, folder, count, **environment) as given:
        running = subprocess.Popen([*command, where], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if state in ("no worker", "refused"):
            until(lambda: "waiting" in running.stderr.readline(), "nothing was said")
        else:
            until(lambda: "reading" in running.stdout.readline(), "no file was begun")
        if state == "worker frozen":
            for each in children(given.pid):
                each.suspend()
        if state == "scheduler frozen":
            its.send_signal(signal.SIGSTOP)
        if state == "scheduler gone":
            its.kill()
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=BOUND)
    assert running.returncode in ((1, 130) if state == "scheduler gone" else (130,)), said
    assert "Traceback" not in said, said
    assert "the same command with --resume goes on" in said, said
    if running.returncode == 1:
        assert said.splitlines()[-1].startswith("merlfit: not fitted: 2 of 2 files; "), said
    assert (folder / "out/patient-a.json").exists() == (state == "at work")


def job_ends(folder):
    """a job of SLURM whose time is over is asked for again, and its file is fitted"""
    with slurm(folder / "slurm", SBATCH["starts"]) as environment:
        soon = environment | {"DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "1s"}
        running = started(soon, folder / "out", "waits-a")
        until(lambda: running.stdout.readline().strip().split()[-1].isdigit(), "the worker did not say which it is")
        [first] = jobs(folder / "slurm/sbatch")
        os.killpg(first, signal.SIGKILL)
        _, said = running.communicate(timeout=BOUND)
        asked = jobs(folder / "slurm/sbatch")
    assert running.returncode == 0, said
    assert "was lost while fitting waits-a; another worker starts it again" in said, said
    assert len(asked) == 2


def one_job(folder):
    """a run goes on with the jobs that `sbatch` takes"""
    one = f'if mkdir "$0.one" 2> /dev/null; then\n{SBATCH["starts"]}\nelse\n{SBATCH["refuses"]}\nfi\n'
    with slurm(folder / "slurm", one) as environment:
        running = started(environment, folder / "out", "quick-a", "quick-b", count=2)
        _, said = running.communicate(timeout=BOUND)
    assert running.returncode == 0, said
    assert said.startswith("merlfit: dask-slurm: sbatch did not take a job (sbatch: error: "), said
    assert said.endswith("); the others go on\n"), said
    assert [line.ended for line in lines(folder / "out") if line.event == "file"] == [Ending.FITTED] * 2


def job_stopped(folder, at_work):
    with slurm(folder / "slurm", SBATCH["starts" if at_work else "takes"]) as environment:
        running = started(environment, folder / "out", "quick-a", "patient-b")
        if at_work:
            until(lambda: "patient-b: reading" in running.stdout.readline(), "the second file was not begun")
        else:
            until(lambda: "waiting" in running.stderr.readline(), "nothing was said")
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=BOUND)
        cancelled = jobs(folder / "slurm/scancel")
        assert cancelled == (jobs(folder / "slurm/sbatch") if at_work else [123])
    assert running.returncode == 128 + signal.SIGINT, said
    assert said.splitlines()[-1].startswith("merlfit: stopped by Ctrl-C: "), said
    assert "Traceback" not in said, said
    assert (folder / "out/quick-a.json").exists() == at_work
    assert (folder / "out/patient-b.json").exists() == at_work
    *_, last = lines(folder / "out")
    assert (last.event, last.stopped) == ("ended", True)


FULL = ("--memory-limit", "1MB", "--no-nanny")
STATES = ("no worker", "refused", "at work", "worker frozen", "scheduler frozen", "scheduler gone")
TRIALS = {
    **{each.__name__: (each.__doc__, each) for each in (
        kills_two, not_fetched, frozen_worker, two_runs, worker_without, scheduler_without, another_scheduler,
        frozen_scheduler, job_ends, one_job,
    )},
    "no_worker": ("without a worker a run says so and ends", partial(none_able, said="no worker is there", count=0)),
    "all_refused": ("the same where all workers are refused", partial(
        none_able, said="none of 1 workers has the versions of this process", without=True)),
    "full": ("the same where all have no memory left", partial(
        none_able, said=" GiB are in use: give workers more", more=FULL)),
    "gone_at_work": ("a scheduler that goes away at work ends the run with a line", partial(scheduler_goes, busy=True)),
    "gone_waiting": ("the same where the run waits for workers", partial(scheduler_goes, busy=False)),
    "job_at_work": ("Ctrl-C while a job of SLURM is at work", partial(job_stopped, at_work=True)),
    "job_waits": ("Ctrl-C while a job waits in SLURM's queue", partial(job_stopped, at_work=False)),
    **{f"ctrl_c_{state.replace(' ', '_')}": (f"Ctrl-C; {state}", partial(ctrl_c, state=state)) for state in STATES},
}  # fmt: skip
"""By name: what is tried, and how."""


def run(tried, only, few=False, times=None):
    """Trials by name, all without one; each once, whatever is asked for."""
    for name in only or TRIALS:
        what, trial = TRIALS[name]
        wrong = 0
        with tempfile.TemporaryDirectory() as place:
            try:
                trial(Path(place))
            except Exception:  # of any kind: the next one has its turn
                traceback.print_exc()
                wrong = 1
        tried.add("clusters", what, 1, "otherwise" if wrong else "as it should be", wrong)
