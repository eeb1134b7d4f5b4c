"""What ``merlfit cost`` measured, as a picture: errors against time with the Pareto fronts drawn, defaults starred."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.ticker import EngFormatter, FuncFormatter, LogFormatterMathtext, LogLocator, NullFormatter
from matplotlib.transforms import Bbox

from ..settings.choice import default_choice
from ..show.style import own_style, plain
from .frontier import Frontier, Percentiles, pareto
from .report import default_tier

KINDS = {
    "value_ns": ("one direction of a list", "o", "#2f5fb3"),
    "gradient_ns": ("one direction of a list, with gradient", "s", "#c0392b"),
    "fit_gradient_ns": ("one bin of a file in a fit, with gradient", "^", "#2e8b57"),
}
FITS_COLOUR = "#2f5fb3"
FAINT: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.5}
MARK, STAR = 5.5, 13.0  # sizes of marks, in points
FONT = 10.0  # of numbers and of what they stand for
SIDES = [
    (radius * np.cos(angle), radius * np.sin(angle))
    for radius in (10, 14, 19, 25, 32, 40, 49)
    for angle in np.radians([45, 135, -45, -135, 0, 180, 90, -90, 20, 160, -20, -160])
]  # points from a mark to its number, nearest first
NEAR = 15.0  # points from a mark at which its number needs no line to it
PADDING = 1.0  # pixels between numbers
NARROW, WIDE = 1.0, 1.5  # decades: fewer marks in each from these on
Point = tuple[float, float]


@own_style()
def frontier_figure(frontier: Frontier) -> Figure:
    """Evaluation in three panels, one for each way of evaluating, and fits in a fourth; log-log.

    Everywhere a full mark is a median and a hollow one a 95th percentile.
    """
    figure = Figure(figsize=(16, 13), layout="constrained")
    upper, lower = figure.add_gridspec(2, 1, height_ratios=[1, 1.1])
    above, below = upper.subgridspec(1, 4, width_ratios=[1, 1, 1, 0.55]), lower.subgridspec(1, 2, width_ratios=[2, 1])
    axes = [*(figure.add_subplot(above[k]) for k in range(3)), figure.add_subplot(below[0])]
    legends = [figure.add_subplot(above[3]), figure.add_subplot(below[1])]
    drawn = [_tiers(axis, frontier, key) for axis, key in zip(axes, KINDS, strict=False)]
    drawn.append(_fits(axes[-1], frontier))
    low, high = min(a.get_ylim()[0] for a in axes[:3]), max(a.get_ylim()[1] for a in axes[:3])
    for axis in axes[:3]:
        axis.set(ylim=(low, high))
    for axis in axes:
        axis.grid(alpha=0.25, which="both", linewidth=0.5)
        for side in (axis.xaxis, axis.yaxis):
            _marked(side, nanoseconds=side is axis.xaxis and axis is not axes[-1])
    axes[0].set_ylabel("relative error of the BRDF", fontsize=FONT)
    shown = [t.name for t in frontier.tiers if t.error is not None]
    said = [f"{k}: {name}{' (default)' * (name == default_tier())}" for k, name in enumerate(shown, 1)]
    exact = [f"{t.name}: {_of_nanoseconds(t.value_ns)} for\none direction of a list" for t in frontier.tiers
             if t.error is None]  # fmt: skip
    _listed(legends[0], "tiers of the diffraction lobe", [*said, *exact])
    _explained(legends[0])
    _listed(legends[1], "settings of fits", [
        f"{k}: {q.choice}{' (default)' * (q.choice == default_choice())}{', median 0' * (q.error.median == 0)}"
        for k, q in enumerate(frontier.points, 1)
    ])  # fmt: skip
    title = f"What accuracy costs on {frontier.machine}. Evaluation: {frontier.directions}. Fits: {frontier.data}."
    figure.suptitle(plain("\n".join(textwrap.wrap(title, 150))), fontsize=FONT)
    figure.draw_without_rendering()  # only now is it known where the marks are
    for axis, (points, others) in zip(axes, drawn, strict=True):
        number(axis, points, others)
    return figure


def number(axis: Axes, points: Sequence[Point], others: Sequence[tuple[Point, Point]] = ()) -> list[Annotation]:
    """Number marks so that no number lies on another one or on a mark, nor, if it can be, on a line.

    Args:
        points: marks that are numbered. others: lines, by their ends, in the axes' coordinates.
    """
    scale = axis.get_figure(root=True).dpi / 72  # pyright: ignore[reportOptionalMemberAccess] - it is in one
    at, inside = axis.transData.transform(np.asarray(points)), axis.get_window_extent()
    taken = [Bbox.from_bounds(x - 4 * scale, y - 4 * scale, 8 * scale, 8 * scale) for x, y in at]
    drawn = [_along(axis.transData.transform(np.asarray(ends)), 3 * scale) for ends in others]
    lines = np.concatenate([np.empty((0, 2)), *drawn])
    made = []
    for k, (x, y) in enumerate(at, 1):
        width, height = (0.75 * FONT * len(str(k)) * scale, 1.1 * FONT * scale)
        boxes = [Bbox.from_bounds(x + right * scale - width / 2, y + up * scale - height / 2, width, height)
                 for right, up in SIDES]  # fmt: skip
        free = [j for j, box in enumerate(boxes) if not any(box.padded(PADDING).overlaps(other) for other in taken)]
        within = [j for j in free if inside.containsx(boxes[j].x0) and inside.containsx(boxes[j].x1)
                  and inside.containsy(boxes[j].y0) and inside.containsy(boxes[j].y1)]  # fmt: skip
        clear = [j for j in within if not np.any(np.all((lines > boxes[j].min) & (lines < boxes[j].max), -1))]
        chosen = (clear or within or free or [0])[0]
        taken.append(boxes[chosen])
        far = np.hypot(*SIDES[chosen]) > NEAR
        made.append(axis.annotate(
            str(k), points[k - 1], xytext=SIDES[chosen], textcoords="offset points", fontsize=FONT, ha="center",
            va="center", arrowprops={"arrowstyle": "-", "linewidth": 0.5, "alpha": 0.7, "shrinkB": 3} if far else None,
        ))  # fmt: skip
        made[-1].set_in_layout(False)
    return made


def _along(ends: np.ndarray, step: float) -> np.ndarray:
    """Places on the line between two points of the display, (N, 2)."""
    shares = np.linspace(0, 1, int(np.hypot(*(ends[1] - ends[0])) / step) + 2)[:, None]
    return ends[0] + shares * (ends[1] - ends[0])


def _of_nanoseconds(x: float, digits: int = 1) -> str:
    """With the unit in which it is a short number."""
    return EngFormatter("s").format_eng(float(f"{x:.{digits}g}") * 1e-9)


def _marked(axis: Axis, nanoseconds: bool = False) -> None:
    """Plain numbers at few places of a logarithmic axis: powers of ten, of a short axis round numbers between them."""
    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    rounds = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if decades < NARROW else (1.0, 2.0, 5.0) if decades < WIDE else (1.0,)
    axis.set_major_locator(LogLocator(subs=rounds))
    plain = LogFormatterMathtext() if len(rounds) == 1 else FuncFormatter(lambda x, _: f"{x:g}")
    axis.set_major_formatter(FuncFormatter(lambda x, _: _of_nanoseconds(x, 2)) if nanoseconds else plain)
    axis.set_minor_formatter(NullFormatter())


def _listed(axis: Axes, title: str, lines: list[str]) -> None:
    """What numbers stand for."""
    axis.axis("off")
    for k, line in enumerate([title, *lines]):
        weight = "normal" if k else "bold"
        axis.text(0, 1 - k * 0.049, line, fontsize=FONT, va="top", weight=weight, transform=axis.transAxes)


def _explained(axis: Axes) -> None:
    """What marks and lines stand for."""
    for marker, size, meant in (("o", MARK, ""), ("*", STAR, "default: ")):
        axis.plot([], [], marker, color="black", markersize=size, label=f"{meant}median")
        axis.plot([], [], marker, color="black", markersize=size, markerfacecolor="white", label=f"{meant}95 %")
    axis.plot([], [], "-", color="black", linewidth=1.2, label="nothing is both faster\nand more accurate")
    axis.legend(loc="lower left", fontsize=FONT, frameon=False)


def _front(axis: Axes, times: list[float], errors: list[float], colour: str) -> list[tuple[Point, Point]]:
    """The points that nothing beats, joined; the ends of the lines."""
    front = pareto(times, errors)
    x, y = ([values[i] for i in front] for values in (times, errors))
    axis.plot(x, y, "-", color=colour, linewidth=1.2, drawstyle="steps-post")
    steps = range(1, len(front))
    across = [((x[k - 1], y[k - 1]), (x[k], y[k - 1])) for k in steps]
    return [*across, *(((x[k], y[k - 1]), (x[k], y[k])) for k in steps)]


def _pair(axis: Axes, time: float, error: Percentiles, marker: str, colour: str) -> tuple[Point, Point]:
    """Median, full, and 95th percentile, hollow, joined by a line; its ends. No median of 0 is on a log axis."""
    size = STAR if marker == "*" else MARK
    axis.plot([time, time], [error.median or axis.get_ylim()[0], error.p95], "-", color=colour, zorder=1, **FAINT)
    hollow: dict[str, Any] = {"markerfacecolor": "white", "color": colour}
    axis.plot(time, error.p95, marker, markersize=size, **hollow)
    if error.median > 0:
        axis.plot(time, error.median, marker, color=colour, markersize=size)
    return (time, error.median or error.p95), (time, error.p95)


def _tiers(axis: Axes, frontier: Frontier, key: str) -> tuple[list[Point], list[tuple[Point, Point]]]:
    """Median and 95th percentile of a tier's error against its time; the medians, and where lines are."""
    said, marker, colour = KINDS[key]
    axis.set(xscale="log", yscale="log")
    shown = [(float(getattr(t, key)), t.error, t.name) for t in frontier.tiers if t.error is not None]
    lines = [_pair(axis, time, error, "*" if name == default_tier() else marker, colour) for time, error, name in shown]
    points = [line[0] for line in lines]
    lines += _front(axis, [x for x, _ in points], [y for _, y in points], colour)
    axis.margins(x=0.12, y=0.06)
    axis.set_xlabel("time for three channels", fontsize=FONT)
    axis.set_title(said, fontsize=FONT)
    return points, lines


