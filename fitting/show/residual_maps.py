"""Fit over file: along theta_h and theta_d, and where on the map of both the fit is wrong."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from ...merl_io.samples import folded
from ..fit.weights import within
from . import prediction
from .style import DEGREES, FAINT, channel_colour, new, printable
from .subject import Subject

AZIMUTHS = 7  # of 180, of the residuals along an angle
LEAST_RATIO, MOST_RATIO = 1.3, 12.0  # of fit and file: how far these panels reach
TICKS = 1.1, 1.25, 1.5, 2, 3, 5, 10
FACTOR_SHOWN = 4.0  # of fit and file, at the ends of the map's scale
ROW_TICKS = (0, 1, 5, 15, 30, 60, 90)  # theta_h (deg), on the map


@printable
def residuals(subject: Subject) -> Figure:
    """Median of fit over file over the other angles, the middle 80 % shaded; dashed without the grazing loss."""
    subject.bins  # noqa: B018 - says so if there is none
    figure = new(2.5)
    panels = figure.subplots(1, 2, sharey=True)
    widest = max(
        _ratios(panels, subject, loss) for loss in ((True, False) if subject.model.measured.loses else (True,))
    )
    panels[0].set(xscale="log", xlabel=r"$\theta_h$ (deg)", ylabel="fit over file")
    panels[0].set_xticks(DEGREES, [f"{x:g}" for x in DEGREES])
    panels[1].set(xlabel=r"$\theta_d$ (deg)", xticks=[0, 30, 60, 90])
    shown = [x for x in TICKS if widest**0.1 < x < widest]  # neither beyond the axis nor upon each other
    ticks = {1 / x: f"1/{x:g}" for x in shown} | {x: f"{x:g}" for x in shown}
    for axis in panels:
        axis.axhline(1.0, color=FAINT, linewidth=0.6)
        axis.set(yscale="log", ylim=(1 / widest, widest))
        axis.set_yticks([1.0, *ticks], ["1", *ticks.values()])
        axis.set_yticks([], minor=True)
        axis.grid(alpha=0.25)
    handles = [
        panels[1].plot([], [], "-", color=channel_colour(name, c), label=name)[0]
        for c, name in enumerate(subject.channels)
    ]
    if subject.model.measured.loses:
        handles += panels[1].plot([], [], "--", linewidth=0.6, color=FAINT, label="without the grazing loss")
    handles.append(panels[1].fill_between([], [], color=FAINT, alpha=0.3, linewidth=0, label="10 to 90 %"))
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    subject.head(figure)
    return figure


def _ratios(panels: np.ndarray, subject: Subject, loss: bool) -> float:
    """Draw what is with the loss or without it; how far the panels should reach."""
    grid, file, widest = subject.grid, subject.bins, LEAST_RATIO
    d, p = np.arange(0, len(grid.theta_d), 2), np.linspace(0, len(grid.phi_d) - 1, AZIMUTHS).astype(int)
    where = grid.theta_h[:, None, None], grid.theta_d[d][None, :, None], grid.phi_d[p][None, None, :]
    here = np.ix_(np.arange(len(grid.theta_h)), d, p)
    inside = (file.valid & grid.above & within(grid, subject.theta_max))[here]
    geometry = prediction.from_half_difference(*where)
    fitted = prediction.brdf_of(subject.fitted, geometry, loss)
    for c, name in enumerate(subject.channels):
        data, colour = file.values[c][here], channel_colour(name, c)
        ratio = np.where(inside & (data > 0), fitted[c] / np.where(inside & (data > 0), data, 1.0), np.nan)
        for axis, angle, others in ((panels[0], grid.theta_h, (1, 2)), (panels[1], grid.theta_d[d], (0, 2))):
            widest = max(widest, _median(axis, np.degrees(angle), ratio, others, colour, "-" if loss else "--"))
    return min(widest, MOST_RATIO)


def _median(
    axis: Axes, degrees: np.ndarray, ratio: np.ndarray, others: tuple[int, int], colour: str, line: str
) -> float:
    """Draw quantiles over other angles; how far the axis should reach to show nearly all of them."""
    some = np.isfinite(ratio).any(others)
    low, middle, high = np.nanquantile(
        ratio[some] if others == (1, 2) else ratio[:, some], [0.1, 0.5, 0.9], axis=others
    )
    axis.plot(degrees[some], middle, line, color=colour, linewidth=0.8 if line == "-" else 0.6)
    if line != "-":
        return LEAST_RATIO
    axis.fill_between(degrees[some], low, high, alpha=0.15, linewidth=0, color=colour)
    edges = np.concatenate([low, high])
    return float(np.quantile(np.maximum(edges, 1 / edges), 0.95))


@printable
def errors(subject: Subject) -> Figure:
    """Maps over theta_h and theta_d: fit over file, and how far cube roots are apart, both over phi_d and channels.

    The first is relative and says where the fit is too bright or too dark, the second where that is to be seen.
    """
    file, grid = subject.bins, subject.grid
    values, valid = folded(file)
    fit = subject.predicted
    used = valid & within(grid, subject.theta_max)[..., : valid.shape[-1]] & np.all((values > 0) & (fit > 0), 0)
    ratio = np.log2(np.where(used, fit, 1) / np.where(used, values, 1)).mean(0)
    apart = np.mean((np.cbrt(np.where(used, fit, 0)) - np.cbrt(np.where(used, values, 0))) ** 2, 0)
    count = np.maximum(used.sum(-1), 1)
    there = used.any(-1)
    relative = np.where(there, ratio.sum(-1) / count, np.nan)
    absolute = np.where(there, np.sqrt(apart.sum(-1) / count), np.nan)
    figure, most = new(2.75), np.log2(FACTOR_SHOWN)
    panels = figure.subplots(1, 2, sharey=True)
    drawn = _map(panels[0], subject, relative, cmap="PuOr", norm=TwoSlopeNorm(0, -most, most))
    bar = figure.colorbar(drawn, ax=panels[0], ticks=[-2, -1, 0, 1, 2], extend="both", location="bottom")
    bar.ax.set_xticklabels(["1/4", "1/2", "1", "2", "4"])
    bar.set_label("fit over file")
    drawn = _map(panels[1], subject, absolute, cmap="OrRd", vmin=0, vmax=float(np.nanquantile(absolute, 0.995)))
    figure.colorbar(drawn, ax=panels[1], extend="max", location="bottom").set_label(r"apart (sr$^{-1/3}$)")
    panels[0].set(title="relative", ylabel=r"$\theta_d$ (deg)")
    panels[1].set(title="of cube roots")
    subject.head(figure)
    return figure


def _map(axis: Axes, subject: Subject, values: np.ndarray, **named: Any) -> QuadMesh:  # noqa: ANN401 - as matplotlib takes them
    edges = [np.degrees(edge) for edge in subject.grid.edges[:2]]
    axis.set_facecolor("#dddddd")
    axis.set_xticks(np.sqrt(np.array(ROW_TICKS) / 90), [str(x) for x in ROW_TICKS])
    axis.set(xlabel=r"$\theta_h$ (deg), as MERL's rows", yticks=[0, 30, 60, 90])
    return axis.pcolormesh(np.sqrt(edges[0] / 90), edges[1], values.T, rasterized=True, **named)
