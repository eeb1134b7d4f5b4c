"""Where the time of the tests goes: `MERLFIT_TEST_TIMES=FOLDER make test`, then `python -m tests.times FOLDER...`.

A worker writes for each test what it took, its fixtures with it: seconds by the clock and of processors (user and
system, children's too), programs that were compiled and that were read from the cache, the seconds of both, those
that reading saved, and the programs of the test alone, without its fixtures, of which a file has the most of a test.
The command prints a table by file; of two or more folders, side by side. `--keep` enters what the files of the first
folder took into results/test_times.json, by which the dearest are run first.
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import jax
import pytest

SPENT = pytest.StashKey[int]()  # programs of a test without its fixtures, as tests/budget.py counts them
STORE = Path(__file__).parents[1] / "results" / "test_times.json"
PARTS = ("clock", "cpu", "compiled", "compile_s", "read", "saved_s", "trace_s")
COMPILED, READ = "/jax/compilation_cache/cache_misses", "/jax/compilation_cache/cache_hits"
COMPILING = "/jax/core/compile/backend_compile_duration"  # reading counts as well
SAVED = "/jax/compilation_cache/compile_time_saved_sec"  # what programs took that were read, less the reading
TRACING = ("/jax/core/compile/jaxpr_trace_duration", "/jax/core/compile/jaxpr_to_mlir_module_duration")


class Times:
    """A plugin of pytest that writes what tests took into a folder: {test: {part: number}}."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.so_far, self.taken = folder, Counter(), {}
        jax.monitoring.register_event_listener(self._count)
        jax.monitoring.register_event_duration_secs_listener(self._add)

    def _count(self, event, **_):
        self.so_far["compiled"] += event == COMPILED
        self.so_far["read"] += event == READ

    def _add(self, event, seconds, **_):
        self.so_far["compile_s"] += seconds * (event == COMPILING)
        self.so_far["saved_s"] += seconds * (event == SAVED)
        self.so_far["trace_s"] += seconds * (event in TRACING)

    def _now(self):
        return Counter({**self.so_far, "clock": time.perf_counter(), "cpu": sum(os.times()[:4])})

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """Setting up and tearing down what tests share is of the first and of the last of them."""
        before = self._now()
        try:
            return (yield)
        finally:
            now = self._now()
            taken = {part: round(now[part] - before[part], 3) for part in PARTS}
            self.taken[item.nodeid] = {**taken, "most": item.stash.get(SPENT, 0)}

    def pytest_sessionfinish(self):
        """A file for each process that ran tests."""
        if self.taken:
            self.folder.mkdir(parents=True, exist_ok=True)
            worker = os.environ.get("PYTEST_XDIST_WORKER", "alone")
            (self.folder / f"{worker}-{os.getpid()}.json").write_text(json.dumps(self.taken, indent=0))


def kept() -> dict[str, float]:
    """Seconds of processors of each file, as last measured and committed."""
    return json.loads(STORE.read_text()) if STORE.is_file() else {}


def read(folder: Path) -> dict[str, dict[str, float]]:
    """What all processes wrote, by test."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        found |= json.loads(path.read_text())
    return found


def by_file(taken: dict[str, dict[str, float]]) -> dict[str, Counter]:
    """Sums over the tests of a file, with their number, and the most programs of a test."""
    found: dict[str, Counter] = {}
    for test, parts in taken.items():
        file = test.split("::")[0]
        found[file] = together([found.get(file, Counter()), Counter({"tests": 1, **parts})])
    return found


def together(rows: Iterable[Counter]) -> Counter:
    """Sums, and the most of "most"."""
    rows = list(rows)
    found = sum(rows, Counter())
    found["most"] = max((row["most"] for row in rows), default=0)
    return found


def markdown(folders: list[Path]) -> str:
    """A row a file, the dearest of the first folder first; clock and processors of each folder."""
    found = [by_file(read(folder)) for folder in folders]
    files = sorted(set().union(*found), key=lambda file: -max(each.get(file, Counter())["cpu"] for each in found))
    parts = ("tests", "clock", "cpu", "compiled", "read", "most", "saved_s")
    heads = [f"{folder.name}: {part}" for folder in folders for part in parts]
    lines = [f"| file | {' | '.join(heads)} |", f"|---{'|---:' * len(heads)}|"]
    totals = [together(each.values()) for each in found]
    for name, rows in (("all", totals), *((file, [each.get(file, Counter()) for each in found]) for file in files)):
        cells = [f"{row[part]:.0f}" for row in rows for part in parts]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--tests", type=int, default=0, help="the dearest tests of the first folder, so many")
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    print(markdown(asked.folders))
    if asked.keep:
        measured = {file: round(parts["cpu"], 1) for file, parts in by_file(read(asked.folders[0])).items()}
        STORE.write_text(json.dumps(dict(sorted({**kept(), **measured}.items())), indent=1) + "\n")
    taken = sorted(read(asked.folders[0]).items(), key=lambda each: -each[1]["cpu"])
    for test, parts in taken[: asked.tests]:
        print(test, parts)


if __name__ == "__main__":
    main()
