"""What ``merlfit cost`` measured: a table, a paragraph, and a picture of errors against time."""

import textwrap
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from rich.table import Table

from ...merl_io.atomic import write_text
from ..settings.choice import default_choice
from ..show.style import FAINT, MARKS, OKABE_ITO, own_style, plain
from ..support import tables
from ..support.numbers import number
from .frontier import Frontier, Point, pareto

MARK = "*"  # of the defaults
NOTICED = 0.9  # of an error: less is a step that gains something
HEADS = (
    "settings", "error: median", "95 %", "worst", "promised, 95 %", "failed", "other body",
    "parameters, median (std. err.)", "RMSE, median (1/sr)", "fit (s): median", "95 % ", "estimate (s)", "memory (MB)",
)  # fmt: skip


def table(frontier: Frontier) -> Table:
    """Errors, times and memory of fits."""
    return tables.table(_title(frontier), HEADS, HEADS[:1], _rows(frontier))


def _title(frontier: Frontier) -> str:
    return f"Fits of {frontier.data}: distance from the reference fit; promised: the larger of it and its estimate"


def _rows(frontier: Frontier) -> list[tuple[str, ...]]:
    return [
        (
            f"{q.choice}{MARK * (q.choice == default_choice())}", number(q.error.median, 2), number(q.error.p95, 2),
            number(q.error.worst, 2), number(q.promised.p95, 2), f"{q.failed:.0%}", f"{q.other_body:.0%}",
            number(q.parameters and q.parameters.median, 2), number(q.rmse.median, 3), number(q.seconds.median, 3),
            number(q.seconds.p95, 3), number(q.estimate_seconds.median, 2), number(q.megabytes, 4),
        )
        for q in frontier.points
    ]  # fmt: skip


def front(frontier: Frontier) -> list[Point]:
    """Fits than which none is both as fast and as accurate, fastest first; each noticeably better than the last."""
    points = frontier.points
    steps: list[Point] = []
    for i in pareto([q.seconds.median for q in points], [q.error.p95 for q in points]):
        if not steps or points[i].error.p95 < NOTICED * steps[-1].error.p95:
            steps.append(points[i])
    return steps


def gains(frontier: Frontier) -> str:
    """What is gained at each step along the front, in a paragraph."""
    steps = front(frontier)
    first = steps[0]
    said = [
        f"The cheapest fit ({first.choice}) takes {first.seconds.median:.2g} s and is within {first.error.p95:.2g} of "
        "the reference fit for 95 % of the materials."
    ]
    for before, after in pairwise(steps):
        reached, seconds = after.error.p95, after.seconds.median
        times = f"{before.error.p95 / reached:.2g} times as accurate ({reached:.2g})" if reached else ""
        price = f"{seconds / before.seconds.median:.2g} times the time ({seconds:.2g} s)"
        said.append(f"Then {after.choice}: {times or 'the reference itself'} in {price}.")
    said += [
        f"The defaults ({q.choice}) are within {q.error.p95:.2g}, half of them within {q.error.median:.2g}, in "
        f"{q.seconds.median:.2g} s."
        for q in frontier.points if q.choice == default_choice()
    ]  # fmt: skip
    return " ".join(said)


def write_markdown(frontier: Frontier, path: Path) -> None:
    """Table and paragraph as Markdown."""
    measured = (
        f"Measured by `merlfit cost` on {frontier.machine}, {frontier.taken}; seconds are those of one file from "
        "reading to the metrics, all five kinds of material, once compiled and without posterior; the estimate of the "
        "error, for `--accuracy` and `--time`, comes on top."
    )
    rows = tables.as_markdown(HEADS, _rows(frontier))
    said = [f"**{_title(frontier)}**", "", rows, "", f"{MARK} the defaults. {gains(frontier)}", "", measured]
    write_text(path, "\n".join(["# What accuracy costs in time", "", *said]) + "\n")


@own_style()
def frontier_figure(frontier: Frontier) -> Figure:
    """Errors against seconds, log-log, what nothing beats joined; a full mark is a median, a hollow one 95 %."""
    figure = Figure(figsize=(13, 7), layout="constrained")
    axis, points = figure.subplots(), frontier.points
    seen = [x for q in points for x in (q.error.median, q.error.p95) if x > 0]
    axis.set(xscale="log", yscale="log", ylim=(min(seen) / 2, max(seen) * 2), ylabel="distance from the reference fit",
             xlabel="seconds for a file, once compiled: median, line to 95 %")  # fmt: skip
    for k, q in enumerate(points):
        star, seconds, colour = q.choice == default_choice(), q.seconds.median, OKABE_ITO[k % len(OKABE_ITO)]
        look: dict[str, Any] = {"color": colour, "marker": "*" if star else MARKS[k // len(OKABE_ITO)]}
        look |= {"linestyle": "none", "markersize": 13.0 if star else 6.0}
        joined = [seconds, seconds, q.seconds.p95], [q.error.median or min(seen) / 2, q.error.p95, q.error.p95]
        axis.plot(*joined, color=colour, linewidth=0.8, alpha=0.5)
        axis.plot(seconds, q.error.p95, markerfacecolor="white", **look)
        said = f"{q.choice}{' (default)' * star}{', median 0' * (q.error.median == 0)}"
        axis.plot(seconds, q.error.median or np.nan, label=said, **look)
    best = [points[i] for i in pareto([q.seconds.median for q in points], [q.error.p95 for q in points])]
    axis.plot([q.seconds.median for q in best], [q.error.p95 for q in best], color=FAINT, drawstyle="steps-post",
              label="nothing is both faster and more accurate")  # fmt: skip
    for side in (axis.xaxis, axis.yaxis):
        low, high = side.get_view_interval()
        side.set_major_locator(LogLocator(subs=(1.0,) if high > 30 * low else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        side.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.25, which="both", linewidth=0.5)
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, title="full: median; hollow: 95 %")
    title = f"What accuracy costs on {frontier.machine}. Fits: {frontier.data}."
    figure.suptitle(plain("\n".join(textwrap.wrap(title, 140))), fontsize=10)
    return figure
