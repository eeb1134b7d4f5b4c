"""What ``merlfit cost`` measured, as a picture: errors against time with the Pareto fronts drawn, defaults starred."""

import textwrap
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .choice import default_choice
from .cost_report import default_tier
from .frontier import Frontier, pareto

matplotlib.use("Agg")
KINDS = {
    "value_ns": ("a direction of a list", "o", "#2f5fb3"),
    "gradient_ns": ("a direction of a list, with gradient", "s", "#c0392b"),
    "fit_gradient_ns": ("a bin of a file in a fit, with gradient", "^", "#2e8b57"),
}
FAINT: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.5}


def frontier_figure(frontier: Frontier) -> Figure:
    """Two panels, evaluation and fits, log-log."""
    figure = Figure(figsize=(15, 7), layout="constrained")
    left, right = figure.subplots(1, 2)
    _tiers(left, frontier)
    _fits(right, frontier)
    for axis in (left, right):
        axis.set(xscale="log", yscale="log")
        axis.grid(alpha=0.25, which="both", linewidth=0.5)
    title = f"What accuracy costs on {frontier.machine}. Evaluation: {frontier.directions}. Fits: {frontier.data}."
    figure.suptitle("\n".join(textwrap.wrap(title, 150)), fontsize=10)
    return figure


def _tiers(axis: Axes, frontier: Frontier) -> None:
    """Median and 95th percentile of a tier's error against its time, once for every way of evaluating it."""
    for key, (said, marker, colour) in KINDS.items():
        shown = [(float(getattr(t, key)), t.error, t.name) for t in frontier.tiers if t.error is not None]
        times, medians = [time for time, _, _ in shown], [error.median for _, error, _ in shown]
        for time, error, name in shown:
            axis.plot([time, time], [error.median, error.p95], "-", color=colour, **FAINT)
            star = name == default_tier()
            axis.plot(time, error.median, "*" if star else marker, color=colour, markersize=14 if star else 5)
            if key == "value_ns":
                axis.annotate(
                    name, (time, error.p95), xytext=(-4, 4), textcoords="offset points", fontsize=7, rotation=60
                )
        front = pareto(times, medians)
        axis.plot(
            [times[i] for i in front],
            [medians[i] for i in front],
            "-",
            color=colour,
            linewidth=1.2,
            drawstyle="steps-post",
        )
        axis.plot([], [], marker=marker, color=colour, label=said)
    for t in frontier.tiers:
        if t.error is None:
            axis.axvline(
                t.value_ns, color=KINDS["value_ns"][2], linestyle=":", label=f"{t.name}, a direction of a list"
            )
    axis.margins(y=0.12)  # the labels'
    axis.set(
        xlabel="ns for three channels", ylabel="relative error of the BRDF: median (marked) to 95 %",
        title="Evaluation: tiers of the diffraction lobe (star: the default)",
    )  # fmt: skip
    axis.legend(fontsize=8)


def _fits(axis: Axes, frontier: Frontier) -> None:
    """Error that 95 % of fits keep to, with the median, against the median time."""
    points, colour = frontier.points, "#2f5fb3"
    times, errors = [q.seconds.median for q in points], [q.error.p95 for q in points]
    for number, q in enumerate(points, 1):
        time, error, star = q.seconds.median, q.error.p95, q.choice == default_choice()
        axis.plot([time, time], [q.error.median, error], "-", color=colour, **FAINT)
        axis.plot([time, q.seconds.p95], [error, error], "-", color=colour, **FAINT)
        axis.plot(
            time, error, "*" if star else "o", color="#c0392b" if star else colour, markersize=14 if star else 5,
            label=f"{number}: {q.choice}{' (default)' if star else ''}",
        )  # fmt: skip
        axis.annotate(str(number), (time, error), xytext=(5, 5), textcoords="offset points", fontsize=10)
    front = pareto(times, errors)
    axis.plot(
        [times[i] for i in front], [errors[i] for i in front], "-", color=colour, linewidth=1.2, drawstyle="steps-post"
    )
    axis.set(
        xlabel="seconds a file, once compiled: median (marked) to 95 %",
        ylabel="distance from the reference fit, relative: median to 95 % (marked)",
        title="Fits (star: the default)",
    )  # fmt: skip
    axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, handlelength=1)
