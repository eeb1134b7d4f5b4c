"""What commands look like at 80 columns, and the first things that a newcomer types."""

import dataclasses
import io
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import typer.main
from merlfit.fitting import fit_object as fitted
from merlfit.fitting.commands import cli
from merlfit.fitting.commands.catalogue import models_table
from merlfit.fitting.commands.checked import check_table, scattered_table
from merlfit.fitting.commands.demo import EFFECTS, truth_table
from merlfit.fitting.commands.metrics import Assessed, metrics_table
from merlfit.fitting.commands.scenes import plan_tables
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit_object import Fit
from merlfit.fitting.pipeline.comparison import Row
from merlfit.fitting.pipeline.synthesis import describe_sources
from merlfit.fitting.results import schema
from merlfit.fitting.show.comparison_table import table_of, verdict
from merlfit.fitting.show.pictures import PICTURES
from merlfit.fitting.show.terminal_tables import Outcome, pictures_table, print_result, summary_table
from merlfit.fitting.support import compilation, terminal
from merlfit.fitting.support.clock import Stage
from merlfit.fitting.support.numbers import number
from merlfit.fitting.support.terminal import Screen
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale
from merlfit.scene import effects
from merlfit.scene.description import load
from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text
from typer.testing import CliRunner

from tests.support.made_results import made, quantiles

runner = CliRunner()


def screen(width=80):
    return Screen(width=width, file=io.StringIO(), force_terminal=True, color_system=None)


def shown(*objects):
    printed = screen()
    for each in objects:
        printed.print(each)
    return whole(printed)


def whole(printed):
    """What was printed, of which no line is too long and nothing is left out."""
    text = printed.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    return text


LONGEST = "specular-violet-phenolic"  # of MERL's names
ERRORS = Errors(**{f.name: 0.0123456 for f in dataclasses.fields(Errors)})
DERIVED = schema.DerivedResult(
    name="directional_albedo_10600nm", quantity="directional_albedo", unit="1/sr", channel="10600nm", value=1.234e-5,
    meaning="share of the light at 30 degrees of incidence that the material gives back, without the apparatus's loss",
    quantiles=quantiles(1.234e-5),
)  # fmt: skip


def row(model="interfaced-lambertian", material=LONGEST):
    return Row(
        material, False, model, "real subsurface", "fit", 0.5, "AT_BOUND", 14, ERRORS, 0.00123, -1.2345e4,
        123.4, {},
    )  # fmt: skip


def gridded():
    counts, largest = ("73.1%", "123456", "7", "3", "12"), map(number, (1.2345e-12, 1187.25, 998.125))
    same = "90x90x180", *counts, *largest
    rows = [(f"{k}/{LONGEST}.binary", *same, genuine) for k, genuine in enumerate(("yes: gold-metallic-paint2", "no"))]
    return [check_table(rows)], [f"1/{LONGEST}.binary", "90x90x180", "123456", "1.235e-12", "yes: gold-metallic"]


def scattered():
    row = (
        f"measured/{LONGEST}.csv", "table", "123456", "195 of 2055: 400nm to 1000nm", "98.7%", "0.0 89.9", "0.0 88.8",
        "0.0 77.7", "1.235e-12", "45.1 46.2 359.3",
    )  # fmt: skip
    wanted = [f"measured/{LONGEST}.csv", "123456", "195 of 2055", "400nm to 1000nm", "0.0 89.9", "45.1 46.2 359.3"]
    return [scattered_table([row])], wanted


def summary():
    failed = Outcome(Path("x/missing.binary"), None, "x/missing.binary: no such file", bad_input=True)
    outcomes = [Outcome(Path(f"{LONGEST}.binary"), made(LONGEST, posterior=False)), failed]
    return [summary_table(outcomes)], [LONGEST, "CONVERGED", "missing", "2.5", "bad input"]


def one_result():
    result = made(LONGEST, posterior=True).model_copy(update={"derived": [DERIVED]})
    wanted = ["sigma_s", "grazing_exponent_diffracted", "0.09 .. 0.11", "[0.001, 1]", "median", "falloff exponent"]
    printed = screen()
    print_result(printed, result)
    return [*printed.file.getvalue().splitlines()], [*wanted, "share of the light", DERIVED.name, "1.111e-05"]


def printed_fit():
    return [str(Fit(made(LONGEST), Path("x.json")))], [LONGEST, "falloff exponent", "[0.001, 1]"]


def compared():
    rows = [row(), row("two-scale")]
    wanted = ["interfaced-lambertian", "two-scale", "0.0123", "-1.234e+04", "lamp", "room", "peak"]
    return [table_of(rows), table_of([*rows, row(material="other")]), verdict(rows)], wanted


def of_metrics():
    found = Assessed(Path(f"fits/{LONGEST}.json"), row(), Path("x"), "", np.zeros(0), np.zeros(0))
    wanted = [f"fits/{LONGEST}.json", "sMAPE", "cube-root", "lamp", "theta_h = 0", "0.0123"]
    return [metrics_table([found], Path(f"{LONGEST}.binary"))], wanted


