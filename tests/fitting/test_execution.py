"""Batches in worker processes: nothing that is done is lost, whatever happens to one of them."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import psutil
import pytest
from merlfit.fitting.batch import pool
from merlfit.fitting.batch.pool import Pool
from merlfit.fitting.batch.unit import Unit, fit_unit
from merlfit.fitting.commands.fit import _done
from merlfit.fitting.results import manifest
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.results.storage import versions, write_result
from merlfit.fitting.settings.config import Config, load
from merlfit.fitting.support import processes
from merlfit.fitting.support.outputs import log
from merlfit.fitting.support.processes import jobs_for
from merlfit.fitting.support.threads import CORES
from merlfit.merl_io.binary import DIMS, write
from merlfit.merl_io.source import MerlError, sha1_of

from tests.support.made_results import made
from tests.support.worker_tasks import task

ROOT = Path(__file__).parents[2]
PROGRAM = f"""
import signal, sys
sys.path.insert(0, {str(ROOT)!r})
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever it is begun by: a shell's "&" makes it deaf
from tests.support.worker_tasks import task
from merlfit.fitting.commands import cli, fit as files
from merlfit.fitting.batch.pool import Pool
files.executor_of = lambda units, jobs, where: (Pool(2, task, note=files.note), 2)
if __name__ == "__main__":
    cli.main()
