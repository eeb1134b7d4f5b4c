"""Files that a command writes: what it may write over, and what spreadsheets make of their cells."""

import csv
import io
import os
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from ...merl_io.atomic import WriteError, appendable

OURS = rb"merlfit"  # is in what tells who made a picture, a page or a JSON
LOOK = 2**14  # bytes at both ends of a file
FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute a cell that begins so


def log_of(out: Path, name: str) -> Path:
    """The log of a material in a folder of results: what was done when, and where in the code something went wrong."""
    return out / "logs" / f"{name}.log"


def log(path: Path, text: str) -> None:
    """Add a line to a log, if that can be written into the folder of results itself."""
    line = f"{time.strftime('%Y-%m-%dT%H:%M:%S')} {text.strip()}\n"
    with suppress(OSError), open_log(path) as file:
        file.write(line.encode(errors="backslashreplace"))


def open_log(path: Path) -> IO[bytes]:
    """A log, open at its end.

    Raises:
        OSError: there cannot be one, or it, or its folder, is a link.
    """
    path.parent.mkdir(exist_ok=True)  # not the folder for results: one that goes away is not to come back empty
    if path.parent.is_symlink():
        raise OSError("its folder is a symbolic link")
    return appendable(path)


def refuse_others(paths: Mapping[Path, bytes] | Iterable[Path], force: bool = False) -> None:
    """Leave alone what stands where a command writes, unless an earlier one wrote it.

    Args:
        paths: that it will write, each with a pattern that such a file has near its beginning or its end, or `OURS`.
        force: write over anything.

    Raises:
        WriteError: one of them is no earlier output.
    """
    marks = paths if isinstance(paths, Mapping) else dict.fromkeys(paths, OURS)
    for path, mark in {} if force else marks.items():
        if os.path.exists(path) and not is_ours(path, mark):
            raise WriteError(
                f"{path}: is there already, and no earlier output of this command: move it, write elsewhere (-o), or "
                "overwrite it (--force)"
            )


def is_ours(path: Path, mark: bytes = OURS) -> bool:
    """Whether a regular file has the mark of an output near one of its ends; an empty one has nothing to lose."""
    if not os.path.isfile(path):  # which takes names of any length, as `exists` does
        return False
    with open(path, "rb") as file:
        head, size = file.read(LOOK), path.stat().st_size
        file.seek(max(LOOK, size - LOOK))
        return not size or re.search(mark, head) is not None or re.search(mark, file.read()) is not None


def as_csv(heads: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Rows by their heads: commas, a decimal point, numbers of six digits, nothing where there is no value."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(_cell, heads))
    writer.writerows([_cell(row.get(head)) for head in heads] for row in rows)
    return out.getvalue()


def _cell(value: object) -> str:
    """Text of a cell; what a spreadsheet would take for a formula is quoted."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    return f"'{text}" if isinstance(value, str) and text.startswith(FORMULA) else text