def plans():
    rows = tuple(
        effects.Row(each, kept, 0.000255, together, -353.2)
        for each, kept, together in zip(effects.TWO_SCALE, [True, False] * 5, [0.106, None] * 5, strict=True)
    )
    plan = effects.Plan(LONGEST, TwoScale(), rows, 0.599, 6912, 39330, (804.0, 229.0))
    wanted = [LONGEST, "colour of diffraction", "that of reflection", "6912 of 39330 pixels", "moot", "-353"]
    return plan_tables([plan, plan], load(Path("configs/scenes/metal.toml"))), wanted


def drawn():
    written = {Path(f"fits/{LONGEST}.two-scale.{name}.png"): picture.words for name, picture in PICTURES.items()}
    return [pictures_table(written)], [f"{LONGEST}.two-scale.corner-all.png", "fits"]


def models():
    return [models_table()], ["sgd-microfacet", "diffuse_albedo (RGB)", "10.1111/j.1467-8659.2012.03147.x"]


def published():
    return [describe_sources()], ["color-changing-paint1", "cook-torrance-ngan:", "red-specular-plastic"]


def demonstrated():
    return [truth_table(made("x", posterior=True, model=Measured(EFFECTS, "off")))], ["eta_R", "0.27 .. 0.33"]


MADE = [gridded, scattered, summary, one_result, printed_fit, compared, of_metrics, plans, drawn, models, published]


@pytest.mark.parametrize("made_of", [*MADE, demonstrated])
def test_all_of_it_is_readable_at_80_columns(made_of, monkeypatch):
    monkeypatch.setattr(fitted, "console", screen())
    printed, wanted = made_of()
    text = shown(*printed)
    for words in wanted:
        assert words in text or words in " ".join(text.split())


def test_why_a_file_is_bad_is_said_when_it_happens():
    """And not again in the summary."""
    assert "no such file" not in shown(*summary()[0])


def test_what_is_copied_has_no_break_in_it():
    """Lines end between words on a terminal, and nowhere in a pipe."""
    path = f"/a/{'long/' * 20}path.json"
    on_terminal, piped = screen(), Screen(width=80, file=io.StringIO())
    for each in (on_terminal, piped):
        each.print(f"wrote {path}, {'and more words ' * 10}")
    assert path in on_terminal.file.getvalue()
    assert [len(line) > 80 for line in on_terminal.file.getvalue().splitlines()] == [False, True, False, False]
    assert len(piped.file.getvalue().splitlines()) == 1


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
    """What is compiled at once is not told."""
    program = """
import jax, jax.numpy as jnp, sys
from merlfit.fitting.support import compilation
compilation.SLOW = float(sys.argv[1])
compilation.use_persistent_cache()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((8, 8)))
"""

    def run(slow="0"):
        environment = {"MERLFIT_CACHE_DIR": str(tmp_path), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", program, slow], capture_output=True, text=True, env=environment)
        assert done.returncode == 0
        return done.stderr

    first = run()
    assert first.count("merlfit: compiling, once") == 1
    assert run() == ""
    entries = list((tmp_path / "xla").glob("jit_*-cache"))
    for entry in entries:
        entry.write_bytes(entry.read_bytes()[:40])
    repaired = run("60")
    assert repaired.count("damaged programs") == 1
    assert not re.search("Warning|compiling, once", repaired)
    assert run() == ""


def test_what_is_compiled_is_told_while_it_takes_long(monkeypatch):
    """Programs that were kept are counted, and no reason to speak; stages go on, with the share of programs."""
    programs, told = compilation.Programs(), []
    monkeypatch.setattr(compilation, "_programs", programs)

    def ready(seconds, new):
        if new:
            programs.event(compilation.NEW)
        programs.duration("/jax/core/compile/jaxpr_trace_duration", 9.0)
        programs.duration(compilation.READY, seconds)

    with compilation.programs_told(told.append, of=5) as report:
        report("coarse grid: complex none")
        for seconds, new in ((9.0, False), (1.5, True), (1.0, True), (0.1, False), (20.0, True), (1.0, True)):
            ready(seconds, new)
        report(Stage("posterior: step 9", 0.5))
        ready(1.0, new=True)
    ready(1.0, new=True)
    assert [(str(each), getattr(each, "share", None)) for each in told] == [
        ("coarse grid: complex none", None),
        ("coarse grid: 3 of about 5 programs compiled", 0.6),
        ("coarse grid: 5 of about 5 programs compiled", 1.0),
        ("coarse grid: 6 programs compiled", None),
        ("posterior: step 9", 0.5),
        ("posterior: 7 programs compiled", 0.5),
    ]


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


@pytest.mark.parametrize("is_terminal", [True, False])
def test_an_error_is_one_line_whatever_it_names(is_terminal, monkeypatch):
    """Where it is wrapped none of its further lines looks like another one."""
    monkeypatch.setattr(terminal, "errors", Screen(file=io.StringIO(), force_terminal=is_terminal, width=80))
    terminal.note(f"{HOSTILE}\nmerlfit: 100 of 100 succeeded: no such file", style="red")
    line, *further = harmless(terminal.errors.file.getvalue()).splitlines()
    assert line.startswith("merlfit: a␛]52;c;cm0gLXJm␇b")
    assert "\n".join([line, *further]).endswith("succeeded: no such file")
    assert [each.startswith("  ") for each in further] == [True] * is_terminal


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
