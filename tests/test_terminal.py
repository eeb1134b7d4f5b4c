"""What commands look like at 80 columns, and the first things that a newcomer types."""

import io
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
import typer.main
from merlfit.fitting import cli
from merlfit.fitting.fitted import Fit
from merlfit.fitting.output.checked import check_table
from merlfit.fitting.output.report import Outcome, print_result, summary_table
from merlfit.fitting.support import compilation, terminal
from merlfit.fitting.support.clock import Stage
from merlfit.fitting.support.terminal import Screen
from merlfit.merl_io.check import FileReport
from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text
from typer.testing import CliRunner

from tests.support.made_results import made

runner = CliRunner()


def screen(width=80):
    return Screen(width=width, file=io.StringIO())


def shown(*objects):
    printed = screen()
    for each in objects:
        printed.print(each)
    text = printed.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    return text


def report(path):
    return FileReport(Path(path), (90, 90, 180), 0.731, 123456, 7, 3, 12, (1234.5, 1187.25, 998.125), "nickel", [])


def test_check_is_readable_at_80_columns():
    text = shown(check_table([report("a/same.binary"), report("b/gold-metallic-paint2.binary")]))
    for word in (
        "a/same.binary",
        "b/gold-metallic-paint2.binary",
        "90x90x180",
        "73.1%",
        "123456",
        "1187",
        "yes: nickel",
    ):
        assert word in text
    assert "…" not in text


def test_the_summary_is_readable_at_80_columns():
    failed = Outcome(Path("x/missing.binary"), None, "x/missing.binary: no such file", bad_input=True)
    outcomes = [Outcome(Path("gold-metallic-paint2.binary"), made("gold-metallic-paint2", posterior=False)), failed]
    text = shown(summary_table(outcomes))
    for word in ("gold-metallic-paint2", "CONVERGED", "missing", "2.5"):
        assert word in text
    assert "bad input" in text
    assert "no such file" not in text  # said on stderr when it happened


def test_inspect_is_readable_at_80_columns():
    printed = screen()
    print_result(printed, made(posterior=True))
    text = printed.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    for word in ("sigma_s", "grazing_exponent", "0.09 .. 0.11", "grazing_exponent_diffracted", "median"):
        assert word in text


def test_a_table_that_fits_is_left_whole():
    table = Table("a", "b", title="whole")
    table.add_row("1", "2")
    text = shown(table)
    assert text.count("a") == 1
    assert "whole" in text


def test_a_divided_table_keeps_every_cell_and_repeats_the_names():
    heads = [f"column {k}" for k in range(12)]
    table = Table(*heads, title="wide")
    table.add_row("the name", *(f"cell {k}" for k in range(1, 12)))
    text = shown(table)
    assert all(f"cell {k}" in text and head in text for k, head in enumerate(heads[1:], 1))
    assert text.count("the name") > 1
    assert text.count("wide") == 1


def commands():
    return typer.main.get_command(cli.app).commands


@pytest.mark.parametrize("name", list(commands()))
def test_no_help_is_eaten_by_markup(name):
    text = " ".join(re.sub("[│╭╰─╮╯]", " ", runner.invoke(cli.app, [name, "--help"]).stdout).split())
    for parameter in commands()[name].params:
        for bracket in re.findall(r"\[[^]]+\]", getattr(parameter, "help", None) or ""):
            assert bracket in text


def test_the_version_is_printed():
    found = runner.invoke(cli.app, ["--version"])
    assert found.exit_code == 0
    assert re.fullmatch(r"merlfit \d+\.\d+\.\d+\n", found.stdout)


