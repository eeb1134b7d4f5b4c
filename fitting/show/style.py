"""How pictures look: as wide as a column of a paper, with letters that are legible at that size, and safe colours."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser

from ...merl_io.atomic import write_atomically
from ...merl_io.source import PLAIN

COLUMN_INCHES = 8.5 / 2.54
PAGE_INCHES = 17.8 / 2.54  # both columns
DPI = 300
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#F0E442", "#000000")
"""Colours that people with any colour vision tell apart (Okabe & Ito 2008)."""
CHANNEL_COLOURS = {"R": "#D55E00", "G": "#009E73", "B": "#5A4FCF"}
MARKS = ("o", "s", "^", "D", "v")
"""Marks of the channels, one after the other: what colour says is said by shape, too."""
INK, FAINT = "#222222", "#808080"
FITTED = "#D55E00"  # a fitted value among draws
LETTERS, SMALL = 7.0, 6.0  # points
STYLE = {
    "font.size": LETTERS, "axes.titlesize": LETTERS, "axes.labelsize": LETTERS, "figure.titlesize": LETTERS,
    "legend.fontsize": SMALL, "legend.handlelength": 1.6, "legend.frameon": False, "legend.columnspacing": 1.0,
    "axes.linewidth": 0.5, "lines.linewidth": 0.8, "axes.titlepad": 3.0, "axes.labelpad": 2.0, "grid.linewidth": 0.4,
    "figure.constrained_layout.h_pad": 0.03, "figure.constrained_layout.w_pad": 0.03,
}  # fmt: skip
TICKS: dict[str, Any] = {"labelsize": SMALL, "width": 0.5, "length": 2.0, "pad": 1.5}
"""Told to each axis: ticks are made when drawn."""
DEGREES = (0.01, 0.1, 1, 10, 90)  # ticks of theta_h on a logarithmic axis
DECADES = 6.0  # that a logarithmic scale reaches below the brightest value
OWN: dict[str, Any] = {**mpl.rcParamsDefault, "pdf.fonttype": 42, "ps.fonttype": 42}  # journals refuse Type 3 fonts
del OWN["backend"]  # which shows figures, and is the user's

PICTURED = dict.fromkeys(range(0x2400, 0x2422), 0xFFFD)  # pictures of control codes, which the fonts lack

P = ParamSpec("P")


@contextmanager
def own_style(more: dict[str, Any] | None = None) -> Iterator[None]:
    """Nothing of the user's settings of matplotlib in here, which may need a LaTeX that is not there."""
    with mpl.rc_context(OWN | (more or {})):  # pyright: ignore[reportArgumentType] - its names of settings
        yield


def plain(text: str) -> str:
    """A text from files, as it is shown, no formula of matplotlib's and no control code."""
    shown = text.encode("utf-8", "backslashreplace").decode().translate(PLAIN).translate(PICTURED)
    return shown.replace("$", r"\$")


def symbol(tex: str, name: str) -> str:
    """Symbol of a parameter, as a formula; its name where a file holds no formula."""
    try:
        MathTextParser("path").parse(f"${tex}$")
    except ValueError:
        return plain(name)
    return f"${tex}$"


def letters(tex: str) -> str:
    """TeX of a parameter in letters, as far as that goes."""
    found = tex
    for name, letter in GREEK.items():
        found = found.replace(f"\\{name}", letter)
    return re.sub(r"[{}\\$]|mathrm|text|rm ", "", found)


GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "eta": "η", "theta": "θ", "kappa": "κ", "lambda": "λ", "mu": "μ",
    "rho": "ρ", "sigma": "σ", "tau": "τ",
}  # fmt: skip


def printable(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Decorates a function that draws: its figures have this style wherever they are shown or saved."""

    @wraps(draw)
    def styled(*words: P.args, **named: P.kwargs) -> Figure:
        with own_style(STYLE):
            figure = draw(*words, **named)
            for axis in figure.axes:
                axis.tick_params("both", which="both", **TICKS)
            return figure

    return styled


def new(height: float, width: float = COLUMN_INCHES, layout: str | None = "constrained") -> Figure:
    """A figure of a paper (inches)."""
    return Figure(figsize=(width, height), dpi=DPI, layout=layout)  # pyright: ignore[reportArgumentType] - its names


def channel_colour(channel: str, place: int) -> str:
    """Colour of a channel by its name, or by its place where it has another one."""
    return CHANNEL_COLOURS.get(channel, OKABE_ITO[place % len(OKABE_ITO)])


def marks(channel: str, place: int, size: float, edge: float) -> dict[str, Any]:
    """How data of a channel are marked: hollow, so that none hides another."""
    return {
        "color": channel_colour(channel, place), "marker": MARKS[place % len(MARKS)], "linestyle": "none",
        "markersize": size, "fillstyle": "none", "markeredgewidth": edge,
    }  # fmt: skip


def at_mirror(axis: Axes, degrees: float) -> None:
    """What every panel of viewers in the plane of incidence has: the mirror direction, and the same ticks."""
    axis.axvline(degrees, color=FAINT, linewidth=0.5, linestyle=":")
    axis.set_xticks([-90, -45, 0, 45, 90])
    axis.grid(alpha=0.25)


def save(figure: Figure, path: Path, dpi: int | None = None) -> None:
    """Write a picture in the format that its name ends with, atomically.

    Args:
        dpi: of pixels, that of the figure by default.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    kind = path.suffix.removeprefix(".").lower() or "png"
    said = str(figure.get_label()).replace("\n", "; ")  # what it is of, whether it is above the picture or not
    made_by = {
        "png": {"Software": "merlfit", "Description": said}, "pdf": {"Creator": "merlfit", "Subject": said},
        "svg": {"Creator": "merlfit", "Description": said},
    }.get(kind)  # fmt: skip
    with own_style():
        write_atomically(path, lambda file: figure.savefig(file, format=kind, dpi=dpi or "figure", metadata=made_by))
