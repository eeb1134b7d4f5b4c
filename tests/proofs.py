"""Tests that are not run again while nothing that they look at has changed: `make proofs`.

`python -m tests.proofs GROUP...` runs groups of tests, and enters the digest of their sources into results/proofs.json
if they pass. `make test`, in CI as well, leaves a group out whose sources have this digest; `--left-out` prints the
options of pytest for it. Whoever changes a source, and does not run the group by hand, has it run there.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
STORE = ROOT / "results" / "proofs.json"
EVERYWHERE = ("constraints.txt", "tests/conftest.py", *(f"tests/support/{name}.py" for name in (
    "arrays", "chi_square", "clusters", "compiled", "lobes", "made_results", "worker_tasks"
)))  # fmt: skip
EXECUTION = ("files.py", "execution", "main", "pipeline", "results", "settings", "support")
GROUPS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "clusters": (
        tuple(f"tests/fitting/test_{name}.py" for name in ("cluster", "cluster_faults", "cluster_fits", "slurm")),
        (*(f"fitting/{name}" for name in EXECUTION), "merl_io/atomic.py"),
    ),
    "models": (
        ("tests/model", "tests/rivals", "tests/test_oracles.py", "tests/test_hard_cases.py"),
        ("model", "merl_io", "fitting/support/tables.py", "tests/hard_cases", "tests/oracles", "tests/energy.py"),
    ),
    "objective": (
        tuple(
            f"tests/fitting/test_{name}.py" for name in ("models", "problem", "transforms", "trust_region", "weights")
        ),
        (
            "model",
            "merl_io",
            "fitting/objective",
            "fitting/settings",
            "fitting/solve",
            "tests/oracles",
            "tests/support/plain_jacobian.py",
        ),
    ),
    "scenes": (("tests/scene", "tests/sampling"), ("scene", "model", "merl_io", "tests/oracles")),
}
"""Of each group its tests, and what they look at beside themselves and `EVERYWHERE`: files, and folders with all that
is in them."""


def files(group: str) -> list[Path]:
    """All sources of a group."""
    tests, sources = GROUPS[group]
    named = [ROOT / name for name in (*tests, *sources, *EVERYWHERE)]
    inside = (sorted(path.rglob("*")) if path.is_dir() else [path] for path in named)
    return [path for each in inside for path in each if not path.is_dir() and "__pycache__" not in path.parts]


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
            print(*(f"--ignore={name}" for name in GROUPS[group][0]))
        return
    for group in asked.groups or GROUPS:
        sources, start = digest(group), time.perf_counter()
        options = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "-m", "not slow"]
        command = [sys.executable, "-m", "pytest", *options, *GROUPS[group][0]]
        if subprocess.run(command, cwd=ROOT, check=False).returncode or sources != digest(group):
            failed.append(group)
            continue
        seconds = round(time.perf_counter() - start)
        entry = {"sources": sources, "passed": time.strftime("%Y-%m-%d"), "seconds": seconds}
        STORE.write_text(json.dumps(kept() | {group: entry}, indent=1, sort_keys=True) + "\n")
    sys.exit(f"not proven: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
