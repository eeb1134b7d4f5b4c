"""Tests that are not run again while nothing that they look at has changed: `make proofs`.

`python -m tests.proofs GROUP...` runs groups of tests, and enters the digest of their sources into results/proofs.json
if they pass. `make test`, in CI as well, leaves a group out whose sources have this digest; `--left-out` prints the
options of pytest for it. Whoever changes a source, and does not run the group by hand, has it run there.
"""

import argparse
import ast
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
STORE = ROOT / "results" / "proofs.json"
RIVALS = tuple(
    f"tests/rivals/test_{name}.py" for name in ("interfaced_lambertian", "microfacets", "oren_nayar", "rivals")
)
GROUPS: dict[str, tuple[str, ...]] = {
    "fits": tuple(
        f"tests/fitting/test_{name}.py"
        for name in [
            "bands",
            "stacked",
            "coreset",
            "fit",
            "hard_fits",
            "likelihood",
            "objective",
            "projection",
            "starts",
        ]
    ),
    "hard-cases": ("tests/test_hard_cases.py",),
    "models": ("tests/model", *RIVALS, "tests/test_oracles.py"),
    "objective": tuple(
        f"tests/fitting/test_{name}.py" for name in ("models", "problem", "transforms", "trust_region", "weights")
    ),
    "posterior": tuple(f"tests/fitting/test_{name}.py" for name in ("emulator", "posterior")),
    "scenes": ("tests/scene", "tests/sampling"),
}
"""Files of tests, and folders with all tests that are in them."""
EVERYWHERE = ("constraints.txt", "pyproject.toml", "tests/conftest.py", "tests/proofs.py")
COUNTING = (ROOT / "tests" / "budget.py", ROOT / "tests" / "times.py")  # what tests need, and not whether they pass
PACKAGES = {"merlfit": ROOT, "tests": ROOT / "tests"}


def files(group: str) -> list[Path]:
    """All that a group looks at: its tests, what they import, directly or not, and data beside any of these."""
    named = [ROOT / name for name in (*GROUPS[group], *EVERYWHERE)]
    waiting = [path for each in named for path in (each.rglob("*.py") if each.is_dir() else [each])]
    found: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in found or path in COUNTING:
            continue
        found.add(path)
        if path.suffix == ".py":
            waiting += imported(path)
            waiting += (beside for beside in path.parent.iterdir() if beside.suffix in DATA)
    return sorted(found)


DATA = (".json", ".toml", ".npz", ".csv")


def imported(path: Path) -> set[Path]:
    """Files of this project that a file imports, their packages with them."""
    own = _name(path)
    found: set[Path] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = own[: len(own) - node.level + (path.name == "__init__.py")] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        found |= {file for name in names for file in _files_of(name.split("."))}
    return found


def _name(path: Path) -> list[str]:
    inside = path.relative_to(ROOT).with_suffix("").parts
    own = inside if inside[0] == "tests" else ("merlfit", *inside)
    return list(own[:-1] if own[-1] == "__init__" else own)


def _files_of(name: list[str]) -> list[Path]:
    """A module's file and those of the packages that it is in; nothing for what is not of this project."""
    if name[0] not in PACKAGES:
        return []
    folders = [PACKAGES[name[0]].joinpath(*name[1:k]) for k in range(1, len(name) + 1)]
    inits = [folder / "__init__.py" for folder in folders]
    return [path for path in (*inits, folders[-1].with_suffix(".py")) if path.is_file()]


def digest(group: str) -> str:
    """SHA-1 of their names and contents."""
    found = hashlib.sha1()
    for path in files(group):
        content = path.read_bytes()
        found.update(f"{path.relative_to(ROOT)}\0{len(content)}\0".encode() + content)
    return found.hexdigest()


def kept() -> dict[str, dict[str, str | float]]:
    """Of each group, with which sources it passed, when, and how long it took."""
    return json.loads(STORE.read_text()) if STORE.is_file() else {}


def proven() -> list[str]:
    """Groups that have passed with these very sources."""
    return [group for group, entry in kept().items() if group in GROUPS and entry["sources"] == digest(group)]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], help="all of them without a name")
    parser.add_argument("--left-out", action="store_true")
    asked, failed = parser.parse_args(), []
    if asked.left_out:
        for group in proven():
            print(f"left out, passed with these sources on {kept()[group]['passed']}: {group}", file=sys.stderr)
            print(*(f"--ignore={name}" for name in GROUPS[group]))
        return
    for group in asked.groups or GROUPS:
        sources, start = digest(group), time.perf_counter()
        options = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "-m", "not slow"]
        command = [sys.executable, "-m", "pytest", *options, *GROUPS[group]]
        environment = {**os.environ, "CI": "1"}  # in which nothing is skipped for want of data
        if subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode or sources != digest(group):
            failed.append(group)
            continue
        seconds = round(time.perf_counter() - start)
        entry = {"sources": sources, "passed": time.strftime("%Y-%m-%d"), "seconds": seconds}
        STORE.write_text(json.dumps(kept() | {group: entry}, indent=1, sort_keys=True) + "\n")
    sys.exit(f"not proven: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
