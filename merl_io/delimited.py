"""Text of numbers in columns: commas, semicolons, tabs or blanks between them, names in a line before, remarks."""

import csv
import io
import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path

from .columns import Columns, columns_of, listed, names_angles
from .source import MerlError

DELIMITERS = (",", ";", "\t", None)  # None: any blanks
NO_DATUM = ("", "nan")  # a negative number is one: where a dark signal was subtracted, noise is on both sides of zero


@dataclass
class Lines:
    """Lines of a file as they are read.

    Attributes:
        delimiter: between cells. columns, names: what they are, None before the line of names. numbers: of all
            samples. lines: on which each of these stands. wrong: what is wrong with others. remark: the last line
            behind ``#`` that names all angles. optional: columns whose cells may be blank.
    """

    path: Path
    delimiter: str | None = ","
    columns: Columns | None = None
    names: list[str] = field(default_factory=list)
    numbers: array = field(default_factory=lambda: array("d"))
    lines: array = field(default_factory=lambda: array("l"))
    wrong: list[str] = field(default_factory=list)
    remark: str = ""
    optional: set[int] = field(default_factory=set)

    def take(self, number: int, line: str) -> None:
        """Read another line of the file."""
        if line.lstrip().startswith("#"):
            if self.columns is None and named(names := line.strip().lstrip("#").strip()) == 3:
                self.remark = names  # as ``np.savetxt(header=...)`` writes names
        elif self.columns is None:
            behind = bool(self.remark) and all(map(_is_number, cells_of(line, delimiter_of(self.remark))))
            self._head(self.remark if behind else line)
            if behind:
                self._sample(number, line)
        else:
            self._sample(number, line)

    def _head(self, line: str) -> None:
        self.delimiter = delimiter_of(line)
        self.names = cells_of(line, self.delimiter)
        self.columns = columns_of(self.path, self.names)
        self.optional = {*self.columns.values, *self.columns.uncertainties} - {None}

    def _sample(self, number: int, line: str) -> None:
        cells = cells_of(line, self.delimiter)
        if len(cells) != len(self.names):
            self.wrong.append(f"line {number} has {len(cells)} cells, and there are {len(self.names)} columns")
            return
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = [self._number(cell) for cell in cells]
        bad = [k for k, x in enumerate(row) if not math.isfinite(x) and not self._blank(k, cells[k])]
        if bad:
            self.wrong += [self._complaint(number, k, cells[k]) for k in bad]
            return
        self.numbers.extend(row)
        self.lines.append(number)

    def _number(self, cell: str) -> float:
        """The number in a cell; with a decimal comma where commas are not what stands between cells."""
        try:
            return float(cell if self.delimiter == "," else cell.replace(",", "."))
        except ValueError:
            return math.nan

    def _blank(self, k: int, cell: str) -> bool:
        return k in self.optional and cell.strip().lower() in NO_DATUM

    def _complaint(self, number: int, k: int, cell: str) -> str:
        mend = "; leave the cell of a missing value blank" if k in self.optional else ""
        return f"line {number}: {self.names[k].strip()} is {cell.strip()!r}, not a finite number{mend}"


def read_lines(path: Path, data: bytes) -> Lines:
    """All lines of a file, decoded one by one: there is no copy of all.

    Raises:
        MerlError: it is no such text, or has no line of names or of numbers.
    """
    lines = Lines(path)
    try:
        for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), "utf-8-sig"), 1):
            if line.strip(" \t\r\n,;"):
                lines.take(number, line.rstrip("\r\n"))
    except UnicodeDecodeError:
        raise MerlError(f"{path}: is not a table: it is no UTF-8 text") from None
    except csv.Error as error:
        raise MerlError(f"{path}: is not a table: {error}") from None
    if lines.columns is None or not (lines.numbers or lines.wrong):
        lacking = "lines of numbers" if lines.columns else "line of names"
        raise MerlError(f"{path}: is not a table: it has no {lacking}")
    return lines


def refuse(path: Path, wrong: list[str], names: list[str]) -> None:
    """Everything that is wrong with a file, in one line.

    Raises:
        MerlError: something is.
    """
    if wrong:
        raise MerlError(f"{path}: {listed(wrong)} (columns: {listed([n.strip() for n in names], ', ')})")


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Cells of a line."""
    if delimiter is None:
        return line.split()
    return next(csv.reader([line], delimiter=delimiter)) if '"' in line else line.split(delimiter)


def named(line: str) -> int:
    """How many of the angles a line names, whatever stands between."""
    return names_angles(cells_of(line, delimiter_of(line)))


def delimiter_of(line: str) -> str | None:
    """What stands between the names of a line: with what most of the angles are found, the first of these."""
    return max(DELIMITERS, key=lambda delimiter: names_angles(cells_of(line, delimiter)))


def _is_number(cell: str) -> bool:
    try:
        float(cell.strip() or "nan")
    except ValueError:
        return False
    return True
