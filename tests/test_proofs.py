"""What a group of tests looks at: a change of it, however far away, has the group run again."""

import json

import pytest

from tests import proofs

SOURCES = {
    "model/__init__.py": "",
    "model/a.py": "from . import b\nfrom ..scene.c import value\n",
    "model/b.py": "",
    "model/other.py": "",
    "scene/__init__.py": "",
    "scene/c.py": "def late():\n    import merlfit.model.d\n",
    "scene/table.json": "{}",
    "model/d.py": "",
    "tests/test_x.py": "import numpy\nfrom merlfit.model import a\n",
}
UNSEEN = "model/other.py"


@pytest.fixture
def tree(tmp_path, monkeypatch):
    for name, text in SOURCES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for name, value in {
        "ROOT": tmp_path, "PACKAGES": {"merlfit": tmp_path, "tests": tmp_path / "tests"}, "EVERYWHERE": (),
        "GROUPS": {"x": ("tests/test_x.py",)}, "STORE": tmp_path / "proofs.json",
    }.items():  # fmt: skip
        monkeypatch.setattr(proofs, name, value)
    return tmp_path


def test_all_that_is_imported_is_looked_at(tree):
    found = {str(path.relative_to(tree)) for path in proofs.files("x")}
    assert found == set(SOURCES) - {UNSEEN}


@pytest.mark.parametrize("changed", [*SOURCES])
def test_a_change_of_a_source_has_its_group_run_again(changed, tree):
    (tree / "proofs.json").write_text(json.dumps({"x": {"sources": proofs.digest("x")}}))
    assert proofs.proven() == ["x"]
    with open(tree / changed, "a") as file:
        file.write("\n")
    assert proofs.proven() == (["x"] if changed == UNSEEN else [])


def test_what_was_renamed_is_told(monkeypatch):
    monkeypatch.setitem(proofs.GROUPS, "x", ("tests/test_that_was.py",))
    with pytest.raises(FileNotFoundError):
        proofs.digest("x")
