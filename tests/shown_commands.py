"""What README and docs/ show is run: `python -m tests.shown_commands`.

Commands (blocks ``sh``) and programs (blocks ``python``; ``py`` is an excerpt) are run each one once, in one fresh
folder, in the order of `pages`. Where a block ``text`` follows, its lines should be among what was printed; numbers may
differ. Lines that are not are told, and an error unless `--quick`: the status of a fit is not the same on every
processor. `--rewrite` puts what was printed into these blocks instead. `--install` first installs merlfit, from here
or from the wheel that is named, into an empty environment. `--quick` is a rehearsal: commands fit GGX from one start
on the coarse grid, one file but for the first time, sample short chains, draw with few samples; two pages are run at
once where neither needs the other (`parts`); and what takes minutes all the same is left out, to tests that are
named. README's program is run as it is: the default fit in an empty environment.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL)
SHORT = """
[model]
name = "ggx"
[fit]
starts = 1
grid = "coarse"
[posterior]
max_steps = 20
"""
INSTEAD = {  # what GGX has
    "two-scale,ggx": "smooth,ggx",
    "--fix eta=1.5 --bounds p=0.5:2": "--fix F0=0.04 --bounds alpha=0.01:0.5",
    r"\bbeta\b": "alpha",
    r"\bsigma_s\b": "F0",
    r"\bb=": "albedo=",
}
MORE = {"merlfit sample ": "--max-steps 20", "merlfit render ": "--samples 4", "merlfit fit ": "--config short.toml"}
HASTY = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}  # two thirds of the time, where a program is compiled to run once
MAY_FAIL = "merlfit sample"  # exits with 1 where the chain is still too short, as it does here with so few steps
ELSEWHERE = {  # commands that are not run here, and where they are
    r"make ": "targets of the Makefile; `.ci/run` runs install, lint, types, docs and test",
    r"(pip|uv tool) install ": "--install",
    r"merlfit demo": "make demo",
    r"merlfit cost": "half an hour: make cost",
    r"merlfit fit .*--preset (conserving|free)": "minutes: tests/test_cli.py and make bench",
    r"merlfit fit .*--model auto": "minutes of compiling: tests/fitting/test_fit.py",
    r"dask |merlfit fit .*--executor": "tests/fitting/test_cluster.py",
    r"merlfit fit .*--device gpu": "where there is a GPU: make bench-gpu; on CPUs tests/fitting/test_stacked.py",
    r"merlfit view": "tests/fitting/test_view.py",
    r"python -m merlfit.scene.mitsuba": "tests/scene/test_mitsuba.py",
    r"mitsuba ": "tests/merl_io/test_rgl_writer.py",
}
MINUTES = {  # commands that `--quick` leaves out, and what runs them
    r"merlfit fit .*--accuracy": "tests/fitting/test_accuracy.py",
}
AT_ONCE = 2  # pages of a rehearsal: a command is mostly imports and tracing, which keep one core busy
ONCE = "merlfit: compiling, once"  # and in which folder of this machine: no page shows it
BORDERS, NUMBER = re.compile("[\u2500-\u257f]+"), re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")


@dataclass(frozen=True)
class Shown:
    """A block: its language, its text, and the output that is shown below it, with the place of that in the page."""

    language: str
    text: str
    output: str | None
    place: tuple[int, int]

    @property
    def commands(self) -> list[str]:
        """Lines of a shell's block without comments."""
        lines = (re.sub(r"\s+#.*", "", line).strip() for line in self.text.splitlines())
        return [line for line in lines if line and not line.startswith("#")]


def parts(root: Path = ROOT) -> tuple[list[list[Path]], ...]:
    """README and tutorial, how-tos, the rest: what is in a list is in the order of its pages, lists of a part in none.

    A how-to stands alone, but for those that go on with what README has fitted.
    """
    docs = root / "docs"
    first = [root / "README.md", docs / "tutorial.md"]
    howtos = sorted((docs / "howto").glob("*.md"))
    rest = [page for page in sorted(docs.glob("*.md")) if page not in first]
    return [first], [[page] for page in howtos], [[page] for page in rest]


def pages(root: Path = ROOT) -> list[Path]:
    """README, tutorial, how-tos, the rest."""
    return [page for part in parts(root) for each in part for page in each]


def shown(text: str) -> Iterator[Shown]:
    """Blocks of a page that can be run."""
    for found in BLOCK.finditer(text):
        yield Shown(found[1], found[2], found[3], found.span(3))


def elsewhere(command: str) -> bool:
    """Whether a command is run by something else."""
    return any(re.match(known, command) for known in ELSEWHERE)


def shortened(command: str) -> str:
    """One that does the same in less time; nothing where something else runs it."""
    if any(re.match(known, command) for known in MINUTES):
        return ""
    for name, own in INSTEAD.items():
        command = re.sub(name, own, command)
    if command.startswith("merlfit fit ") and " -o fits " not in f"{command} ":  # as later commands need both
        command = command.replace("*.binary", "nickel.binary")
    return " ".join([command, *(more for start, more in MORE.items() if command.startswith(start))])


