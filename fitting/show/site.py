"""`merlfit report`: a folder of results as pages that open from disk, without a network."""

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from importlib.resources import files as files_of
from itertools import chain, count
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from ...merl_io.atomic import write_text
from ...model.registry import models, variants
from ..fit.identifiability import in_words
from ..results.schema import Result
from ..results.storage import read_result
from ..show.results_table import UNREADABLE, Row, write_csv
from ..support.clock import Report, silent
from ..support.compilation import use_persistent_cache
from ..support.numbers import counted, number, unit
from ..support.numbers import median as middle
from ..support.outputs import is_ours, refuse_others
from ..support.processes import end_with_parent, jobs_for
from ..support.terminal import why_ended
from . import charts, curves, page_pictures, scans
from .comparison_table import group_of
from .corner import UNITS
from .inspection import file_of
from .prediction import PEAK_DIFFERENCE_DEG
from .sheet import Head, NotPrinted, printed
from .simulated import again, left_out, simulated
from .style import letters
from .subject import Subject, subject_of
from .terminal_tables import accuracy_line, fitted_line, interval, median

FIGURES = {
    "rmse": "RMSE (1/sr)", "smape": "sMAPE", "picture": "CIELAB distance of spheres",
    "lamp": "CIELAB distance of what a lamp lights", "environment": "CIELAB distance under an environment",
    "cube_root": "cube-root error", "log": "log error",
}  # fmt: skip
"""Errors by their name in the table, in words."""
SHOWN = ("material", "status", "model", "variant", "seconds", "highlight", "error")
Page = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A page to make.

    Attributes:
        path: of the result. name: of the page, in ``materials/`` of ``out``. file: of the measurement, if it moved.
        before, after: pages beside it. origin: what the file is, in words, whatever its fit was told.
        head: of the sheet that is printed, if one is.
    """

    path: Path
    out: Path
    name: str
    file: Path | None
    before: str | None
    after: str | None
    origin: str | None = None
    head: Head | None = None


Made = tuple[list[str], bool]
"""Of a page: what there is not on it, and why, a line each; and whether it could not be made, which the line says."""

FOLDERS = ("materials", "pictures", "assets", "sheets")
LONGEST = 200  # bytes of a page's name
FIRST = "<!doctype html><title>merlfit</title><p>These pages are being written, or were not written to the end.\n"


def refuse_foreign(out: Path, force: bool = False) -> None:
    """Leave a folder alone in which somebody has other pages, and say from the beginning whose these are.

    Raises:
        merlfit.merl_io.atomic.WriteError: there is something of a name that pages need.
    """
    index = out / "index.html"
    if not os.path.exists(index) or not is_ours(index):
        refuse_others((index, *(out / name for name in ("compare.html", "table.csv", *FOLDERS))), force)
        write_text(index, FIRST)
    refuse_others([out / "table.csv"], force)


def write_site(
    rows: Sequence[Row], folder: Path, out: Path, files: Path | None = None, jobs: int | None = None,
    say: Report = silent, origin: str | None = None, head: Head | None = None,
) -> list[Made]:  # fmt: skip
    """Pages of all results of a folder; whatever one runs into, the others are made.

    Args:
        rows: of the folder's table. files: folder with the measurements, if they are not where the results say.
        jobs: processes; None for as many as cores and memory allow. say: told which page is done. origin: what the
            files are, in words, if the fits were not told. head: of the sheets that are printed, None for none.

    Returns:
        the pages, as they were done.

    Raises:
        merlfit.merl_io.atomic.WriteError: something cannot be written.
    """
    names = _page_names(rows)
    pages = [name for name in names if name is not None]
    work = {}
    for row, name in zip(rows, names, strict=True):
        if name is not None:
            k = pages.index(name)
            beside = (pages[k - 1] if k else None), (pages[k + 1] if k + 1 < len(pages) else None)
            file = None if files is None else files / Path(str(row["file"])).name
            work[name] = Job(folder / str(row["result"]), out, name, file, *beside, origin, head)
    for place in FOLDERS if head else FOLDERS[:-1]:
        (out / place).mkdir(parents=True, exist_ok=True)
    write_text(out / "assets" / "vega.js", charts.script())
    for asset in ("style.css", "charts.js", "index.js", "compare.js"):
        write_text(out / "assets" / asset, (files_of("merlfit.fitting.show") / "templates" / asset).read_text("utf-8"))
    made: list[Made] = []
    for k, page in enumerate(_made(list(work.values()), jobs_for(len(work), jobs)), 1):
        made.append(page)
        say(f"{k} of {counted(len(work), 'page')}")
    if origin is not None:
        rows = [{**row, "data": f"{origin} (stated, not checked)"} if row["genuine_merl"] == "no" else row
                for row in rows]  # fmt: skip
    shown = [_index_row(row, name, out) for row, name in zip(rows, names, strict=True)]
    write_csv(rows, out / "table.csv")
    write_text(out / "index.html", _index(folder, shown))
    write_text(
        out / "compare.html",
        _templates().get_template("compare.html").render(rows=_with_page(shown), numbers=_json(_compared(shown))),
    )
    return made


def _made(jobs: list[Job], count: int) -> Iterator[Made]:
    """Pages as they are done."""
    if count <= 1:
        yield from map(make_page, jobs)
        return
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=end_with_parent)
    try:
        for done in as_completed([pool.submit(make_page, job) for job in jobs]):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)  # whoever stops it does not wait for all other pages


def make_page(job: Job) -> Made:
    """Write the page of a result, and its pictures; where that fails a page that says so, to which links lead."""
    try:
        return [f"{job.name}: {why}" for why in _page(job)], False
    except NotPrinted as error:
        return [f"{job.name}: {error}"], True
    except Exception as error:  # of any kind: said with its name, and the next page has its turn
        said = why_ended(job.path, error)
        why = f"<!doctype html><title>{escape(job.name)}</title><p>{escape(said)}<p><a href='../index.html'>index</a>\n"
        write_text(_html(job), why)
        return [said], True


def _html(job: Job) -> Path:
    return job.out / "materials" / f"{job.name}.html"


def _page(job: Job) -> list[str]:
    """Write the page of a result, and its pictures; what it lacks, and why."""
    use_persistent_cache()
    result = read_result(job.path)
    if job.origin is not None:
        result.config["input"] = {**result.config.get("input", {}), "origin": job.origin}  # which its page then repeats
    page, lacks = _page_of(job, result), []
    if result.model is not None:
        subject = subject_of(result, job.path, job.file or file_of(job.path, result))
        said = {"measurement": "the file is not shown", "chain": "the posterior is not shown"}
        lacks = [f"{said[what]}: {why}" for what, why in subject.lacks.items() if what != "chain" or result.posterior]
        if subject.scattered is not None and subject.measurement is not None:
            lacks.append("spheres, lobes and isolines of the file are interpolated between its samples")
        page |= _charts(subject) | page_pictures.write(subject, job.out, job.name)
        if "scans" in page["pictures"]:
            page["scans"] = scans.in_numbers(subject)
    page["lacks"] = lacks
    write_text(_html(job), _templates().get_template("material.html").render(page))
    if job.head is not None and result.model is not None:
        sheet = job.out / "sheets" / f"{job.name}.html"
        head = job.head.of(result.source.material)
        write_text(sheet, _templates().get_template("sheet.html").render(page, head=head))
        printed(sheet, sheet.with_suffix(".pdf"))
    return lacks


def _page_of(job: Job, result: Result) -> Page:
    """What is said of a result."""
    m, f = result.model, result.fit
    json_file = os.path.relpath(job.path, job.out / "materials")
    return {
        "result": result, "name": job.name, "before": job.before, "after": job.after, "json": json_file,
        "sheet": None if job.head is None or m is None else f"../sheets/{quote(job.name)}.pdf",
        "json_link": quote(os.fsencode(json_file)), "fitted": None if m is None else fitted_line(m), "number": number,
        "interval": interval, "median": median, "unit": unit, "symbol": letters,
        "spec": {}, "svg": {}, "pictures": {}, "scans": {}, "widths": [],
        "words": [] if result.identifiability is None else in_words(result.identifiability),
        "accuracy": None if result.accuracy is None else accuracy_line(result.accuracy),
        "at_bound": [q.name for q in result.parameters if q.at_bound != "no"],
        "command": again(result),
        "group": group_of(result.source.material), "errors": FIGURES,
        "simulated": simulated(result), "left_out": left_out(result), "candidates": sorted(
            f.candidates, key=lambda c: np.inf if c.score is None else c.score),
    }  # fmt: skip


def _charts(subject: Subject) -> Page:
    """Charts of a result, as specifications and as they are drawn."""
    channels = subject.model.channels
    specs, widths = {"lobes": charts.lobes(*curves.lobe_rows(subject), channels)}, []
    if subject.scattered is None:
        peak, widths, _ = curves.peak(subject)
        specs["peak"] = charts.peak(peak, channels, PEAK_DIFFERENCE_DEG)
    return _embedded(specs) | {"widths": widths}


def _page_names(rows: Sequence[Row]) -> list[str | None]:
    """Of each row's page: its result's path without the ending, once; None where there is nothing to show.

    As far as pictures named after it have names that file systems take.
    """
    names: list[str | None] = []
    for row in rows:
        whole = "--".join(Path(str(row["result"])).with_suffix("").parts)
        name = whole.encode(errors="replace")[:LONGEST].decode(errors="ignore")
        free = (each for each in chain([name], (f"{name}.{k}" for k in count(2))) if each not in names)
        names.append(None if row["result"] is None or row["status"] == UNREADABLE else next(free))
    return names


def _index_row(row: Row, name: str | None, out: Path) -> Page:
    """What the index shows of a result, and what its charts need."""
    small = {kind: f"pictures/{name}.small-{kind}.webp" for kind in ("file", "fit")}
    parameters: Page = {}
    for key in [str(k).removesuffix("_q50") for k in row if str(k).endswith("_q50")]:
        kind = ("low", "high") if row[f"{key}_q50"] is None else ("q05", "q95")
        if row[key] is not None:
            parameters[key] = row[key], *(row[f"{key}_{end}"] for end in kind)
    return {
        **{key: row[key] for key in (*SHOWN, *FIGURES)},
        "group": group_of(str(row["material"])), "cautions": str(row["cautions"] or ""), "data": row["data"],
        "page": None if name is None else f"materials/{quote(name)}.html", "name": name,
        "small": {kind: quote(path) for kind, path in small.items() if (out / path).exists()}, "parameters": parameters,
    }  # fmt: skip


def _with_page(rows: Sequence[Page]) -> list[Page]:
    return [row for row in rows if row["page"] is not None]


def _compared(rows: Sequence[Page]) -> Page:
    """What two results are compared by, of each by the name of its page."""
    return {
        row["name"]: {
            "words": {key: row[key] for key in ("material", "model", "variant", "status", "data")},
            "errors": {said: row[key] for key, said in FIGURES.items()} | {"seconds": row["seconds"]},
            "parameters": {key: values[0] for key, values in row["parameters"].items()},
        }
        for row in _with_page(rows)
    }


def _json(data: object) -> Markup:
    """JSON that no text in it can end the script of."""
    return Markup(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"))


def _index(folder: Path, rows: Sequence[Page]) -> str:
    shown = _with_page(rows)
    charted = [
        {**{key: row[key] for key in ("material", "model", "page", "seconds", *FIGURES)},
         **{f"{name}{ending}": x for name, values in row["parameters"].items()
            for ending, x in zip(("", "_low", "_high"), values, strict=True)}}
        for row in shown if row["model"] is not None
    ]  # fmt: skip
    counts = Counter(name for row in shown for name in row["parameters"])
    specs = {}
    if charted:
        known = {n: said for n, said in FIGURES.items() if any(row[n] is not None for row in charted)}
        specs = {"sorted": charts.sorted_errors(charted, known), "time": charts.time_against_error(charted, known)}
        if counts:
            names = [name for name, _ in counts.most_common()]
            specs["parameters"] = charts.parameters(charted, names, _units({row["model"] for row in charted}, names))
    return _templates().get_template("index.html").render(
        rows=rows, folder=folder.resolve().name, number=number, errors=FIGURES,
        kinds=Counter(str(row["data"]) for row in shown if row["data"]).most_common(),
        statuses=Counter(str(row["status"]) for row in rows).most_common(),
        groups=sorted({row["group"] for row in rows}),
        models=sorted({str(row["model"]) for row in shown if row["model"]}),
        **_embedded(specs),
        medians={n: middle(row[n] for row in shown) for n in (*FIGURES, "seconds")},
    )  # fmt: skip


def _units(known: Set[str], names: Sequence[str]) -> dict[str, str]:
    """Of parameters, by their names in the table, where all models agree on one."""
    found: dict[str, set[str]] = {}
    for q in (q for name in known & models().keys() for model in variants(name) for q in model.parameters):
        found.setdefault(q.name, set()).add(q.unit)
    own = {
        name: max((q for q in found if name == q or name.startswith(f"{q}_")), key=len, default="") for name in names
    }
    agreed = {q: UNITS.get(*units, *units) for q, units in found.items() if len(units) == 1}
    return {name: agreed[q] for name, q in own.items() if agreed.get(q)}


def _embedded(specs: Mapping[str, charts.Spec]) -> Page:
    """Specifications as JSON, and the charts as they are drawn."""
    return {
        "spec": {name: _json(spec) for name, spec in specs.items()},
        "svg": {name: Markup(charts.svg(spec, name)) for name, spec in specs.items()},
    }


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader("merlfit.fitting.show", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
