"""Numbers as tables show them."""

import math
import statistics
from collections.abc import Iterable


def number(x: float | None, digits: int = 4) -> str:
    """A number with a few significant digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "-"
    return f"{x:.{digits}g}"


def median(values: Iterable[float | None]) -> float:
    """Median of the numbers that are known; NaN where none is."""
    known = sorted(x for x in values if x is not None and math.isfinite(x))
    return statistics.median(known) if known else math.nan


def unit(name: str) -> str:
    """Unit of a quantity; a dash for none."""
    return "-" if name == "1" else name


def counted(count: int, thing: str) -> str:
    """How many there are, in words: one file, and two files."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def distance(x: float | None) -> str:
    """A CIELAB distance to hundredths, of which nobody sees one."""
    return "-" if x is None or not math.isfinite(x) else "< 0.01" if x < 0.01 else f"{x:.2f}" if x < 100 else f"{x:.0f}"
