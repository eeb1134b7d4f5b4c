"""The README: its commands can be parsed, its links lead somewhere, its table of parameters is complete."""

import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
import readme_commands
import typer.main
from merlfit.fitting import cli
from merlfit.fitting.settings.config import Replaced, load
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

TEXT = (readme_commands.ROOT / "README.md").read_text()
FOUND = readme_commands.commands(TEXT)


@pytest.mark.parametrize("command", [command for command, _ in FOUND])
def test_every_command_and_option_of_the_readme_exists(command):
    _, name, *words = shlex.split(command)
    known = typer.main.get_command(cli.app).commands
    assert known[name].make_context(name, words).info_name == name, "it refuses what it does not know"


def test_the_readme_shows_every_command_but_the_demo():
    shown = {command.split()[1] for command, _ in FOUND}
    assert shown == set(typer.main.get_command(cli.app).commands) - {"demo"}


def test_the_readme_names_version_module_and_completion():
    known = {word for each in typer.main.get_command(cli.app).params for word in each.opts}
    for word in ("--version", "--install-completion"):
        assert word in TEXT
        assert word in known
    assert "python -m merlfit" in TEXT


@pytest.mark.parametrize("command", [command for command, _ in FOUND if command.startswith("merlfit fit ")])
def test_the_settings_that_shorten_a_fit_are_no_reason_to_refuse_it(command):
    known = typer.main.get_command(cli.app).commands["fit"]
    _, _, *words = shlex.split(readme_commands.shortened(command))
    given = known.make_context("fit", words).params
    settings = tomllib.loads(readme_commands.SHORT) if given["config"] else None
    found = load(settings, **{name: given[name] for name in Replaced.__annotations__})  # which refuses idle keys
    assert len(found.candidates) == 1, "one model is quick to fit"
    assert found.model.names == (list(given["model"]) or ["two-scale"])


def test_the_readme_says_what_every_parameter_means():
    every = {q.name for e in (Measured(TwoScale("none")), TwoScale("lambert")) for q in e.parameters}
    assert every == set(re.findall(r"`([a-z_]+)`", "".join(re.findall(r"^(\|[^|]*\|).*Eq\. ", TEXT, re.MULTILINE))))


@pytest.mark.parametrize(
    "page",
    [readme_commands.ROOT / "README.md", *sorted((readme_commands.ROOT / "docs").glob("*.md"))],
    ids=lambda page: page.name,
)
def test_links_of_the_pages_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert target.startswith("https://") or (page.parent / target).exists(), target


def test_a_command_that_fails_is_named(tmp_path):
    text = "    merlfit check missing.binary  # fast\n    merlfit materials   # slow\n"
    failed = readme_commands.run(tmp_path, Path(sys.executable).parent, quick=True, text=text)
    assert failed == ["merlfit check missing.binary: exit code 2"]


def test_the_tests_that_the_newcomers_table_names_exist():
    found = re.findall(r"`(tests/[\w/]+\.py)::(\w+)", (readme_commands.ROOT / "docs" / "newcomer.md").read_text())
    assert len(found) > 60
    for file, name in found:
        assert f"def {name}(" in (readme_commands.ROOT / file).read_text(), f"{file}::{name}"