def plain(text: str) -> list[str]:
    """Lines without numbers, borders of tables, and how wide they are."""
    return [" ".join(NUMBER.sub("0", BORDERS.sub(" ", line)).split()) for line in text.splitlines()]


def unlike(expected: str, printed: str) -> list[str]:
    """Lines that are shown and were not printed; "..." stands for lines that are left out."""
    there = set(plain(printed))
    return [line for line in plain(expected) if line and line != "..." and line not in there]


def install(folder: Path, what: Path) -> Path:
    """An environment of its own with merlfit in it, by uv where it is there; the folder of its programs."""
    env, uv = folder / "env", shutil.which("uv")
    make = [uv, "venv", "--quiet", "--python", sys.executable, env] if uv else [sys.executable, "-m", "venv", env]
    subprocess.run(make, check=True)
    python = env / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    into = [uv, "pip", "install", "--quiet", "--python", python] if uv else pip
    constraints = ["--constraint", ROOT / "constraints.txt"]
    subprocess.run([*into, *constraints, f"{what.resolve()}[arviz]", "jsonschema"], check=True)
    return env / "bin"


class Runner:
    """Runs blocks in a folder, and remembers what was printed and what failed."""

    def __init__(self, folder: Path, programs_in: Path, quick: bool) -> None:
        self.folder, self.programs_in, self.quick = folder, programs_in, quick
        self.environment = {**os.environ, "PATH": f"{programs_in}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
        self.printed: dict[str, str] = {}
        self.once: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
        self.failed: list[str] = []
        self.differs: list[str] = []
        (folder / "short.toml").write_text(SHORT)
        shutil.copytree(ROOT / "configs", folder / "configs", dirs_exist_ok=True)  # as in a clone

    def output(self, block: Shown, where: str) -> str | None:
        """Run what was not run before; what was printed, or None where what was run is not what is shown."""
        if block.language == "python":
            text = block.text
            if self.quick:
                text = text.replace('"beta"', '"alpha"')  # of the chain that was sampled
            return self._run(text, [self.programs_in / "python", "-c", text], f"a program of {where}")
        found: list[str | None] = []
        for command in block.commands:
            if elsewhere(command):
                found.append(None)
                continue
            line = shortened(command) if self.quick else command
            if not line:
                found.append(None)
                continue
            text = self._run(line, ["sh", "-c", line], f"{where}: {line}")
            found.append(text if line == command else None)
        return None if None in found else "".join(filter(None, found))

    def _run(self, key: str, words: list, said: str) -> str:
        """What is printed; another page that shows the same waits for it."""
        with self.once[key]:
            if key not in self.printed:
                self.printed[key] = self._run_now(key, words, said)
            return self.printed[key]

    def _run_now(self, key: str, words: list, said: str) -> str:
        start = time.perf_counter()
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=self.environment | (HASTY if self.quick and words[0] == "sh" else {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        print(f"$ {said}\n{done.stdout}-> {done.returncode}, {time.perf_counter() - start:.0f} s", flush=True)
        if done.returncode not in ((0, 1) if key.startswith(MAY_FAIL) else (0,)):
            self.failed.append(f"{said}: exit code {done.returncode}")
        return done.stdout


def check(page: Path, runner: Runner) -> None:
    """Run a page and compare."""
    for block in shown(page.read_text()):
        printed = runner.output(block, page.name)
        if block.output is not None and printed is not None:
            runner.differs += [f"{page.name}: {line!r} was not printed" for line in unlike(block.output, printed)]


def rewrite(page: Path, runner: Runner) -> None:
    """Run a page, and put into it what was printed, but where it leaves out lines: that is to be done by hand."""
    text = page.read_text()
    done = [(block, runner.output(block, page.name)) for block in shown(text)]
    for block, printed in reversed(done):
        if block.output is not None and printed is not None and "..." not in block.output.splitlines():
            lines = [line.rstrip() for line in printed.splitlines() if not line.startswith(ONCE)]
            kept = "\n".join(lines).strip("\n") + "\n"
            text = text[: block.place[0]] + kept + text[block.place[1] :]
    page.write_text(text)


def run(folder: Path, programs_in: Path, quick: bool, asked: tuple[list[list[Path]], ...], what=check) -> list[str]:
    """All parts; what failed, in words. What is printed in full is printed page after page."""
    runner = Runner(folder, programs_in, quick)

    def follow(some: list[Path]) -> None:
        for page in some:
            what(page, runner)

    with ThreadPoolExecutor(AT_ONCE if quick else 1) as lanes:
        for part in asked:
            list(lanes.map(follow, part))
    print("\n".join(runner.differs))
    return runner.failed + ([] if quick else runner.differs)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--install", nargs="?", const=ROOT, type=Path, metavar="WHEEL")
    for name in ("--quick", "--rewrite"):
        parser.add_argument(name, action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        programs_in = install(folder, asked.install) if asked.install else Path(sys.executable).parent
        failed = run(folder, programs_in, asked.quick, parts(), rewrite if asked.rewrite else check)
    sys.exit("\n".join(failed) if failed else 0)


if __name__ == "__main__":
    main()