def test_it_runs_as_a_module(tmp_path):
    found = subprocess.run(
        [sys.executable, "-m", "merlfit", "--version"], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert found.stdout.startswith("merlfit ")


def test_the_shell_completes_commands(tmp_path):
    words = {"_MERLFIT_COMPLETE": "complete_bash", "COMP_WORDS": "merlfit ins", "COMP_CWORD": "1"}
    found = runner.invoke(cli.app, [], prog_name="merlfit", env=words)
    assert found.stdout.split() == ["inspect"]


def test_errors_stand_clear_of_the_progress_display(monkeypatch):
    """Both on one terminal: the display is taken away, the line printed, the display shown again."""
    both = io.StringIO()
    on_screen = Screen(file=both, force_terminal=True, width=80)
    monkeypatch.setattr(terminal, "console", on_screen)
    monkeypatch.setattr(terminal, "errors", Screen(file=both, width=80))
    with terminal.progress_display() as progress:
        progress.add_task("fitting nickel")
        progress.refresh()
        terminal.fail("other.binary: no such file")
    lines = re.split(r"\r|\n|\x1b\[2K", re.sub(r"\x1b\[(?!2K)[0-9;?]*[a-zA-Z]", "", both.getvalue()))
    assert "merlfit: other.binary: no such file" in lines


@pytest.fixture
def told():
    compilation._mend.cache_clear()
    yield []
    compilation._mend.cache_clear()


def test_a_damaged_program_is_deleted_and_told_once(tmp_path, told, monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", lambda *_: pytest.fail("the warning itself is shown"))
    names = [f"jit_{name}-0123abc-cache" for name in ("first", "second", "other")]
    for name in names:
        (tmp_path / name).write_bytes(b"damaged")
    compilation._mend(tmp_path, told.append)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for name in ("jit_first", "jit_second"):
            warnings.warn(f"Error reading persistent compilation cache entry for '{name}': ZstdError: x", stacklevel=1)
    assert [p.name for p in tmp_path.iterdir()] == names[2:]
    assert told == [f"damaged programs in {tmp_path} were deleted and are compiled again, once"]


def test_jax_is_told_to_compile_once_and_repairs_what_is_damaged(tmp_path):
    program = """
import jax, jax.numpy as jnp
from merlfit.fitting.support.compilation import use_persistent_cache
use_persistent_cache()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((8, 8)))
"""

    def run():
        environment = {"MERLFIT_CACHE_DIR": str(tmp_path), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
        assert done.returncode == 0
        return done.stderr

    first = run()
    assert first.count("merlfit: compiling, once") == 1
    assert run() == ""
    entries = list((tmp_path / "xla").glob("jit_*-cache"))
    for entry in entries:
        entry.write_bytes(entry.read_bytes()[:40])
    repaired = run()
    assert repaired.count("damaged programs") == 1
    assert "Warning" not in repaired
    assert run() == ""


def test_progress_says_how_much_is_done_and_how_long_it_will_take(monkeypatch):
    """At 80 columns, with the longest name; nothing is squeezed."""
    clock = iter(range(0, 10_000, 1))
    shown = terminal.Screen(force_terminal=True, width=80, color_system=None, file=io.StringIO())
    monkeypatch.setattr(terminal, "console", shown)
    with terminal.progress_display() as progress:
        monkeypatch.setattr(progress, "get_time", lambda: float(next(clock)))
        task = progress.add_task("", total=None)
        report = terminal.reporter(progress, task, "[2/100] specular-violet-phenolic")
        report("coarse grid")
        assert progress.tasks[0].total is None
        for share in (0.1, 0.2, 0.3):
            report(Stage(f"posterior: step {6000 * share:.0f} of at most 6000", share))
        found = progress.tasks[0]
        assert (found.total, found.completed) == (1.0, 0.3)
        assert found.time_remaining > 0
        still = Console(width=80, color_system=None, file=io.StringIO())
        still.print(progress.make_tasks_table(progress.tasks))
        (line,) = still.file.getvalue().splitlines()
        assert "specular-violet-phenolic: posterior: step 18" in line
        assert re.search(r"\d:\d\d left$", line.rstrip())
        report(Stage("posterior: step 100 of at most 6000", 0.01))  # the chain began anew
        assert progress.tasks[0].completed == 0.01
        report("writing")
        assert progress.tasks[0].total is None


HOSTILE = "a\x1b]52;c;cm0gLXJm\x07b\x9b2J\r\x7f\u202egnp\u2066:smiley:[red]"


def harmless(text):
    """Without the styles that are rich's own; what is left may hold no code that a terminal obeys."""
    left = re.sub(r"\x1b\[[0-9;]*m", "", text)
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]", left)
    return left


def cell(words):
    table = Table("name", "b", title=words)
    table.add_row(words, Text(words))
    return table


@pytest.mark.parametrize("made", [str, Text, cell, Panel])
def test_no_text_steers_the_terminal(made):
    """Where it stands as a string, as a text of rich's, in a table, in its title: all is seen, nothing obeyed."""
    on = Screen(file=io.StringIO(), force_terminal=True, width=150)
    on.print(made(HOSTILE))
    assert "a␛]52;c;cm0gLXJm" in harmless(on.file.getvalue())
    assert "gnp" in on.file.getvalue()
    assert ":smiley:[red]" in harmless(on.file.getvalue())


def test_an_error_is_one_line_whatever_it_names(monkeypatch):
    monkeypatch.setattr(terminal, "errors", Screen(file=io.StringIO(), force_terminal=True, width=80))
    terminal.note(f"{HOSTILE}\nmerlfit: 100 of 100 succeeded: no such file", style="red")
    (line,) = harmless(terminal.errors.file.getvalue()).splitlines()
    assert line.startswith("merlfit: a␛]52;c;cm0gLXJm␇b")
    assert line.endswith(" merlfit: 100 of 100 succeeded: no such file")


def test_progress_names_files_harmlessly(monkeypatch):
    on = Screen(file=io.StringIO(), force_terminal=True, width=80)
    monkeypatch.setattr(terminal, "console", on)
    with terminal.progress_display() as progress:
        progress.add_task(HOSTILE)
        progress.refresh()
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "", on.file.getvalue())
    assert "a␛]52;c;cm0gLXJm" in harmless(text)


@pytest.mark.parametrize("words", [[HOSTILE], [f"--{HOSTILE}"], ["check", f"--{HOSTILE}"], ["synth", "x", "-o"]])
def test_what_typer_says_of_a_word_is_harmless(words):
    found = runner.invoke(cli.app, words)
    assert found.exit_code == 2
    assert "Error" in harmless(found.stderr)


def test_a_fit_from_anywhere_is_printed_harmlessly():
    result = made(material=HOSTILE, posterior=False)
    result = result.model_copy(
        update={
            "source": result.source.model_copy(update={"origin": HOSTILE, "path": HOSTILE}),
            "fit": result.fit.model_copy(update={"status": HOSTILE, "message": HOSTILE}),
            "parameters": [p.model_copy(update={"name": HOSTILE, "meaning": HOSTILE}) for p in result.parameters],
        }
    )
    fitted = Fit(result, Path(HOSTILE))
    assert "␛]52" in harmless(str(fitted))
    assert "␛]52" in harmless(repr(fitted))
