"""A Dask cluster on which something is wrong: a run ends, or goes on, and never waits for ever."""

import os
import signal
import subprocess
from pathlib import Path

import psutil
import pytest
from merlfit.fitting.batch import cluster as module
from merlfit.fitting.batch import watch
from merlfit.fitting.batch.cluster import Cluster, ClusterError
from merlfit.fitting.results.manifest import Ending

from tests.support.clusters import PROGRAM, ROOT, children, ended, program, scheduler, units, until, workers
from tests.support.worker_tasks import task

BOUND = 90.0  # seconds: any of these ends long before


def quiet(k, stage):
    """Nothing is told."""


@pytest.fixture(scope="module")
def where(tmp_path_factory):
    """Address of a scheduler that gives a worker up soon."""
    folder = tmp_path_factory.mktemp("scheduler")
    with scheduler(folder, DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL="5s") as (_, address):
        yield address


@pytest.fixture
def without(tmp_path):
    """Settings of a process of Dask's that has no merlfit."""
    (tmp_path / "less").mkdir()
    (tmp_path / "less/merlfit.py").write_text("raise ModuleNotFoundError(\"No module named 'merlfit'\")\n")
    dist = tmp_path / "less/sitecustomize.py"
    dist.write_text(
        "from importlib import metadata\n"
        "found = metadata.version\n"
        "def version(name):\n"
        "    if name == 'merlfit':\n"
        "        raise metadata.PackageNotFoundError(name)\n"
        "    return found(name)\n"
        "metadata.version = version\n"
    )
    return {"PYTHONPATH": f"{tmp_path / 'less'}{os.pathsep}{ROOT}"}


def test_a_result_that_dies_with_its_worker_before_it_is_fetched_is_made_anew(where, tmp_path, monkeypatch):
    at_work, noted, fetched = [], [], []
    fetch = Cluster._fetch

    def dies_first(self, k, future):
        until(lambda: at_work, "the worker did not say which it is")
        if not fetched:
            psutil.Process(at_work[0]).kill()
        fetched.append(k)
        fetch(self, k, future)

    monkeypatch.setattr(Cluster, "_fetch", dies_first)
    with workers(where, tmp_path):
        run = Cluster(where, task=task, note=noted.append)
        [(_, came)] = run.ended(
            units(tmp_path / "out", "tells-a"), lambda k, stage: at_work.append(int(stage)) if stage.isdigit() else None
        )
    assert came.kind is Ending.FITTED
    assert len(set(at_work)) == 2
    assert any("was lost" in text for text in noted)


def test_a_worker_that_is_frozen_loses_its_file_to_another(where, tmp_path):
    at_work = []

    def tell(k, stage):
        if stage.isdigit() and not at_work:
            at_work.append(psutil.Process(int(stage)))
            at_work[0].suspend()

    with workers(where, tmp_path, 2):
        found = dict(Cluster(where, task=task).ended(units(tmp_path / "out", "waits-a", "quick-b"), tell))
    assert at_work
    assert [found[k].kind for k in (0, 1)] == [Ending.FITTED] * 2


def test_a_worker_that_does_nothing_is_begun_anew_and_its_file_goes_on(where, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "STUCK", 4.0)
    noted = []
    with workers(where, tmp_path):
        found, _ = ended(Cluster(where, task=task, note=noted.append), units(tmp_path / "out", "waits-a"))
    assert found[0].kind is Ending.FITTED
    assert any("has done nothing with" in text and "waits-a.binary for" in text for text in noted)


def test_a_file_with_which_no_worker_does_anything_is_given_up(where, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "STUCK", 4.0)
    noted = []
    with workers(where, tmp_path):
        found, _ = ended(Cluster(where, 1, task=task, note=noted.append), units(tmp_path / "out", "idle-a", "quick-b"))
    assert (found[0].kind, found[1].kind) == (Ending.LOST, Ending.FITTED)
    assert sum("has done nothing with" in text for text in noted) == 2  # as many as the scheduler allows


def test_a_worker_without_merlfit_is_refused_and_the_others_work(where, tmp_path, without):
    noted, address = [], where.replace("dask", "tcp")
    less = program("worker", address, "--no-dashboard", folder=tmp_path / "bare", **without)
    with less as running, workers(where, tmp_path):
        until(lambda: children(running.pid), "no worker")
        until(lambda: b"Registered to" in (tmp_path / "bare/said").read_bytes(), "not registered")
        found, _ = ended(Cluster(where, task=task, note=noted.append), units(tmp_path / "out", "quick-a"))
    assert found[0].kind is Ending.FITTED
    assert any("merlfit missing instead of" in text and "it gets no files" in text for text in noted)


def test_a_scheduler_without_merlfit_is_told(tmp_path, without):
    with (
        scheduler(tmp_path, **without) as (_, address),
        pytest.raises(ClusterError, match=r"the scheduler cannot take files \(ModuleNotFoundError: .*install there"),
    ):
        Cluster(address, task=task)


