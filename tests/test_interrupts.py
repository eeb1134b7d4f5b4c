"""Stopping a batch, and what it prints going nowhere: whole processes, with a stand-in for the fit."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from merlfit.fitting.posterior.chain import _advance
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.support.terminal import BAD_INPUT, Stopped

ROOT = Path(__file__).parents[1]
PROGRAM = f"""
import os, signal, sys, time
sys.path.insert(0, {str(ROOT)!r})
from tests.support.made_results import made
from merlfit.fitting.commands import cli, fit as files
from merlfit.fitting.batch import here, unit
from merlfit.fitting.results.storage import write_result

def fit(path, out, settings, report, finish, *_):
    report("reading")
    if path.stem == "slow":
        write_result(out / "slow.json", made("slow"))
        print("waiting", file=sys.stderr, flush=True)
        time.sleep(60)
    result = made(path.stem)
    write_result(out / f"{{path.stem}}.json", result)
    return result

unit.fit_file = fit
here.use_persistent_cache = lambda: None
files.executor_of = lambda units, jobs, where: (here.Here(), 1)
# whoever started the tests may have had Ctrl-C ignored, and children inherit that
signal.signal(signal.SIGINT, signal.SIG_IGN if "DEAF" in os.environ else signal.default_int_handler)
cli.main()
"""


def start(out, *names, **streams):
    command = [sys.executable, "-c", PROGRAM, "fit", *(f"{name}.binary" for name in names), "-o", str(out)]
    kinds = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
    environment = {**os.environ, "MERLFIT_CACHE_DIR": str(out / "cache")}
    return subprocess.Popen(command, text=True, env=environment, **kinds)


@pytest.mark.parametrize(("number", "word"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM")])
def test_who_stops_a_batch_is_told_what_is_kept(number, word, tmp_path):
    running = start(tmp_path, "quick", "slow", "later")
    assert running.stderr.readline() == "waiting\n"
    running.send_signal(number)
    printed, said = running.communicate(timeout=30)
    assert running.returncode == 128 + number
    kept = f"{tmp_path}/slow.json"
    assert said == (
        f"merlfit: stopped by {word}: {kept} holds a fit without a posterior; `merlfit sample {kept}` samples it; "
        "not begun: 1 of 3 files; the same command with --resume goes on\n"
    )
    assert "quick" in printed.split("Fits")[1]  # the summary of what is done
    assert read_result(tmp_path / "quick.json").fit.succeeded


def test_stopping_before_anything_is_fitted_is_one_line(tmp_path):
    running = start(tmp_path, "slow")
    assert running.stderr.readline() == "waiting\n"
    (tmp_path / "slow.json").unlink()
    running.send_signal(signal.SIGINT)
    printed, said = running.communicate(timeout=30)
    assert said == "merlfit: stopped by Ctrl-C: slow was not fitted\n"
    assert "Fits" not in printed


def test_who_is_deaf_to_a_signal_stays_so(tmp_path, monkeypatch):
    """As nohup and background jobs are."""
    monkeypatch.setenv("DEAF", "yes")
    running = start(tmp_path, "slow")
    assert running.stderr.readline() == "waiting\n"
    running.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert running.poll() is None
    running.terminate()
    running.communicate(timeout=30)
    assert running.returncode == 128 + signal.SIGTERM


def test_a_pipe_that_is_closed_does_not_cost_the_fits(tmp_path):
    read, write = os.pipe()
    os.close(read)
    running = start(tmp_path, "a", "b", stdout=write)
    os.close(write)
    said = running.communicate(timeout=30)[1]
    assert said == ""
    assert running.returncode == 0
    assert all((tmp_path / f"{name}.json").is_file() for name in "ab")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_behind_standard_output_does_not_cost_the_fits(tmp_path):
    with open("/dev/full", "w") as full:
        running = start(tmp_path, "a", "b", stdout=full)
        said = running.communicate(timeout=30)[1]
    assert said == (
        "merlfit: standard output cannot be written (No space left on device); files are written all the same\n"
    )
    assert running.returncode == 1
    assert all((tmp_path / f"{name}.json").is_file() for name in "ab")


def test_a_name_that_is_no_utf8_keeps_its_fit(tmp_path):
    name = b"caf\xe9".decode("utf-8", "surrogateescape")
    running = start(tmp_path, name)
    printed, said = running.communicate(timeout=30)
    assert said == ""
    assert running.returncode == 0
    assert (tmp_path / f"{name}.json").is_file()
    assert "CONVERGED" in printed


def test_the_sampler_does_not_print_its_walkers_when_it_is_stopped(capsys):
    import emcee
    import numpy as np

    def stopped(points):
        raise Stopped

    now = emcee.State(np.random.default_rng(0).normal(size=(8, 2)), log_prob=np.zeros(8))
    with pytest.raises(Stopped):
        _advance(stopped, [(emcee.moves.StretchMove(), 1.0)], now, 1, lambda *_: None)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("place", "code", "said"),
    [
        ("typer", -signal.SIGINT, ""),  # while the program begins: shells call it 130
        ("jax", 128 + signal.SIGINT, "merlfit: stopped by Ctrl-C; files that were written before are whole\n"),
        ("exit", -signal.SIGINT, ""),
    ],
)
def test_who_stops_it_while_it_begins_or_ends_sees_no_traceback(place, code, said):
    """JAX's extension makes an ImportError of whatever is raised while it is imported."""
    program = f"""
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)

class Stops:
    def find_spec(self, name, path=None, target=None):
        if name == {place!r}:
            sys.meta_path.remove(self)
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                raise ImportError(name) from None

sys.meta_path.insert(0, Stops())
from merlfit.__main__ import main
sys.argv = ["merlfit", "models"]
try:
    main()
finally:
    if {place!r} == "exit":
        atexit.register(os.kill, os.getpid(), signal.SIGINT)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (code, said)


def test_the_command_ends_when_all_is_done_that_waits_for_its_end():
    """Threads are waited for, what is registered is called, what encloses the command goes on, and output is whole."""
    program = """
import atexit, sys, threading, time
from merlfit.__main__ import main
sys.argv = ["merlfit", "check", "no.binary"]
try:
    main()
finally:
    atexit.register(print, "registered")
    threading.Thread(target=lambda: (time.sleep(0.3), print("thread"))).start()
    print("enclosing")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == BAD_INPUT
    assert done.stdout.splitlines()[-3:] == ["enclosing", "thread", "registered"]


def test_without_a_folder_for_programs_a_line_says_so():
    elsewhere = ("MERLFIT_CACHE_DIR", "XDG_CACHE_HOME")
    environment = {k: v for k, v in os.environ.items() if k not in elsewhere} | {"HOME": "/dev/null"}
    program = "import matplotlib.pyplot, jax; from merlfit.fitting.support.compilation import use_persistent_cache"
    program += "; use_persistent_cache(); jax.jit(lambda x: x + 1)(1.0); jax.jit(lambda x: x - 1)(1.0)"
    program = f"import logging; logging.getLogger('matplotlib').setLevel(logging.ERROR); {program}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, env=environment)
    assert done.returncode == 0
    assert done.stderr.startswith("merlfit: compiled programs cannot be kept in /dev/null/")
    assert len(done.stderr.splitlines()) == 1
