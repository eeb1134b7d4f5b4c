"""``merlfit cost``: errors and times of tiers and fits on this machine, section by section.

Every section is measured by a process of its own, so that its memory and what it compiles are its own. What is measured
is written at once (a hidden folder beside the results), and a run that was interrupted goes on from there.
"""

import json
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

from ...merl_io.atomic import write_atomically
from ...merl_io.binary import Measurement, read
from ...merl_io.source import whole
from ..fit.levenberg_marquardt import Status
from ..results.storage import versions
from ..settings.choice import POINTS, REFERENCE, Choice
from ..support.compilation import use_persistent_cache
from ..support.threads import machine
from . import calibration, tiers
from .frontier import LARGEST, OBJECTIVE, Frontier, Percentiles, Point, Tier

Rows = dict[str, dict[str, Any]]  # by section, then by what was measured
Report = Callable[[str], None]
FILES, ERRORS, TIMES = "materials", "errors of tiers", "times of tiers"
WORK, ROWS, MADE_OF = ".merlfit-cost", "rows.json", "made of"


class CostError(RuntimeError):
    """A section that could not be measured; the message says which and why."""


def measure(file: Path | None, out: Path, repeats: int, report: Report) -> Frontier:
    """Everything, on the calibration materials or on one MERL file; what was already measured is kept.

    Raises:
        merlfit.merl_io.binary.MerlError: the file cannot be used.
        CostError: a section failed; what was measured before it stays.
    """
    work = out / WORK
    work.mkdir(parents=True, exist_ok=True)
    known = read(file) if file else None
    materials = [known.name] if known else calibration.names()
    made_of = {"file": known and known.sha1, "repeats": repeats, "machine": machine(), "versions": versions()}
    rows = _kept(work, made_of)
    fits = [str(choice) for choice in (REFERENCE, *POINTS[:-1])]
    sections = [*([] if file else [FILES]), *fits, ERRORS, TIMES]
    for number, section in enumerate(sections, 1):
        wanted = _wanted(section, materials)
        missing = [name for name in wanted if name not in rows.setdefault(section, {})]
        if not missing:
            continue
        label = f"[{number}/{len(sections)}] {section}"
        report(label)
        for done, row in enumerate(_worker(work, section, missing, file, repeats), len(wanted) - len(missing) + 1):
            rows[section].update(row)
            _write(work / ROWS, rows)
            report(f"{label}: {done} of {len(wanted)}")
    return assemble(rows, materials, _data(known) if known else calibration.WHAT)


def tidy(out: Path) -> None:
    """When all that follows from the rows is written: they are kept, what they were made from is not."""
    (out / WORK / ROWS).replace(out / ROWS)
    shutil.rmtree(out / WORK)


def _data(file: Measurement) -> str:
    """What a file is."""
    return f"{file.path.name} alone, " + ("a genuine MERL file" if file.genuine else "not a genuine MERL file")


def _wanted(section: str, materials: list[str]) -> list[str]:
    """What a section is measured on."""
    return {ERRORS: ["all"], TIMES: list(tiers.TIERS)}.get(section, materials)


def _kept(work: Path, made_of: dict[str, Any]) -> Rows:
    """Rows of an interrupted run of the same kind; of another kind nothing is kept."""
    try:
        found = json.loads(whole(work / ROWS, most=LARGEST))
    except (ValueError, RecursionError):
        found = None
    rows = found if isinstance(found, dict) else {}
    if rows.get(MADE_OF) != made_of:
        if MADE_OF not in rows and any(work.iterdir()):
            raise CostError(f"{work}: is not of this command, or damaged: move it, or name another folder with -o")
        shutil.rmtree(work)
        work.mkdir()
        rows = {MADE_OF: made_of}
    return rows


def _write(path: Path, rows: Rows) -> None:
    write_atomically(path, lambda file: file.writelines([json.dumps(rows, indent=1).encode()]))


def _worker(work: Path, section: str, names: list[str], file: Path | None, repeats: int) -> Iterator[Rows]:
    """Rows as a process of its own prints them."""
    job = {"work": str(work), "section": section, "names": names, "file": file and str(file), "repeats": repeats}
    command = [sys.executable, "-m", f"{__package__}.measure", json.dumps(job)]
    with open(work / "errors.txt", "w+") as said:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True) as process:
            try:
                for line in process.stdout or ():
                    yield json.loads(line)
            finally:
                if process.poll() is None:
                    process.terminate()
        if process.returncode:
            said.seek(0)
            last = (said.read().strip().splitlines() or [f"exit code {process.returncode}"])[-1]
            raise CostError(f"{section}: {last}; what was measured is kept in {work}")


def work_on(work: Path, section: str, names: list[str], file: Path | None, repeats: int) -> Iterator[Rows]:
    """The measurements themselves, in the process that makes them."""
    use_persistent_cache()
    files, references = work / "materials", work / "references"
    for name in names:
        if section == FILES:
            yield {name: {"file": str(calibration.make(name, files))}}
        elif section == ERRORS:
            yield {name: tiers.errors()}
        elif section == TIMES:
            yield {name: tiers.times(name, file or calibration.make(calibration.names()[0], files))}
        else:
            choice = next(q for q in POINTS if str(q) == section)
            yield {name: calibration.measure(choice, file or calibration.make(name, files), references, repeats)}


def assemble(rows: Rows, materials: list[str], data: str) -> Frontier:
    """The calibration of all rows."""
    errors = rows[ERRORS]["all"]
    return Frontier(
        objective=OBJECTIVE, data=data, directions=tiers.WHAT, materials=materials, machine=machine(),
        taken=date.today().isoformat(), versions=versions(),
        tiers=[Tier(name=name, error=errors.get(name), **rows[TIMES][name]) for name in tiers.TIERS],
        points=[_point(choice, [rows[str(choice)][name] for name in materials]) for choice in POINTS],
    )  # fmt: skip


def _point(choice: Choice, rows: list[dict[str, Any]]) -> Point:
    """One point of all its rows."""
    column = {key: [row[key] for row in rows] for key in rows[0]}
    pairs = list(zip(column["error"], column["estimate"], strict=True))
    away = [x for x in column["parameters"] if x is not None]
    percentiles = {key: Percentiles.of(column[key]) for key in ("error", "rmse", "seconds", "estimate_seconds")}
    return Point(
        choice=choice, promised=Percentiles.of([max(pair) for pair in pairs]),
        other_minimum=Percentiles.of([error if error > estimated else 0.0 for error, estimated in pairs]).p95,
        failed=sum(not Status[name].succeeded for name in column["status"]) / len(rows),
        other_body=sum(column["other_body"]) / len(rows), parameters=Percentiles.of(away) if away else None,
        megabytes=max(column["megabytes"]), **percentiles,
    )  # fmt: skip


def main(text: str) -> int:
    """What a worker does; its last line on the standard error says what went wrong."""
    job = json.loads(text)
    given = {**job, "work": Path(job["work"]), "file": job["file"] and Path(job["file"])}
    try:
        for found in work_on(**given):
            print(json.dumps(found), flush=True)
    except Exception as error:  # the worker's outermost frame: JAX ends tracebacks with remarks of its own, and the
        # process that waits tells the last line; the rest is in errors.txt
        traceback.print_exc()
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":  # a worker
    sys.exit(main(sys.argv[1]))