@pytest.mark.parametrize(
    ("more", "environment", "said"),
    [
        (None, {}, "no worker is there"),
        ((), "without", "none of 1 workers has the versions of this process"),
        (("--memory-limit", "1MB", "--no-nanny"), {}, r"takes nothing, since .* GiB are in use: give workers more"),
    ],
    ids=["none", "refused", "full"],
)
def test_without_a_worker_that_could_do_anything_a_run_says_so_and_ends(
    more, environment, said, tmp_path, without, monkeypatch
):
    monkeypatch.setattr(module, "CONNECT", 2.0)
    monkeypatch.setattr(module, "WAIT", 6.0)
    noted, environment = [], without if environment == "without" else environment
    with scheduler(tmp_path) as (_, address):
        none = more is None
        with program("--help", folder=tmp_path / "no") if none else workers(address, tmp_path, 1, more, **environment):
            if "--memory-limit" in (
                more or ()
            ):  # a worker looks at its memory every 0.1 s, and takes units before it did
                until(lambda: b"Pausing worker" in (tmp_path / "worker/said").read_bytes(), "the worker is not full")
            run = Cluster(address, task=task, note=noted.append)
            with pytest.raises(ClusterError, match=rf"{said}.* for 0.1 minutes; what came back is written"):
                ended(run, units(tmp_path / "out", "quick-a"))
    assert any("waiting for another" in text for text in noted)


@pytest.mark.parametrize("busy", [True, False], ids=["at work", "waiting"])
def test_a_scheduler_that_goes_away_ends_the_run_with_a_line(busy, tmp_path):
    with scheduler(tmp_path) as (its, address), workers(address, tmp_path, 1 if busy else 0):
        going = Cluster(address, task=task).ended(
            units(tmp_path / "out", "waits-a"), lambda k, stage: its.kill() if stage.isdigit() else None
        )
        if not busy:
            its.kill()
        with pytest.raises(ClusterError, match="the scheduler is gone; what came back is written"):
            next(going)


def test_a_scheduler_that_is_begun_anew_while_a_run_waits_ends_it_with_a_line(tmp_path):
    """Its address is the same, and the client finds it; it knows nothing of the run."""
    with scheduler(tmp_path) as (first, address):
        run = Cluster(address, task=task)
        first.kill()
        first.wait()
        with scheduler(tmp_path, address.rsplit(":")[-1]):
            until(lambda: run._client.status in ("running", "closed"), "the client does not find the scheduler")
            with pytest.raises(ClusterError, match="the scheduler is gone"):
                ended(run, units(tmp_path / "out", "quick-a"))


def test_a_scheduler_that_is_frozen_ends_the_run_with_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(watch, "QUIET", 6.0)
    with scheduler(tmp_path) as (its, address), workers(address, tmp_path):
        going = Cluster(address, task=task).ended(
            units(tmp_path / "out", "waits-a"),
            lambda k, stage: its.send_signal(signal.SIGSTOP) if stage.isdigit() else None,
        )
        with pytest.raises(ClusterError, match="the scheduler is gone"):
            next(going)


@pytest.mark.parametrize("state", ["no worker", "refused", "at work", "worker frozen", "scheduler frozen", "gone"])
def test_ctrl_c_ends_a_run_whatever_its_cluster_does(state, tmp_path, without):
    names = ("patient-a", "patient-b")
    found = [str(unit.path) for unit in units(tmp_path / "out", *names)]
    command = [*PROGRAM, "fit", *found, "-o", str(tmp_path / "out"), "--executor"]
    with scheduler(tmp_path) as (its, address):
        environment = without if state == "refused" else {}
        count = 0 if state == "no worker" else 1
        with workers(address, tmp_path, count, **environment) as given:
            running = subprocess.Popen([*command, address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            if count and state != "refused":
                until(lambda: "reading" in running.stdout.readline(), "no file was begun")
            else:
                until(lambda: "waiting" in running.stderr.readline(), "nothing was said")
            if state == "worker frozen":
                for each in children(given.pid):
                    each.suspend()
            if state == "scheduler frozen":
                its.send_signal(signal.SIGSTOP)
            if state == "gone":
                its.kill()
            running.send_signal(signal.SIGINT)
            _, said = running.communicate(timeout=BOUND)
    assert running.returncode == (128 + signal.SIGINT if state != "gone" else running.returncode)
    assert running.returncode in (130, 1)
    assert "Traceback" not in said
    assert "the same command with --resume goes on" in said
    if running.returncode == 1:
        assert said.splitlines()[-1].startswith("merlfit: not fitted: 2 of 2 files; ")
    assert Path(tmp_path / "out/patient-a.json").exists() == (state == "at work")
