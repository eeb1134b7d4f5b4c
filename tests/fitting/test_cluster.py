"""A Dask cluster: a real scheduler, and workers that are processes of this machine; `make faults` breaks them."""

import queue
import re
import signal
import subprocess
from types import SimpleNamespace

import psutil
import pytest
from merlfit.fitting.batch import cluster as module
from merlfit.fitting.batch import connection
from merlfit.fitting.batch.cluster import Cluster, ClusterError
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.results.storage import read_result

from tests.support.clusters import PROGRAM, ended, scheduler, units, until, workers
from tests.support.worker_tasks import task


@pytest.fixture(scope="module")
def where(tmp_path_factory):
    """Address of a scheduler with two workers."""
    folder = tmp_path_factory.mktemp("scheduler")
    with scheduler(folder) as (_, address), workers(address, folder, 2):
        yield address


def test_all_are_fitted_told_and_written_here(where, tmp_path):
    found, told = ended(Cluster(where, task=task), units(tmp_path / "out", "quick-a", "quick-b", "raises-c", "quick-d"))
    assert [found[k].kind for k in range(4)] == [Ending.FITTED, Ending.FITTED, Ending.FAILED, Ending.FITTED]
    assert found[2].error == f"{tmp_path / 'raises-c.binary'}: it raises"
    assert set(told) <= {(k, "reading") for k in range(4)}
    assert told
    for name in ("quick-a", "quick-b", "quick-d"):
        result = read_result(tmp_path / "out" / f"{name}.json")
        assert result.source.material == name
        assert result.source.path == str(tmp_path / f"{name}.binary")
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.binary" for name in (
        "quick-a", "quick-b", "raises-c", "quick-d")} | {"out"}  # fmt: skip


def test_a_worker_that_is_killed_in_mid_fit_is_survived(where, tmp_path):
    found, noted, at_work = units(tmp_path / "out", "waits-a"), [], []

    def tell(k, stage):
        if stage.isdigit() and not at_work:
            at_work.append(psutil.Process(int(stage)))
            at_work[0].kill()

    [(_, came)] = Cluster(where, task=task, note=noted.append).ended(found, tell)
    assert came.kind is Ending.FITTED
    assert at_work
    [text] = noted
    assert re.fullmatch(r"worker tcp://\S+ was lost while fitting waits-a; another worker starts it again", text)


def test_a_file_that_workers_do_not_see_is_sent(where, tmp_path, monkeypatch):
    [unit] = units(tmp_path / "out", "sees-a")
    cluster_of = Cluster(where, task=task, note=print)
    sent = []
    submit = cluster_of._client.submit

    def submitted(function, order, data, **more):
        sent.append(data)
        return submit(
            function, order.replace(b"sees-a.binary", b"SEES-A.binary") if data is None else order, data, **more
        )

    monkeypatch.setattr(cluster_of._client, "submit", submitted)
    found, _ = ended(cluster_of, [unit])
    assert found[0].kind is Ending.FITTED
    assert sent == [None, b"sees-a"]


def test_ctrl_c_ends_what_goes_on_and_keeps_what_there_is(where, tmp_path):
    found = [str(unit.path) for unit in units(tmp_path / "out", "patient-a", "quick-b")]
    command = [*PROGRAM, "fit", *found, "-o", str(tmp_path / "out"), "--jobs", "1", "--executor", where]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until(lambda: "reading" in running.stdout.readline(), "no file was begun")
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=90)
    assert running.returncode == 128 + signal.SIGINT
    assert said.startswith(f"merlfit: stopped by Ctrl-C: {tmp_path}/out/patient-a.json holds a fit without a posterior")
    assert said.endswith("not begun: 1 of 2 files; the same command with --resume goes on\n")
    assert read_result(tmp_path / "out/patient-a.json").source.material == "patient-a"
    assert not (tmp_path / "out/quick-b.json").exists()


def test_a_worker_of_other_versions_gets_nothing(where, tmp_path, monkeypatch):
    ours = module.versions()
    monkeypatch.setattr(module, "versions", lambda: ours | {"jax": "9.9"})
    other = Cluster(where, task=task, note=lambda text: (_ for _ in ()).throw(LookupError(text)))
    with pytest.raises(LookupError, match=rf"jax {ours['jax']} instead of 9\.9; it gets no files: install there"):
        next(other.ended(units(tmp_path / "out", "quick-a"), lambda k, stage: None))
    other.stop()


def worker(admitted=True, status="running"):
    """As a scheduler says it."""
    resources = {"merlfit-1": 1} if admitted else {}
    return {"resources": resources, "status": status, "metrics": {"memory": 2**30}, "memory_limit": 2**30}


