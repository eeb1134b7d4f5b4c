"""Numbers as tables show them."""

import math


def number(x: float | None, digits: int = 4) -> str:
    """A number with a few significant digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "-"
    return f"{x:.{digits}g}"
