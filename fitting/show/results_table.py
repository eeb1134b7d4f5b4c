"""A folder of results as one table for a spreadsheet: what `merlfit table` writes."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import typer

from ...merl_io.atomic import write_text
from ..results.manifest import NAME as MANIFEST
from ..results.manifest import Ending, Line, lines
from ..results.schema import Metrics, Result
from ..results.storage import ResultError, read_result
from ..support.numbers import counted
from ..support.outputs import refuse_others
from ..support.tables import as_csv
from ..support.terminal import BAD_INPUT, console, fail, note, why_ended
from .parameter_table import as_latex, page

ENDINGS = {"csv": "csv", "latex": "tex", "html": "html"}
"""Endings of a table's file by its format."""
UNREADABLE = "unreadable"
HEADS = (
    "material", "status", "model", "variant", "genuine_merl", "data", "cost", *Metrics.model_fields, "seconds",
    "posterior", "cautions", "error", "result", "file", "sha1",
)  # fmt: skip
Row = dict[str, str | float | None]
BLANK: Row = dict.fromkeys(HEADS)


def write_table(folder: Path, path: Path, force: bool = False) -> None:
    """Write the table of a folder and say what it holds; ends with an error line where there is nothing.

    Exits with 2 if a result cannot be read; the others are in the table.

    Args:
        force: write over any file.
    """
    rows = results_in(folder)
    refuse_others([path], force, "table.csv")
    write_csv(rows, path)
    code = tell_errors(rows)
    counts = Counter(str(row["status"]) for row in rows).most_common()
    console.print(f"wrote {path}: {', '.join(f'{count} {status}' for status, count in counts)}")
    if code:
        raise typer.Exit(code)


def write_parameters(what: Sequence[Path], path: Path, form: str, force: bool = False) -> None:
    """Parameters of results side by side, as LaTeX or as HTML; exits with 2 if a result cannot be read.

    Args:
        what: results, and folders of them. form: latex or html. force: write over any file.
    """
    found, code = [], 0
    for each in what:
        inside = [p for p in sorted(each.rglob("*.json")) if _shown(p, each)] if os.path.isdir(each) else [each]
        for file in inside:
            try:
                result = read_result(file)
                found += [result] if result.model is not None else []
                if result.model is None:
                    note(f"{file}: the fit failed ({result.fit.status}), it has no parameters")
            except ResultError as error:
                fail(str(error))
                code = BAD_INPUT
    if not found:
        raise fail("there is no result that has parameters; `merlfit fit FILE ... -o fits` writes some")
    refuse_others([path], force, f"table.{ENDINGS[form]}")
    version = found[0].versions.get("merlfit", "")
    latex = f"% parameters of {counted(len(found), 'result')} by merlfit {version}; needs booktabs\n"
    write_text(path, latex + as_latex(found) if form == "latex" else page(found))
    console.print(f"wrote {path}: {counted(len(found), 'result')}")
    if code:
        raise typer.Exit(code)


def tell_errors(rows: Sequence[Row]) -> int:
    """Say what is wrong, a line a row; the exit code that follows from results that cannot be read."""
    for row in rows:
        if row["error"]:
            note(str(row["error"]))
    return BAD_INPUT if any(row["status"] == UNREADABLE for row in rows) else 0


def results_in(folder: Path) -> list[Row]:
    """As `rows_of`; ends with an error line where there is nothing."""
    if not os.path.isdir(folder):  # which takes names of any length
        raise fail(f"{folder}: no such folder")
    rows = rows_of(folder)
    if not rows:
        raise fail(f"{folder}: no results in there; `merlfit fit FILE ... -o {folder}` writes some")
    return rows


def rows_of(folder: Path) -> list[Row]:
    """A row a result in a folder and those in it, and one a file that has none.

    Returns:
        by material and model: the columns of ``HEADS``, then of each parameter its value, ``_low`` and ``_high``
        (90 % interval by the Laplace approximation), ``_q05``, ``_q50`` and ``_q95`` (of the posterior). What there is
        not is None.
    """
    last = dict(_last(folder))
    found = [
        _row(path, folder, last.pop(path, None)) for path in sorted(folder.rglob("*.json")) if _shown(path, folder)
    ]
    found += [
        BLANK | {"material": line.material, "status": str(line.ended), "error": line.error, "file": line.file}
        for line in last.values()
        if line.ended not in (Ending.FITTED, "kept")
    ]
    found.sort(key=lambda row: (str(row["material"]), str(row["model"]), str(row["result"])))
    return found


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """CSV: UTF-8, commas, a decimal point, numbers of six digits, nothing where there is no value."""
    heads = list(dict.fromkeys([*HEADS, *(head for row in rows for head in row)]))
    write_text(path, as_csv(heads, rows))


def _last(folder: Path) -> Iterator[tuple[Path, Line]]:
    """Where the result of a file should be, and how the last work on it ended, by the manifests."""
    for manifest in sorted(folder.rglob(MANIFEST)):
        for line in lines(manifest.parent):
            if line.event == "file":
                yield manifest.parent / f"{line.material}.json", line


def _shown(path: Path, folder: Path) -> bool:
    hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
    return not hidden and not path.name.endswith(".material.json")  # of `merlfit export`


def _row(path: Path, folder: Path, last: Line | None) -> Row:
    """Row of a result; an error is that of a later run that did not replace it."""
    where = str(path.relative_to(folder))
    row = BLANK | {"material": path.stem, "result": where, "error": last.error if last else None}
    try:
        return row | _found(read_result(path))
    except Exception as error:  # of any kind: the next result has its row
        return row | {"status": UNREADABLE, "error": why_ended(path, error)}


def _found(result: Result) -> Row:
    """What a result says."""
    material, posterior = result.model.material if result.model else None, result.posterior
    cautions = [*([result.edited_words] if result.edited_from else []), *result.fit.cautions]
    return {
        "material": result.source.material, "status": result.fit.status, "model": material and material.name,
        "variant": material and material.variant, "genuine_merl": result.source.genuine_merl or "no",
        "data": result.data_words, "cost": result.fit.cost, **result.metrics.model_dump(),
        "seconds": result.seconds["total"],
        "posterior": posterior and ("ok" if posterior.sufficient else posterior.message),
        "cautions": "; ".join(cautions), "file": result.source.path, "sha1": result.source.sha1,
        **_parameters(result),
    }  # fmt: skip


def _parameters(result: Result) -> Mapping[str, float | None]:
    found: dict[str, float | None] = {}
    for p in result.parameters:
        found |= {
            p.name: p.value,
            f"{p.name}_low": p.laplace and p.laplace.q05, f"{p.name}_high": p.laplace and p.laplace.q95,
            **{f"{p.name}_{q}": p.quantiles and getattr(p.quantiles, q) for q in ("q05", "q50", "q95")},
        }  # fmt: skip
    return found
