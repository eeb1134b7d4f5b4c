"""How simple the code is, in numbers: `python -m tests.structure [REVISION]`; `--keep` writes results/structure.md.

Lines, files, classes and constants of the product; rooms of `fitting/` on top of each other; files that import each
other in a circle; members that a reflectance model may have; and the functions of ours from `merlfit.fit` to the
distribution of normals, counted while a fit of a small synthetic table runs.
"""

import argparse
import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
BEFORE = "fccd9b7"
PRODUCT = ("model", "merl_io", "scene", "fitting")
ASKED = {
    "lines": 19000, "files": None, "classes": 160, "constants of modules": None, "rooms above each other": 9,
    "files in circles": 0, "members of a model": 6, "lines of GGX": 40, "lines of Oren-Nayar": 35,
    "functions from merlfit.fit to epd": 12,
}  # fmt: skip
"""What is counted, and what was asked of it."""
STORE = ROOT / "results" / "structure.md"


def counted(root: Path) -> dict[str, int]:
    """All numbers that the sources of a checkout give."""
    files = sorted(path for top in PRODUCT for path in (root / top).rglob("*.py"))
    trees = {path: ast.parse(path.read_text()) for path in files}
    uses = {path: _imported(path, trees[path], root) for path in files}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    return {
        "lines": sum(len(path.read_text().splitlines()) for path in files),
        "files": len(files),
        "classes": sum(isinstance(node, ast.ClassDef) for node in nodes),
        "constants of modules": sum(_constants(tree) for tree in trees.values()),
        "rooms above each other": _levels(uses, root / "fitting"),
        "files in circles": len(_in_circles(uses)),
        "members of a model": _members(trees[root / "model" / "reflectance.py"]),
        "lines of GGX": len((root / "model" / "rivals" / "ggx.py").read_text().splitlines()),
        "lines of Oren-Nayar": len((root / "model" / "rivals" / "oren_nayar.py").read_text().splitlines()),
    }


def _constants(tree: ast.Module) -> int:
    """Names in capitals that a module sets."""
    targets = [
        target
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]
    names = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return sum(name.id.isupper() for name in names)


def _members(tree: ast.Module) -> int:
    """Methods and properties of `Reflectance` without those of Python."""
    (model,) = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Reflectance"]
    return sum(isinstance(node, ast.FunctionDef) and not node.name.startswith("__") for node in model.body)


def _imported(path: Path, tree: ast.Module, root: Path) -> set[Path]:
    """Files of the product that a file imports by relative imports, for type checkers as well."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            base = base if node.module else path.parents[node.level - 1]
            found |= {base.with_suffix(".py"), *((base / alias.name).with_suffix(".py") for alias in node.names)}
    return {other for other in found if other.is_file() and other != path and root in other.parents}


def _in_circles(uses: dict[Path, set[Path]]) -> set[Path]:
    """Files that import themselves by way of others."""
    return {path for path in uses if path in _reached(uses, path)}


def _reached(uses: dict[Path, set[Path]], start: Path) -> set[Path]:
    found: set[Path] = set()
    waiting = set(uses.get(start, ()))
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting |= uses.get(path, set())
    return found


def _levels(uses: dict[Path, set[Path]], folder: Path) -> int:
    """Length of the longest chain of rooms, each of which uses the next: folders, and files beside them."""

    def room(path: Path) -> Path:
        return path if path.parent == folder else folder / path.relative_to(folder).parts[0]

    inside = [
        path for path in uses if folder in path.parents and path.parent.name != "main" and path.stem != "__init__"
    ]
    rooms: dict[Path, set[Path]] = {room(path): set() for path in inside}
    for path in inside:
        rooms[room(path)] |= {room(other) for other in uses[path] if other in inside} - {room(path)}
    heights: dict[Path, int] = {}

    def height(place: Path, above: tuple[Path, ...] = ()) -> int:
        if place not in heights:
            below = [height(other, (*above, place)) for other in rooms[place] - {*above, place}]
            heights[place] = 1 + max(below, default=0)
        return heights[place]

    return max(map(height, rooms))


FRAMES = """
import sys
import numpy as np
from merlfit.model import terms
import merlfit
from tests.support.scattered_arrays import directions

fewest, own = [], ("/model/", "/merl_io/", "/scene/", "/fitting/")
before = terms.epd

def epd(*given):
    frame, names = sys._getframe(1), []
    while frame:
        name = frame.f_code.co_filename
        if any(part in name for part in own) and "site-packages" not in name and "<" not in frame.f_code.co_name:
            names.append(frame.f_code.co_name)
        frame = frame.f_back
    if "fit" in names:
        fewest.append(len(names) - names[::-1].index("fit"))
    return before(*given)

terms.epd = epd
where, arrays = directions(400, seed=1)
values = np.full((400, 3), 0.1) + np.exp(-np.asarray(where.theta_h)[:, None] ** 2 / 0.01)
settings = {"effects": {"preset": "microfacet"}, "fit": {"starts": 1, "coarse_steps": 2, "max_steps": 2}}
merlfit.fit({**arrays, "values": values}, settings=settings, index="real", body="lambert")
print(min(fewest))
"""


def frames(root: Path) -> int:
    """Functions of ours on the stack where the distribution of normals is asked for, from `merlfit.fit` on."""
    done = subprocess.run([sys.executable, "-c", FRAMES], cwd=root, capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1])


def of_revision(revision: str) -> dict[str, int]:
    """The same of a commit, but for what a run would show."""
    archive = subprocess.run(["git", "archive", revision, *PRODUCT], cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(folder, filter="data")
        return counted(Path(folder))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("revision", nargs="?", default=BEFORE, help="what is compared with")
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    before, now = of_revision(asked.revision), counted(ROOT) | {"functions from merlfit.fit to epd": frames(ROOT)}
    head = ["# How simple the code is", "", f"Made by `python -m tests.structure {asked.revision} --keep`.", ""]
    rows = [f"| | {asked.revision} | now | asked |", "|---|---:|---:|---:|"] + [
        f"| {name} | {before.get(name, '-')} | {now[name]} | {'-' if aim is None else aim} |"
        for name, aim in ASKED.items()
    ]
    print("\n".join(rows))
    if asked.keep:
        STORE.write_text("\n".join([*head, *rows]) + "\n")


if __name__ == "__main__":
    main()
