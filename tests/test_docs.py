"""The pages of docs/: what their checks see, and what their own directives make."""

import json
import re
import subprocess
import sys

import pytest

from tests.shown_commands import ROOT

sys.path.insert(0, str(ROOT / "docs" / "extensions"))
import schema_tables


def built(folder, text):
    """A page of its own with the settings of docs/: exit code and what was said."""
    source = folder / "docs"
    source.mkdir()
    (source / "index.md").write_text(text)
    words = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", ROOT / "docs", folder, folder / "out"]
    done = subprocess.run(words, capture_output=True, text=True)
    return done.returncode, done.stderr


def test_a_page_needs_no_script_and_no_network_for_its_equations(tmp_path):
    code, said = built(tmp_path, "# Page\n\n```math\nf = \\frac{2}{\\lambda}\n```\n\n```{command} check\n```\n")
    assert code == 0, said
    page = (tmp_path / "out" / "docs" / "index.html").read_text()
    assert "<mfrac>" in page
    assert "merlfit check" in page
    assert 'src="http' not in page
    assert 'rel="stylesheet" type="text/css" href="http' not in page


def test_from_the_first_page_to_the_page_of_a_material_in_two_clicks(tmp_path):
    first = (ROOT / "docs" / "index.md").read_text()
    code, said = built(tmp_path, f"# Page\n\n{re.search('<a .*?</a>', first)[0]}\n")
    assert code == 0, said
    page = tmp_path / "out" / "docs" / "index.html"
    for link in (r'href="(report/[^"]+)"', r'<th scope="row"><a href="(materials/nickel[^"]*)"'):
        page = page.parent / re.search(link, page.read_text())[1]
    assert "<h1>nickel</h1>" in page.read_text()
    assert (page.parent / re.search('<img src="([^"]+)"', page.read_text())[1]).is_file()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[there](nowhere.md)", "nowhere.md"), ("[there](#nothing)", "nothing"), ("![seen](none.png)", "none.png"),
        ("[schema](../result.json)", "result.json"),
    ],
)  # fmt: skip
def test_a_dead_link_fails_the_build(tmp_path, text, named):
    code, said = built(tmp_path, f"# Page\n\n{text}\n")
    assert code != 0
    assert named in said


def test_the_page_of_the_schema_has_every_field():
    schema = json.loads((ROOT / "fitting" / "results" / "result.schema.json").read_text())
    text = "\n".join(schema_tables.page(schema))
    for name, part in {"Result": schema, **schema["$defs"]}.items():
        assert f"## {name}" in text
        assert all(f"| `{field}` |" in text for field in part.get("properties", ()))
