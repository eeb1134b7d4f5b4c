"""``merlfit cost``: errors and times of fits on this machine, section by section.

Every section is measured by a process of its own, so that its memory and what it compiles are its own. What is measured
is written at once (a hidden folder beside the results), and a run that was interrupted goes on from there.
"""

import json
import shutil
from collections.abc import Callable, Iterator
from datetime import date
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...merl_io.atomic import write_text
from ...merl_io.binary import read
from ...merl_io.source import whole
from ..fit.levenberg_marquardt import Status
from ..results.storage import versions
from ..settings.choice import POINTS, REFERENCE, Choice
from ..support.compilation import use_persistent_cache
from ..support.threads import machine
from . import calibration
from .frontier import LARGEST, OBJECTIVE, Frontier, Percentiles, Point

Rows = dict[str, dict[str, Any]]  # by section, then by what was measured
Job = tuple[Path, str, list[str], Path | None, int]  # folder of work, section, names, file, repeats
FILES = "materials"
WORK, ROWS, MADE_OF = ".merlfit-cost", "rows.json", "made of"


class CostError(RuntimeError):
    """A section that could not be measured; the message says which and why."""


def measure(file: Path | None, out: Path, repeats: int, report: Callable[[str], None]) -> Frontier:
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
    sections = [*([] if file else [FILES]), *fits]
    for number, section in enumerate(sections, 1):
        missing = [name for name in materials if name not in rows.setdefault(section, {})]
        if not missing:
            continue
        label = f"[{number}/{len(sections)}] {section}"
        report(label)
        for name, row in _worker((work, section, missing, file, repeats)):
            rows[section][name] = row
            write_text(work / ROWS, json.dumps(rows, indent=1))
            report(f"{label}: {len(rows[section])} of {len(materials)}")
    genuine = "a" if known and known.genuine else "not a"
    data = f"{known.path.name} alone, {genuine} genuine MERL file" if known else calibration.WHAT
    return assemble(rows, materials, data)


def tidy(out: Path) -> None:
    """When all that follows from the rows is written: they are kept, what they were made from is not."""
    (out / WORK / ROWS).replace(out / ROWS)
    shutil.rmtree(out / WORK)


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


def _worker(job: Job) -> Iterator[tuple[str, dict[str, Any]]]:
    """What a process of its own measures, one name after the other; it ends with this one."""
    work, section, names, *_ = job
    spawning = get_context("spawn")
    ours, theirs = spawning.Pipe(duplex=False)
    process = spawning.Process(target=_work, args=(theirs, job), daemon=True)
    process.start()
    theirs.close()
    try:
        for name in names:
            row = ours.recv()
            if isinstance(row, str):
                raise CostError(f"{section}: {row}; what was measured is kept in {work}")
            yield name, row
    except EOFError:
        raise CostError(f"{section}: its process was ended; what was measured is kept in {work}") from None
    finally:
        process.terminate()
        process.join()


def _work(pipe: Connection, job: Job) -> None:
    """In that process: a row a name, and words where it fails."""
    try:
        for _, row in work_on(job):
            pipe.send(row)
    except Exception as error:  # the outermost frame of a process, which another one waits for
        pipe.send(f"{type(error).__name__}: {error}")


def work_on(job: Job) -> Iterator[tuple[str, dict[str, Any]]]:
    """The measurements themselves."""
    work, section, names, file, repeats = job
    use_persistent_cache(lambda _: None)
    files, references = work / "materials", work / "references"
    for name in names:
        if section == FILES:
            yield name, {"file": str(calibration.make(name, files))}
        else:
            choice = next(q for q in POINTS if str(q) == section)
            yield name, calibration.measure(choice, file or calibration.make(name, files), references, repeats)


def assemble(rows: Rows, materials: list[str], data: str) -> Frontier:
    """The calibration of all rows."""
    return Frontier(
        objective=OBJECTIVE, data=data, materials=materials, machine=machine(), taken=date.today().isoformat(),
        versions=versions(),
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