"""


def units(out, *names):
    return [Unit(Path(f"{name}.binary"), out, Config()) for name in names]


def ended(out, jobs, *names):
    """How each of these ended, what was told of them, and what was noted."""
    told, noted = [], []
    found = list(Pool(jobs, task, noted.append).ended(units(out, *names), lambda k, stage: told.append((k, stage))))
    return dict(found), told, noted


def workers_left():
    """Processes of ours but for the one that Python keeps for all."""
    return [p for p in psutil.Process().children() if "resource_tracker" not in " ".join(p.cmdline())]


def test_all_are_fitted_and_told(tmp_path):
    found, told, noted = ended(tmp_path, 2, "quick-a", "prints-b", "raises-c", "quick-d")
    assert {k: e.kind for k, e in found.items()} == {
        0: Ending.FITTED,
        1: Ending.FITTED,
        2: Ending.FAILED,
        3: Ending.FITTED,
    }
    assert set(told) == {(k, "reading") for k in range(4)}
    assert noted == []
    assert found[3].result.source.material == "quick-d"
    workers = {(tmp_path / f"{name}.began").read_text() for name in ("quick-a", "prints-b", "raises-c", "quick-d")}
    assert len(workers) <= 2
    assert str(os.getpid()) not in workers
    assert "said by a library" in (tmp_path / "logs" / "prints-b.log").read_text()
    assert not workers_left()


def test_one_that_is_killed_is_tried_again_alone_and_the_others_go_on(tmp_path):
    found, _, noted = ended(tmp_path, 2, "killed-a", "once-b", "quick-c", "quick-d")
    assert [found[k].kind for k in range(4)] == [Ending.LOST, Ending.FITTED, Ending.FITTED, Ending.FITTED]
    assert set(list(found)[-2:]) == {0, 1}  # the last ones
    assert len(noted) == 2
    assert "killed-a.binary: its process was killed (SIGKILL, as the system does when memory runs out)" in "".join(
        noted
    )
    assert all(line.endswith("it is tried once more when the others are done, alone") for line in noted)


def test_one_that_alone_is_told_to_stop_is_tried_again_and_the_others_go_on(tmp_path):
    found, _, noted = ended(tmp_path, 2, "told-a", "quick-b", "quick-c")
    assert {k: e.kind for k, e in found.items()} == dict.fromkeys(range(3), Ending.FITTED)
    assert "told-a.binary: its process was told to stop (SIGTERM" in noted[0]


def stopped_once_begun(at_work, which, given):
    """Stop when these units have begun; numbers of those that ended before."""
    begun, over = set(), []

    def tell(k, stage):
        begun.add(k)
        if which <= begun:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        over.extend(k for k, _ in at_work.ended(given, tell))
    return over


def test_workers_that_are_halted_are_ended_at_once(tmp_path):
    at_work = Pool(2, task, print)
    assert stopped_once_begun(at_work, {0, 1}, units(tmp_path, "halted-a", "halted-b")) == []
    start = time.monotonic()
    assert {e.kind for _, e in at_work.stop()} <= {Ending.STOPPED, Ending.FITTED}
    assert time.monotonic() - start < pool.PATIENCE / 2
    assert not workers_left()


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_cost_the_fits(closed, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    names = [f"{name}.binary" for name in ("quick-a", "quick-b", "quick-c")]
    words = [sys.executable, str(program), "fit", *names, "-o", str(tmp_path)]
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", *words], stderr=subprocess.PIPE, text=True, timeout=180
    )
    assert done.returncode == 0
    assert "tried once more" not in done.stderr
    assert '"failed"' not in (tmp_path / "manifest.jsonl").read_text()
    assert all((tmp_path / f"{name}.json").is_file() for name in ("quick-a", "quick-b", "quick-c"))


class Deaf:
    """A process that hears no signal and does not end."""

    pid = None
    terminate = kill = lambda _: None
    is_alive = lambda _: True  # noqa: E731
    join = lambda _, seconds: time.sleep(seconds)  # noqa: E731


def test_workers_that_do_not_end_are_waited_for_once(monkeypatch):
    monkeypatch.setattr(pool, "PATIENCE", 0.4)
    ours, theirs = Pipe()
    at_work = Pool(1, task, print)
    at_work._workers = [pool._Worker(Deaf(), ours, [], 0)]
    start = time.monotonic()
    assert at_work.stop() == [(0, pool.NOTHING)]
    assert time.monotonic() - start < 1.5 * pool.PATIENCE
    theirs.close()


def test_who_is_at_work_when_it_is_stopped_leaves_what_it_has(tmp_path):
    at_work = Pool(2, task, print)
    assert stopped_once_begun(at_work, {0, 2}, units(tmp_path, "slow-a", "quick-b", "slow-c")) == [1]
    stopped = dict(at_work.stop())
    assert {k: e.kind for k, e in stopped.items()} == {0: Ending.STOPPED, 2: Ending.STOPPED}
    assert stopped[0].result.source.material == "slow-a"
    assert not workers_left()


def start(out, *words):
    program = out / "program.py"
    program.write_text(PROGRAM)
    command = [sys.executable, str(program), "fit", *words, "-o", str(out)]
    return subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)


def wait_for(*paths):
    end = time.monotonic() + 60
    while not all(path.exists() for path in paths):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_ctrl_c_ends_all_workers_and_says_how_to_go_on(tmp_path):
    running = start(tmp_path, "quick.binary", "slow-a.binary", "slow-b.binary", "quick-c.binary")
    wait_for(tmp_path / "slow-a.began", tmp_path / "slow-b.began", tmp_path / "quick.json")
    workers = psutil.Process(running.pid).children(recursive=True)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does it: to all
    printed, said = running.communicate(timeout=180)  # beside compilers of other tests
    assert running.returncode == 128 + signal.SIGINT
    assert said.startswith(f"merlfit: stopped by Ctrl-C: {tmp_path}/slow-a.json holds a fit without a posterior")
    assert said.endswith("not begun: 1 of 4 files; the same command with --resume goes on\n")
    assert "quick" in printed.split("Fits")[1]
    assert not psutil.wait_procs(workers, timeout=10)[1]
    events = list(manifest.lines(tmp_path))
    assert [line.event for line in events] == ["began", "file", "ended"]
    assert events[-1].stopped


def test_workers_do_not_outlive_who_started_them(tmp_path):
    running = start(tmp_path, "slow-a.binary", "slow-b.binary")
    wait_for(tmp_path / "slow-a.began", tmp_path / "slow-b.began")
    workers = psutil.Process(running.pid).children(recursive=True)
    running.kill()
    running.communicate()
    gone, alive = psutil.wait_procs(workers, timeout=10)
    assert len(gone) >= 2
    assert not alive


@pytest.fixture
def done(tmp_path):
    """A unit whose file is there, and the result of it as this program would write it."""
    path = tmp_path / "nickel.binary"
    write(path, np.ones((3, *DIMS)))
    return Unit(path, tmp_path, load(posterior=False))


def put(unit, **changed):
    result = made("nickel", str(unit.path))
    result.source.sha1 = hashlib.sha1(unit.path.read_bytes()).hexdigest()
    result.config = unit.settings.plain()
    result.versions = versions()
    for name, value in changed.items():
        setattr(result, name, value)
    write_result(unit.target, result)


def test_what_is_done_is_known_by_file_settings_and_versions(done):
    assert _done(done) is None
    put(done)
    assert _done(done) is not None
    put(done, versions={"python": "3"})
    assert _done(done) is None
    put(done)
    assert _done(Unit(done.path, done.out, load(posterior=False, seed=5))) is None
    assert _done(Unit(done.path, done.out, load(posterior=True))) is None
    with open(done.path, "r+b") as file:
        file.seek(5000)
        file.write(b"\1")
    assert _done(done) is None
    put(done)
    assert _done(done) is not None
    done.target.write_text(done.target.read_text()[:-200])
    assert _done(done) is None


def test_the_manifest_only_grows_and_survives_a_torn_line(tmp_path):
    unit = units(tmp_path, "nickel")[0]
    first = manifest.Journal(tmp_path)
    first.began(Config(), 2, 1, "Here")
    first.ended(unit.path, Ending.FAILED, None, "nickel.binary: no such file")
    path = tmp_path / manifest.NAME
    path.write_bytes(path.read_bytes() + b'{"at": "2026-')
    second = manifest.Journal(tmp_path)
    second.ended(unit.path, "kept", made("nickel"))
    second.closed(False, 1.0)
    read = list(manifest.lines(tmp_path))
    assert [line.event for line in read] == ["began", "file", "file", "ended"]
    assert (read[1].error, read[2].ended, read[2].status) == ("nickel.binary: no such file", "kept", "CONVERGED")
    assert [json.loads(line)["event"] for line in path.read_text().splitlines() if line.endswith("}")] == [
        line.event for line in read
    ]


def test_a_line_without_an_end_takes_no_memory_and_the_next_ones_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(manifest, "LONGEST", 1000)
    unit = units(tmp_path, "nickel")[0]
    path = tmp_path / manifest.NAME
    manifest.Journal(tmp_path).closed(False, 1.0)
    path.write_bytes(path.read_bytes() + b"x" * 5000)
    manifest.Journal(tmp_path).ended(unit.path, Ending.FAILED, None, "no")
    assert [line.event for line in manifest.lines(tmp_path)] == ["ended", "file"]


def test_a_pipe_in_the_place_of_a_file_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "a.binary")
    with pytest.raises(MerlError, match="is not a regular file"):
        sha1_of(tmp_path / "a.binary")


def test_no_more_processes_than_files_cores_and_memory(monkeypatch):
    assert jobs_for(1) == 1
    assert jobs_for(1000, 1000) == CORES
    assert jobs_for(1000, 1) == 1
    monkeypatch.setattr(processes.psutil, "virtual_memory", lambda: type("Memory", (), {"available": 1}))
    assert jobs_for(1000) == 1


def test_a_folder_that_went_away_does_not_come_back_empty(tmp_path):
    [unit] = units(tmp_path / "gone", "quick-a")
    log(unit.log, "something")
    came = fit_unit(unit)
    assert came.kind is Ending.FAILED
    assert came.error == f"{tmp_path / 'gone'}: is there no more; make it again, and go on with --resume"
    assert not (tmp_path / "gone").exists()
