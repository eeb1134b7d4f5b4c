"""Lobes of file and fit in the plane of incidence."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...model.geometry import Geometry
from . import prediction
from .prediction import plane_of_incidence, viewers
from .style import FAINT, MARKS, channel_colour, new, printable
from .subject import Subject

INCIDENCES_DEG = (0, 20, 40, 60, 80)
HIGHLIGHT = 0.1  # of the rise from the darkest datum to the peak: every datum that is brighter than this is drawn
DECADES = 6.0  # that the logarithmic scale reaches below the brightest value


@printable
def lobes(subject: Subject) -> Figure:
    """One row an incidence: on a cube root scale and, for shiny materials, on a logarithmic one.

    Data are those of all rows of theta_h, in the highlight every one, elsewhere every third of a channel. The fit is
    drawn with the grazing loss of the apparatus and, dashed, without it; of the posterior's predictions 5 to 95 % are
    shaded.
    """
    figure = new(6.4)
    panels = figure.subplots(len(INCIDENCES_DEG), 2, sharex=True, sharey="col")
    ends = [_row(row, subject, degrees) for row, degrees in zip(panels, INCIDENCES_DEG, strict=True)]
    darkest, brightest = np.nanmin([low for low, _ in ends]), np.nanmax([high for _, high in ends])
    panels[0, 0].set(title="cube root", ylim=(0, 1.1 * np.cbrt(brightest)))  # without the loss a fit is far brighter
    panels[0, 1].set(title="logarithmic", yscale="log", ylim=(max(darkest, brightest / 10**DECADES) / 2, 3 * brightest))
    for axis in panels[-1]:
        axis.set_xlabel(r"$\theta_o$ (deg)")
    panels[len(panels) // 2, 0].set_ylabel(r"BRDF$^{1/3}$ (sr$^{-1/3}$)")
    panels[len(panels) // 2, 1].set_ylabel("BRDF (1/sr)")
    _legend(figure, panels[0, 0], subject)
    figure.suptitle(subject.heading)
    return figure


def _row(row: np.ndarray, subject: Subject, degrees: float) -> tuple[float, float]:
    """Draw one incidence; the darkest and the brightest value that is to be seen."""
    model, grid = subject.model, subject.grid
    angles, is_datum = viewers(degrees, np.degrees(grid.theta_h))
    i, o = plane_of_incidence(np.radians(degrees), np.radians(angles))
    fitted = prediction.predicted_lobe(subject.fitted, i, o)
    alone = prediction.predicted_lobe(subject.fitted, i, o, loss=False) if model.measured.loses else None
    likely, file = subject.likely, subject.measurement
    shaded = None if likely is None else prediction.band(likely, Geometry.from_vectors(i, o))
    seen = np.full_like(fitted, np.nan)
    if file is not None:
        seen = prediction.measured_lobe(file, grid, *prediction.half_difference(i, o))
    for c, name in enumerate(model.channels):
        colour = channel_colour(name, c)
        drawn = shown(np.where(is_datum, seen[c], np.nan), np.cumsum(is_datum) % len(seen) == c)
        for axis, scale in zip(row, (np.cbrt, np.asarray), strict=True):
            axis.plot(angles, scale(fitted[c]), "-", color=colour)
            if alone is not None:
                axis.plot(angles, scale(alone[c]), "--", linewidth=0.6, color=colour)
            if shaded is not None:
                axis.fill_between(angles, *scale(shaded[:, c]), alpha=0.25, linewidth=0, color=colour)
            axis.plot(angles[drawn], scale(seen[c, drawn]), MARKS[c % len(MARKS)], markersize=1.6, fillstyle="none",
                      color=colour, markeredgewidth=0.4)  # fmt: skip
    for axis in row:
        axis.axvline(degrees, color=FAINT, linewidth=0.5, linestyle=":")
        axis.set_xticks([-90, -45, 0, 45, 90])
        axis.grid(alpha=0.25)
    row[0].text(0.03, 0.94, rf"$\theta_i = {degrees}^\circ$", transform=row[0].transAxes, va="top")
    visible = seen if file is not None else fitted
    high = np.nanmax(np.where(np.isfinite(visible), np.fmax(fitted, seen), np.nan))
    return float(np.nanmin(np.where(visible > 0, visible, np.nan))), float(high)


def shown(measured: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Which data of a channel are drawn: all of the highlight, elsewhere those of its turn. No mark hides another."""
    finite = np.isfinite(measured)
    if not finite.any():
        return finite
    low, high = np.nanmin(measured), np.nanmax(measured)
    return finite & (turn | (measured > low + HIGHLIGHT * (high - low)))


def _legend(figure: Figure, axis: Axes, subject: Subject) -> None:
    what, mark = "file, fit" if subject.measurement else "fit", {"markersize": 2.5, "fillstyle": "none"}
    handles: list[Artist] = [
        axis.plot([], [], f"-{MARKS[c % 5]}", color=channel_colour(name, c), label=f"{name}: {what}", **mark)[0]
        for c, name in enumerate(subject.channels)
    ]
    if subject.model.measured.loses:
        handles += axis.plot([], [], "--", linewidth=0.6, color=FAINT, label="without the grazing loss")
    if subject.trusted is not None:
        handles.append(axis.fill_between([], [], color=FAINT, alpha=0.4, linewidth=0, label="posterior, 5 to 95 %"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
