"""A Dask cluster: a real scheduler, and workers that are processes of this machine."""

import signal

import psutil
import pytest
from clusters import ended, scheduler, units, workers
from merlfit.fitting.execution.cluster import Cluster, ClusterError
from merlfit.fitting.execution.unit import Kind
from merlfit.fitting.results.export import read_result
from worker_tasks import task


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
    assert {k: e.kind for k, e in found.items()} == {0: Kind.FITTED, 1: Kind.FITTED, 2: Kind.FAILED, 3: Kind.FITTED}
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
    assert ended_as[0].kind is Kind.LOST
    assert "its worker was lost" in ended_as[0].error
    assert [ended_as[k].kind for k in (1, 2, 3)] == [Kind.FITTED] * 3
    assert sum("was lost: what it fitted is begun anew" in text for text in noted) >= 2
    assert not (tmp_path / "out/killed-a.json").exists()


def test_a_worker_that_is_killed_in_mid_fit_is_survived(where, tmp_path):
    found, noted, at_work = units(tmp_path / "out", "waits-a"), [], []

    def tell(k, stage):
        if stage.isdigit() and not at_work:
            at_work.append(psutil.Process(int(stage)))
            at_work[0].kill()

    with workers(where, tmp_path):
        [(_, came)] = Cluster(where, task=task, note=noted.append).ended(found, tell)
    assert came.kind is Kind.FITTED
    assert at_work
    assert any("was lost" in text for text in noted)


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
    assert found[0].kind is Kind.FITTED
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
    assert (k, came.kind) == (0, Kind.STOPPED)
    assert came.result.source.material == "patient-a"
    assert read_result(tmp_path / "out/patient-a.json").source.material == "patient-a"
    assert not (tmp_path / "out/quick-b.json").exists()


def test_a_worker_of_other_versions_gets_nothing(where, tmp_path, monkeypatch):
    from merlfit.fitting.execution import cluster

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


@pytest.mark.parametrize("bad", ["dask://nowhere", "dask:/host:1", "ssh://host:1", ""])
def test_an_address_that_is_none_is_refused(bad):
    with pytest.raises(ClusterError, match="should be dask://HOST:PORT"):
        Cluster(bad)


def test_a_scheduler_that_is_not_there_is_told():
    with pytest.raises(ClusterError, match="no scheduler answers there within 5 s; start one with `dask scheduler`"):
        Cluster("dask://127.0.0.1:9")


def test_slurm_needs_to_be_there_and_told_how_many():
    with pytest.raises(ClusterError, match="needs --jobs N"):
        Cluster("dask-slurm")
    with pytest.raises(ClusterError, match="needs sbatch, which is not found"):
        Cluster("dask-slurm", 2)
