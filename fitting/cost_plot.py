"""What ``merlfit cost`` measured, as a picture: errors against time with the Pareto fronts drawn, defaults starred."""

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.ticker import FuncFormatter, LogLocator
from matplotlib.transforms import Bbox

from .choice import default_choice
from .cost_report import default_tier
from .frontier import Frontier, pareto

matplotlib.use("Agg")
KINDS = {
    "value_ns": ("one direction of a list", "o", "#2f5fb3"),
    "gradient_ns": ("one direction of a list,\nwith gradient", "s", "#c0392b"),
    "fit_gradient_ns": ("one bin of a file in a fit,\nwith gradient", "^", "#2e8b57"),
}
FAINT: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.5}
SIDES = [
    (x, y) for y in (7, -7, 19, -19, 31, -31, 43, -43) for x in (7, -7, 19, -19)
]  # points from a mark to its label, nearest first
PADDING = 1.0  # pixels between labels


def frontier_figure(frontier: Frontier) -> Figure:
    """Evaluation in three panels, one for each way of evaluating, and fits in a fourth; log-log."""
    figure = Figure(figsize=(16, 9), layout="constrained")
    upper, lower = figure.add_gridspec(2, 1, height_ratios=[5, 1])
    above = upper.subgridspec(1, 4, width_ratios=[1, 1, 1, 2.2])
    axes = [figure.add_subplot(above[k]) for k in range(4)]
    below = lower.subgridspec(1, 2, width_ratios=[2, 3.4])
    legends = [figure.add_subplot(below[k]) for k in range(2)]
    marks = [_tiers(axis, frontier, key) for axis, key in zip(axes, KINDS, strict=False)]
    marks.append(_fits(axes[-1], frontier))
    low, high = min(a.get_ylim()[0] for a in axes[:3]), max(a.get_ylim()[1] for a in axes[:3])
    for axis in axes:
        axis.grid(alpha=0.25, which="both", linewidth=0.5)
    for axis in axes[:3]:
        axis.set(ylim=(low, high))
    axes[0].set_ylabel("relative error of the BRDF: median (marked) to 95 %")
    for axis in legends:
        axis.axis("off")
    shown = [t.name for t in frontier.tiers if t.error is not None]
    said = [f"{k}: {name}{' (default)' * (name == default_tier())}" for k, name in enumerate(shown, 1)]
    exact = [f"{t.name}: {t.value_ns:.2g} ns for one direction of a list" for t in frontier.tiers if t.error is None]
    _listed(legends[0], [*said, *exact], 3)
    _listed(legends[1], [f"{k}: {q.choice}{' (default)' * (q.choice == default_choice())}"
                         for k, q in enumerate(frontier.points, 1)], 2)  # fmt: skip
    title = f"What accuracy costs on {frontier.machine}. Evaluation: {frontier.directions}. Fits: {frontier.data}."
    figure.suptitle("\n".join(textwrap.wrap(title, 150)), fontsize=10)
    figure.draw_without_rendering()  # only now is it known where the marks are
    for axis, points in zip(axes, marks, strict=True):
        number(axis, points)
    return figure


def number(axis: Axes, points: Sequence[tuple[float, float]]) -> list[Annotation]:
    """Number marks so that no number lies on another one or on a mark."""
    scale = axis.get_figure(root=True).dpi / 72  # pyright: ignore[reportOptionalMemberAccess] - it is in one
    at = axis.transData.transform(np.asarray(points))
    taken = [Bbox.from_bounds(x - 4 * scale, y - 4 * scale, 8 * scale, 8 * scale) for x, y in at]
    made = []
    for k, (x, y) in enumerate(at, 1):
        width, height = (6.5 * len(str(k)) * scale, 10 * scale)
        free = None
        for right, up in SIDES:
            box = Bbox.from_bounds(x + right * scale - width / 2, y + up * scale - height / 2, width, height)
            if not any(box.padded(PADDING).overlaps(other) for other in taken):
                free = right, up
                taken.append(box)
                break
        far = free is not None and max(map(abs, free)) > SIDES[0][0]
        made.append(axis.annotate(
            str(k), points[k - 1], xytext=free or SIDES[0], textcoords="offset points", fontsize=9, ha="center",
            va="center", arrowprops={"arrowstyle": "-", "linewidth": 0.4, "alpha": 0.6} if far else None,
        ))  # fmt: skip
    return made


def _listed(axis: Axes, lines: list[str], columns: int) -> None:
    """What the numbers stand for, in columns."""
    rows = -(-len(lines) // columns)
    for k, line in enumerate(lines):
        axis.text(k // rows / columns, 1 - k % rows / rows, line, fontsize=8, va="top", transform=axis.transAxes)


def _front(axis: Axes, times: list[float], errors: list[float], colour: str) -> None:
    """The points that nothing beats."""
    front = pareto(times, errors)
    x, y = ([values[i] for i in front] for values in (times, errors))
    axis.plot(x, y, "-", color=colour, linewidth=1.2, drawstyle="steps-post")


def _tiers(axis: Axes, frontier: Frontier, key: str) -> list[tuple[float, float]]:
    """Median and 95th percentile of a tier's error against its time; where the marks are."""
    said, marker, colour = KINDS[key]
    shown = [(float(getattr(t, key)), t.error, t.name) for t in frontier.tiers if t.error is not None]
    for time, error, name in shown:
        axis.plot([time, time], [error.median, error.p95], "-", color=colour, **FAINT)
        star = name == default_tier()
        axis.plot(time, error.median, "*" if star else marker, color=colour, markersize=14 if star else 5)
    times, medians = [time for time, _, _ in shown], [error.median for _, error, _ in shown]
    _front(axis, times, medians, colour)
    axis.margins(x=0.1, y=0.08)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set(xlabel="ns for three channels")
    axis.set_title(said, fontsize=10)
    return list(zip(times, medians, strict=True))


def _fits(axis: Axes, frontier: Frontier) -> list[tuple[float, float]]:
    """Error that 95 % of fits keep to, with the median, against the median time; where the marks are."""
    points, colour = frontier.points, "#2f5fb3"
    times, errors = [q.seconds.median for q in points], [q.error.p95 for q in points]
    for q, time, error in zip(points, times, errors, strict=True):
        star = q.choice == default_choice()
        axis.plot([time, time], [q.error.median, error], "-", color=colour, **FAINT)
        axis.plot([time, q.seconds.p95], [error, error], "-", color=colour, **FAINT)
        axis.plot(time, error, "*" if star else "o", color="#c0392b" if star else colour, markersize=14 if star else 5)
    _front(axis, times, errors, colour)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    axis.xaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set(
        xlabel="seconds for a file, once compiled: median (marked) to 95 %",
        ylabel="distance from the reference fit, relative: median to 95 % (marked)",
    )
    axis.set_title("fits (star: the default)", fontsize=10)
    return list(zip(times, errors, strict=True))