def _fits(axis: Axes, frontier: Frontier) -> tuple[list[Point], list[tuple[Point, Point]]]:
    """The error's median and what 95 % of fits keep to, against the median time; the latter, and where lines are."""
    axis.set(xscale="log", yscale="log")
    errors = [x for q in frontier.points for x in (q.error.median, q.error.p95) if x > 0]
    axis.set_ylim(min(errors) / 2, max(errors) * 2)
    lines = []
    for q in frontier.points:
        time, star = q.seconds.median, q.choice == default_choice()
        colour = "#c0392b" if star else FITS_COLOUR
        lines.append(_pair(axis, time, q.error, "*" if star else "o", colour))
        across = (time, q.error.p95), (q.seconds.p95, q.error.p95)
        axis.plot(*zip(*across, strict=True), "-", color=colour, zorder=1, **FAINT)
        lines.append(across)
    points = [(q.seconds.median, q.error.p95) for q in frontier.points]
    lines += _front(axis, [x for x, _ in points], [y for _, y in points], FITS_COLOUR)
    axis.set_xlabel("seconds for a file, once compiled: median, line to 95 %", fontsize=FONT)
    axis.set_ylabel("distance from the reference fit, relative", fontsize=FONT)
    axis.set_title("fits", fontsize=FONT)
    return points, lines
