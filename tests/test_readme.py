"""README and docs/: their commands can be parsed, each is run somewhere, their links lead somewhere."""

import re
import shlex
import sys
import tomllib
from importlib.metadata import metadata, version

import pytest
import typer.main
import yaml
from merlfit.fitting.commands import cli
from merlfit.fitting.settings.config import Replaced, load
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale
from packaging.specifiers import SpecifierSet

from tests import shown_commands
from tests.shown_commands import ROOT, shown

README = (ROOT / "README.md").read_text()
SHOWN = [(page, block) for page in shown_commands.pages() for block in shown(page.read_text())]
COMMANDS = sorted({command for _, block in SHOWN if block.language == "sh" for command in block.commands})
OURS = [command for command in COMMANDS if command.startswith("merlfit ") and " --install-completion" not in command]


@pytest.mark.parametrize("command", [c for c in OURS if not c.startswith("merlfit --")])
def test_every_command_and_option_that_is_shown_exists(command):
    _, name, *words = shlex.split(command)
    known = typer.main.get_command(cli.app).commands
    assert known[name].make_context(name, words).info_name == name, "it refuses what it does not know"


def test_every_command_has_a_page_that_shows_it():
    known = set(typer.main.get_command(cli.app).commands)
    assert known == {path.stem for path in (ROOT / "docs" / "howto").glob("*.md")} - {"index"}
    for name in known:
        blocks = shown((ROOT / "docs" / "howto" / f"{name}.md").read_text())
        assert any(command.startswith(f"merlfit {name}") for block in blocks for command in block.commands), name


def test_every_command_is_run_here_or_by_something_that_is_named():
    unknown = [c for c in COMMANDS if not c.startswith("merlfit ") and not shown_commands.elsewhere(c)]
    assert unknown == [], "nothing runs them"
    for pattern in (*shown_commands.ELSEWHERE, *shown_commands.MINUTES):
        assert any(re.match(pattern, command) for command in COMMANDS), f"no page shows {pattern}"


def test_no_command_hides_in_a_block_of_another_language():
    for page in shown_commands.pages():
        fenced = re.sub(r"^```(sh|text)\n.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^ {4}(?:merlfit|python|pip|make) .*$|^\$ .*$", fenced, re.MULTILINE), page


def test_version_module_and_completion_are_named():
    text = README + (ROOT / "docs" / "howto" / "index.md").read_text()
    known = {word for each in typer.main.get_command(cli.app).params for word in each.opts}
    for word in ("--version", "--install-completion"):
        assert word in text
        assert word in known
    assert "python -m merlfit" in text


SHORTENED = [c for c in OURS if not shown_commands.elsewhere(c)]


@pytest.mark.parametrize("command", [c for c in SHORTENED if "short.toml" in shown_commands.shortened(c)])
def test_the_settings_that_shorten_a_fit_are_no_reason_to_refuse_it(command):
    known = typer.main.get_command(cli.app).commands["fit"]
    _, _, *words = shlex.split(shown_commands.shortened(command))
    given = known.make_context("fit", words).params
    found = load(
        tomllib.loads(shown_commands.SHORT), **{name: given[name] for name in Replaced.__annotations__ if name in given}
    )
    assert found.posterior.max_steps == 20


def test_every_parameter_is_explained():
    every = {q.name for e in (Measured(TwoScale("none")), TwoScale("lambert")) for q in e.parameters}
    rows = re.findall(r"^(\|[^|]*\|).*Eq\. ", (ROOT / "docs" / "parameters.md").read_text(), re.MULTILINE)
    assert every == set(re.findall(r"`([a-z_]+)`", "".join(rows)))


def test_the_citation_is_of_this_version_and_these_authors():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    said = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert [said[key] for key in ("title", "version", "license")] == [
        project[k] for k in ("name", "version", "license")
    ]
    assert said["authors"] == project["authors"]


def test_what_is_pinned_installs_on_the_oldest_python_that_the_readme_names():
    """A release of Python 3.11 that is newer hid a pin that needs 3.11.5, which Debian 12, with 3.11.2, cannot have."""
    oldest = re.search(r"You need Python (\d+\.\d+) or newer", README)[1]
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"] == f">={oldest}"
    pins = [line.split("==") for line in (ROOT / "constraints.txt").read_text().split()]
    assert {name: version(name) for name, _ in pins} == {name: pinned for name, pinned in pins}
    asked = {name: metadata(name).json.get("requires_python", "") for name, _ in pins}
    assert {name: said for name, said in asked.items() if not SpecifierSet(said).contains(f"{oldest}.0")} == {}


def test_links_of_the_readme_lead_to_files():
    """Those of the other pages are looked at when the pages are built."""
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("https://") or (ROOT / target).exists(), target


TEXT = """```sh
merlfit check missing.binary  # fast
```

```text
missing.binary: no such fool
```

```sh
merlfit check missing.binary  # not once more
pip install .
```

```python
print("7.25 │ here")
```

```text
1.5 here
```
"""


def test_what_fails_and_what_is_not_printed_is_named(tmp_path, capsys):
    page, programs = tmp_path / "page.md", shown_commands.Path(sys.executable).parent
    page.write_text(TEXT)
    one, other = shown_commands.run(tmp_path, programs, False, ([[page]],))
    assert one == "page.md: merlfit check missing.binary: exit code 2"
    assert other.startswith("page.md: 'missing.binary: no such fool'")
    capsys.readouterr()
    assert shown_commands.run(tmp_path, programs, True, ([[page]],)) == [one]  # what was not printed is told alone
    assert other in capsys.readouterr().out


def test_what_was_printed_is_put_into_a_page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(TEXT)
    shown_commands.run(tmp_path, shown_commands.Path(sys.executable).parent, True, ([[page]],), shown_commands.rewrite)
    assert "no such file" in page.read_text()
    assert page.read_text().endswith("```text\n7.25 │ here\n```\n")


def test_the_tests_that_the_newcomers_table_names_exist():
    found = re.findall(r"`(tests/[\w/]+\.py)::(\w+)", (ROOT / "tests" / "newcomer.md").read_text())
    assert len(found) > 60
    for file, name in found:
        assert f"def {name}(" in (ROOT / file).read_text(), f"{file}::{name}"
