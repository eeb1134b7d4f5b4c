"""Tables of rows: for a terminal, as CSV and as Markdown."""

import csv
import io
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute a cell that begins so


def table(
    title: str, heads: Iterable[str], left: Container[str], rows: Iterable[Iterable[str]] = (), **named: Any  # noqa: ANN401 - as rich takes it
) -> Table:  # fmt: skip
    """For a terminal: numbers at the right of their columns.

    Args:
        left: heads of columns that have words. named: further options of rich's.
    """
    found = Table(title=title, **named)
    for head in heads:
        found.add_column(head, justify="left" if head in left else "right")
    for row in rows:
        found.add_row(*row)
    return found


def as_markdown(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """As CommonMark's tables."""
    lines = [f"| {' | '.join(map(str, row))} |" for row in (heads, *rows)]
    return "\n".join([lines[0], "|---" * len(heads) + "|", *lines[1:]])


def as_csv(
    heads: Sequence[str], rows: Iterable[Mapping[str, object]], digits: int = 6, spreadsheet: bool = True
) -> str:
    """Rows by their heads: commas, a decimal point, nothing where there is no value.

    Args:
        digits: of numbers. spreadsheet: whether what a spreadsheet would take for a formula is quoted.
    """

    def cell(value: object) -> str:
        if isinstance(value, float):
            return f"{value:.{digits}g}"
        text = "" if value is None else str(value)
        return f"'{text}" if spreadsheet and isinstance(value, str) and text.startswith(FORMULA) else text

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(cell, heads))
    writer.writerows([cell(row.get(head)) for head in heads] for row in rows)
    return out.getvalue()