def run_on(*answers, status="running"):
    """A run that is connected to nothing: what its scheduler says from one look to the next, or fails with."""
    run, left = object.__new__(Cluster), list(answers)

    def sync(question, callback_timeout):
        found = left.pop(0)
        if isinstance(found, Exception):
            raise found
        return found

    run._client = SimpleNamespace(
        status=status, scheduler=SimpleNamespace(identity=None), sync=sync, close=lambda timeout: None
    )
    run.where, run.jobs, run.note, run._admission = "dask://host:1", None, print, SimpleNamespace(name="merlfit-1")
    run._scheduler, run._workers, run._next, run._queue = "", {}, 0.0, None
    run._given, run._events, run._done = {}, queue.SimpleQueue(), SimpleNamespace(next_batch=lambda block: [])
    return run


def seen(*workers, scheduler="one"):
    return {"id": scheduler, "workers": {f"tcp://{n}": each for n, each in enumerate(workers)}}


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (seen(), "no worker is there"),
        (seen(worker(admitted=False)), "none of 1 workers has the versions of this process"),
        (seen(worker(status="paused")), r"worker tcp://0 takes nothing, since 1\.0 of 1\.0 GiB are in use: give worke"),
    ],
    ids=["none", "refused", "full"],
)
def test_without_a_worker_that_could_do_anything_a_run_says_so_and_ends(answer, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(module, "CONNECT", 0.1)
    monkeypatch.setattr(module, "WAIT", 0.6)
    with pytest.raises(ClusterError, match=rf"{said}.* for 0.01 minutes; what came back is written"):
        next(run_on(*[answer] * 9).ended(units(tmp_path / "out", "quick-a"), print))
    assert re.search(f"{said}.*; waiting for another", capsys.readouterr().out)


@pytest.mark.parametrize(
    "run",
    [
        run_on(status="connecting"),
        run_on(TimeoutError()),
        run_on(OSError()),
        run_on(seen(), seen(scheduler="another")),
    ],
    ids=["gone", "silent", "lost", "another"],
)
def test_a_scheduler_that_is_gone_ends_the_run_with_a_line(run, tmp_path):
    with pytest.raises(ClusterError, match="dask://host:1: the scheduler is gone; what came back is written"):
        next(run.ended(units(tmp_path / "out", "quick-a"), print))


def test_a_unit_has_a_worker_that_runs_and_that_has_our_versions():
    run = run_on(seen(worker(), worker(False), worker(status="paused"), worker()))
    assert run.room() == 2
    run.jobs = 1
    assert run.room() == 1  # without another look


@pytest.mark.parametrize(
    "bad", ["dask://nowhere", "dask:/host:1", "ssh://host:1", "", "dask://host:65536", "dask://host:0"]
)
def test_an_address_that_is_none_is_refused(bad):
    with pytest.raises(ClusterError, match="should be dask://HOST:PORT"):
        Cluster(bad)


@pytest.mark.parametrize(
    ("scheme", "said"),
    [
        ("dask", "OSError: Timed out"),
        ("dask+tls", r"ValueError: distributed\.comm\.tls in Dask's configuration lacks ca-file"),
    ],
)
def test_a_cluster_that_cannot_be_used_is_told(scheme, said, monkeypatch):
    monkeypatch.setattr(connection, "CONNECT", 0.5)
    said = rf"{re.escape(scheme)}://127\.0\.0\.1:9: no scheduler there takes files \({said}.*start one with `dask sche"
    with pytest.raises(ClusterError, match=said):
        Cluster(f"{scheme}://127.0.0.1:9")


def test_certificates_that_are_not_there_are_told():
    import dask

    there = {"distributed.comm.tls.ca-file": "/nowhere.pem", "distributed.comm.tls.client.cert": "/nowhere.pem"}
    with dask.config.set(there), pytest.raises(ClusterError, match=r"\(FileNotFoundError: .*No such file"):
        Cluster("dask+tls://127.0.0.1:9")


def test_a_cluster_that_cannot_be_used_is_one_line(tmp_path):
    [unit] = units(tmp_path / "out", "quick-a")
    command = [*PROGRAM, "fit", str(unit.path), "-o", str(unit.out), "--executor", "dask+tls://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert line.startswith("merlfit: dask+tls://127.0.0.1:9: no scheduler there takes files (ValueError: ")


def test_slurm_needs_to_be_there_and_told_how_many():
    with pytest.raises(ClusterError, match="needs --jobs N"):
        Cluster("dask-slurm")
    with pytest.raises(ClusterError, match="needs sbatch, which is not found"):
        Cluster("dask-slurm", 2)
