"""A Dask cluster: a real scheduler, and workers that are processes of this machine."""

import os
import re
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor

import psutil
import pytest
from merlfit.fitting.batch.cluster import Cluster, ClusterError
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.results.storage import read_result

from tests.support.clusters import PROGRAM, ended, scheduler, units, until, workers
from tests.support.worker_tasks import task


@pytest.fixture(scope="module")
def where(tmp_path_factory):
    """Address of a scheduler."""
    with scheduler(tmp_path_factory.mktemp("scheduler")) as (_, address):
        yield address


def test_all_are_fitted_told_and_written_here(where, tmp_path):
    noted = []
    with workers(where, tmp_path, 2):
        found, told = ended(
            Cluster(where, task=task, note=noted.append),
            units(tmp_path / "out", "quick-a", "quick-b", "raises-c", "quick-d"),
        )
    assert {k: e.kind for k, e in found.items()} == {
        0: Ending.FITTED,
        1: Ending.FITTED,
        2: Ending.FAILED,
        3: Ending.FITTED,
    }
    assert found[2].error == f"{tmp_path / 'raises-c.binary'}: it raises"
    assert set(told) <= {(k, "reading") for k in range(4)}
    assert told
    for name in ("quick-a", "quick-b", "quick-d"):
        result = read_result(tmp_path / "out" / f"{name}.json")
        assert result.source.material == name
        assert result.source.path == str(tmp_path / f"{name}.binary")
    assert not list(tmp_path.glob("scratch/**/merlfit-*"))


def test_a_lost_worker_takes_nothing_with_it_and_a_unit_that_kills_two_is_given_up(where, tmp_path):
    noted = []
    found = units(tmp_path / "out", "killed-a", "quick-b", "quick-c", "quick-d")
    with workers(where, tmp_path, 2):
        ended_as, _ = ended(Cluster(where, task=task, note=noted.append), found)
    assert ended_as[0].kind is Ending.LOST
    assert "its worker was lost" in ended_as[0].error
    assert [ended_as[k].kind for k in (1, 2, 3)] == [Ending.FITTED] * 3
    lost = [text for text in noted if "was lost while fitting killed-a" in text]
    assert ["another worker starts it again" in text for text in lost] == [True, False]  # as the scheduler allows
    assert not (tmp_path / "out/killed-a.json").exists()


def test_a_worker_that_is_killed_in_mid_fit_is_survived(where, tmp_path):
    found, noted, at_work = units(tmp_path / "out", "waits-a"), [], []

    def tell(k, stage):
        if stage.isdigit() and not at_work:
            at_work.append(psutil.Process(int(stage)))
            at_work[0].kill()

    with workers(where, tmp_path):
        [(_, came)] = Cluster(where, task=task, note=noted.append).ended(found, tell)
    assert came.kind is Ending.FITTED
    assert at_work
    [text] = noted
    assert re.fullmatch(r"worker tcp://\S+ was lost while fitting waits-a; another worker starts it again", text)


def test_a_worker_that_is_lost_while_it_is_idle_had_no_file(where, tmp_path):
    noted = []
    with workers(where, tmp_path, 2):
        run = Cluster(where, task=task, note=noted.append)
        until(lambda: run.room() >= 2, "not two workers")
        [address, process], *_ = run._client.run(os.getpid).items()
        psutil.Process(process).kill()
        until(lambda: address not in run._watch.workers, "the worker is still there")
        list(run.ended(units(tmp_path / "out", "quick-a"), lambda k, stage: None))
    assert f"worker {address} was lost" in noted


def test_two_runs_fit_no_two_files_in_one_worker_at_once(where, tmp_path):
    """Its memory is for one."""
    with workers(where, tmp_path, threads=2), ThreadPoolExecutor(2) as threads:
        runs = [(Cluster(where, task=task), units(tmp_path / f"out-{k}", f"alone-{k}")) for k in range(2)]
        found = [came[0] for came, _ in threads.map(ended, *zip(*runs, strict=True))]
    assert [came.kind for came in found] == [Ending.FITTED] * 2, found


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
    with workers(where, tmp_path):
        found, _ = ended(cluster_of, [unit])
    assert found[0].kind is Ending.FITTED
    assert sent == [None, b"sees-a"]


