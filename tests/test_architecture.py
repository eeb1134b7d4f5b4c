"""Who may import whom: data and physics do not know each other, inference knows both."""

import ast
import tomllib
from pathlib import Path

import pytest

from tests import proofs

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "model": {"model"}, "merl_io": {"merl_io"}, "scene": {"model", "merl_io", "scene"},
    "fitting": {"model", "merl_io", "scene", "fitting"},
}  # fmt: skip
LIBRARIES = {
    "model": {"jax", "numpy", "equinox", "jaxtyping"}, "merl_io": {"numpy"},
    "scene": {"jax", "numpy", "equinox", "scipy", "pydantic", "PIL", "OpenEXR", "OpenImageIO", "mitsuba", "drjit"},
}  # fmt: skip
STANDARD = {
    "abc", "argparse", "array", "collections", "contextlib", "dataclasses", "difflib", "enum", "functools", "hashlib",
    "importlib", "inspect", "itertools", "json", "math", "numbers", "operator", "os", "pathlib", "re", "secrets",
    "stat", "struct", "sys", "tempfile", "threading", "time", "tomllib", "types", "typing", "zipfile", "csv", "io",
    "fcntl",
}  # fmt: skip


def imports(path, package):
    """(own packages, libraries) that a file imports."""
    own, other = set(), set()
    depth = len(path.parts) - path.parts.index(package) - 1
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            if node.level <= depth:
                own.add(package)
            else:
                own |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            other.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            other |= {a.name.split(".")[0] for a in node.names}
    return own, other


@pytest.mark.parametrize("package", ALLOWED)
def test_arrows_of_the_architecture(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        own, other = imports(path, package)
        assert own <= ALLOWED[package], f"{path} imports {own - ALLOWED[package]}"
        assert "merlfit" not in other, f"{path} imports its own distribution absolutely"
        if package in LIBRARIES:
            assert other <= LIBRARIES[package] | STANDARD, f"{path} imports {other - LIBRARIES[package] - STANDARD}"


LINE_OF_WORK = (
    "support", "settings", "results", "fit", "posterior", "pipeline", "show", "view", "cost", "batch",
    "commands",
)  # fmt: skip


def uses(path):
    """Parts of ``fitting`` that a file of one of them imports: of its own one, of those beside it, or of none ("")."""
    own, found = path.parent.name, set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            found.add(own)
        elif isinstance(node, ast.ImportFrom) and node.level == 2:
            found |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
    return found


def test_no_arrow_points_back_along_the_line_of_work():
    """A part of ``fitting`` uses itself and parts before it; only files beside all parts know all of them."""
    folders = {path.parent.name for path in (ROOT / "fitting").glob("*/__init__.py")} - {"main"}
    assert folders == set(LINE_OF_WORK)
    for place, part in enumerate(LINE_OF_WORK):
        for path in (ROOT / "fitting" / part).glob("*.py"):
            assert uses(path) <= set(LINE_OF_WORK[: place + 1]), path


def test_no_file_imports_itself_by_way_of_others():
    """Not for type checkers either: `TYPE_CHECKING` hides a circle from the interpreter, not from who reads."""
    files = {path for top in ALLOWED for path in (ROOT / top).rglob("*.py") if path.parent.name != "main"}
    waiting = {path: proofs.imported(path) & files - {path} for path in files if path.name != "__init__.py"}
    waiting = {path: {other for other in others if other.name != "__init__.py"} for path, others in waiting.items()}
    while free := {path for path, others in waiting.items() if not others & waiting.keys()}:
        waiting = {path: others for path, others in waiting.items() if path not in free}
    assert not waiting, sorted(str(path.relative_to(ROOT)) for path in waiting)


def test_every_package_is_installed():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    there = [p.parent for top in ALLOWED for p in (ROOT / top).rglob("__init__.py") if p.parent.name != "main"]
    assert set(declared) == {"merlfit", *(".".join(("merlfit", *p.relative_to(ROOT).parts)) for p in there)}


def test_the_line_of_work_test_sees_an_arrow_back(tmp_path):
    wrong = tmp_path / "fit" / "wrong.py"
    wrong.parent.mkdir()
    for line, seen in (
        ("from ..posterior.chain import begin", {"posterior"}), ("from .. import api", {"api"}),
        ("from .weights import within", {"fit"}), ("from ...model import body", set()),
    ):  # fmt: skip
        wrong.write_text(line)
        assert uses(wrong) == seen


def test_oracles_know_nothing_of_what_they_judge():
    files = sorted((ROOT / "tests" / "oracles").rglob("*.py"))
    assert len(files) > 20
    for path in files:
        own, other = imports(path, "oracles")
        assert own <= {"oracles"}, f"{path} imports {own - {'oracles'}}"
        assert not other & {"merlfit", "jax"}, f"{path} imports {other & {'merlfit', 'jax'}}"


def test_the_arrows_test_sees_a_forbidden_import(tmp_path):
    cases = (
        ("model/wrong.py", "from ..merl_io.binary import read"),
        ("model/rivals/wrong.py", "from ... import fitting"),
    )
    for place, line in cases:
        wrong = tmp_path / place
        wrong.parent.mkdir(parents=True, exist_ok=True)
        wrong.write_text(line + "\nimport scipy\n")
        own, other = imports(wrong, "model")
        assert not own <= ALLOWED["model"]
        assert not other <= LIBRARIES["model"] | STANDARD
