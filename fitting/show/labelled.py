"""Rendered pixels as they are, with words above their columns and beside their rows."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from .style import LETTERS, plain, printable

DPI = 100
MARGIN = 40  # pixels, for two lines of words
LINE, LETTER = 14, 6.5  # pixels: from line to line, and of a letter on average
SHORTEST = 30  # letters of a line


@printable
def labelled(
    pixels: np.ndarray, columns: Sequence[str], rows: Sequence[str] = (), across: str = "", down: str = ""
) -> Figure:
    """A grid of pictures of one size, (H, W, 3) of 8 bits; none of its pixels is changed when it is saved.

    Args:
        columns, rows: words for each. across, down: what differs from column to column, from row to row.
    """
    height, width, _ = pixels.shape
    said, beside = (
        [plain(line) for line in textwrap.wrap(words, max(int(room / LETTER), SHORTEST))]
        for words, room in ((across, width), (down, height))
    )
    columns, rows = ([plain(words) for words in each] for each in (columns, rows))
    left, top = (MARGIN + LINE * max(len(lines) - 1, 0) for lines in (beside, said))
    left = left if rows else 0
    across_pixels, down_pixels = width + left, height + top
    figure = Figure(figsize=(across_pixels / DPI, down_pixels / DPI), dpi=DPI)
    axes = figure.add_axes((left / across_pixels, 0, width / across_pixels, height / down_pixels))
    axes.imshow(pixels, interpolation="none", aspect="auto")
    axes.set_axis_off()
    for place, words in enumerate(columns):
        x = left + (place + 0.5) * width / len(columns)
        figure.text(x / across_pixels, 1 - (top - 4) / down_pixels, words, ha="center", va="bottom", size=LETTERS)
    for place, words in enumerate(rows):
        y = (len(rows) - place - 0.5) * height / len(rows)
        figure.text(
            (left - 4) / across_pixels, y / down_pixels, words, ha="right", va="center", rotation=90, size=LETTERS
        )
    middle = (left + width / 2) / across_pixels, height / 2 / down_pixels
    figure.text(middle[0], 1 - 4 / down_pixels, "\n".join(said), ha="center", va="top", size=LETTERS)
    figure.text(4 / across_pixels, middle[1], "\n".join(beside), ha="left", va="center", rotation=90, size=LETTERS)
    return figure