def test_a_stop_ends_what_goes_on_and_keeps_what_there_is(where, tmp_path):
    found = units(tmp_path / "out", "patient-a", "quick-b")
    cluster, told = Cluster(where, 1, task=task), []
    with workers(where, tmp_path):
        going = cluster.ended(found, lambda k, stage: told.append(k))

        def stop(signal_number, frame):
            raise KeyboardInterrupt

        before = signal.signal(signal.SIGALRM, stop)
        try:
            signal.setitimer(signal.ITIMER_REAL, 12)
            with pytest.raises(KeyboardInterrupt):
                next(going)
        finally:
            signal.signal(signal.SIGALRM, before)
        [(k, came)] = cluster.stop()
    assert (k, came.kind) == (0, Ending.STOPPED)
    assert came.result.source.material == "patient-a"
    assert read_result(tmp_path / "out/patient-a.json").source.material == "patient-a"
    assert not (tmp_path / "out/quick-b.json").exists()


def test_a_worker_of_other_versions_gets_nothing(where, tmp_path, monkeypatch):
    from merlfit.fitting.batch import cluster

    noted = []
    ours = cluster.versions()
    monkeypatch.setattr(cluster, "versions", lambda: ours | {"jax": "9.9"})
    with workers(where, tmp_path):
        other = Cluster(where, task=task, note=noted.append)
        going = other.ended(units(tmp_path / "out", "quick-a"), lambda k, stage: None)
        monkeypatch.setattr(other, "note", lambda text: (_ for _ in ()).throw(LookupError(text)))
        with pytest.raises(LookupError, match=rf"jax {ours['jax']} instead of 9\.9; it gets no files: install there"):
            next(going)
        other.stop()


@pytest.mark.parametrize(
    "bad", ["dask://nowhere", "dask:/host:1", "ssh://host:1", "", "dask://host:65536", "dask://host:0"]
)
def test_an_address_that_is_none_is_refused(bad):
    with pytest.raises(ClusterError, match="should be dask://HOST:PORT"):
        Cluster(bad)


def test_a_scheduler_that_is_not_there_is_told():
    with pytest.raises(ClusterError, match="no scheduler answers there within 5 s; start one with `dask scheduler`"):
        Cluster("dask://127.0.0.1:9")


def test_tls_without_certificates_is_told_before_anything_is_asked():
    with pytest.raises(
        ClusterError, match=r"needs certificates: distributed\.comm\.tls in Dask's configuration \(ca-fi"
    ):
        Cluster("dask+tls://127.0.0.1:9")


def test_certificates_that_are_not_there_are_told():
    import dask

    there = {"distributed.comm.tls.ca-file": "/nowhere.pem", "distributed.comm.tls.client.cert": "/nowhere.pem"}
    with dask.config.set(there), pytest.raises(ClusterError, match=r"needs certificates: .* \(.*No such file"):
        Cluster("dask+tls://127.0.0.1:9")


@pytest.mark.parametrize("scheme", ["dask", "dask+tls"])
def test_a_cluster_that_cannot_be_used_is_one_line(scheme, tmp_path):
    [unit] = units(tmp_path / "out", "quick-a")
    command = [*PROGRAM, "fit", str(unit.path), "-o", str(unit.out), "--executor", f"{scheme}://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    [said] = done.stderr.splitlines()
    assert said.startswith(f"merlfit: {scheme}://127.0.0.1:9: ")


def test_slurm_needs_to_be_there_and_told_how_many():
    with pytest.raises(ClusterError, match="needs --jobs N"):
        Cluster("dask-slurm")
    with pytest.raises(ClusterError, match="needs sbatch, which is not found"):
        Cluster("dask-slurm", 2)
