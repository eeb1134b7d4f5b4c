"""Lobes of file and fit in the plane of incidence, and their peak, with its width in each channel (HP17 Fig. 15)."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..pipeline.draws import NoPicture
from . import curves
from .style import (
    DECADES,
    DEGREES,
    FAINT,
    INK,
    MARKS,
    OKABE_ITO,
    at_mirror,
    channel_colour,
    marks,
    new,
    plain,
    printable,
)  # fmt: skip
from .subject import Subject

INCIDENCES_DEG = (0, 20, 40, 60, 80)
LINES = ("-", "--", "-.", ":")
HIGHLIGHT = 0.1  # of the rise from the darkest datum to the peak: every datum that is brighter than this is drawn


@printable
def lobes(
    subject: Subject, theta: Sequence[float] = INCIDENCES_DEG, channels: Sequence[str] = (),
    models: Mapping[str, Subject] | None = None,
) -> Figure:  # fmt: skip
    """One row an incidence: on a cube root scale of its own and, for shiny materials, on a logarithmic one.

    Data are those of all rows of theta_h, in the highlight every one, elsewhere every third of a channel. The fit is
    drawn with the grazing loss of the apparatus and, dashed, without it; of the posterior's predictions 5 to 95 % are
    shaded.

    Args:
        theta: incidences (deg). channels: by name; all by default, the middle one beside others' ``models``.
        models: fits of the same material by what they are called, whose lines are drawn beside this one's.
    """
    own = subject.model.channels
    if not theta or not all(0 <= x < 90 for x in theta):
        raise NoPicture(f"theta should be angles of the light from 0 to below 90 degrees, not {theta}")
    if wrong := [name for name in channels if name not in own]:
        raise NoPicture(f"there is no channel {wrong[0]!r}; there are {', '.join(own)}")
    chosen = [k for k, name in enumerate(own) if name in channels] or [*range(len(own))]
    if models and not channels:
        chosen = [len(own) // 2]
    figure = new(0.8 + 1.12 * len(theta))
    panels = figure.subplots(len(theta), 2, sharex=True, squeeze=False)
    draw = partial(_row_of_models, models=models) if models else _row
    ends = [draw(row, subject, degrees, chosen) for row, degrees in zip(panels, theta, strict=True)]
    darkest, brightest = np.nanmin([low for low, _ in ends]), np.nanmax([high for _, high in ends])
    for (root, log), (_, high) in zip(panels, ends, strict=True):
        root.set(ylim=(0, 1.1 * np.cbrt(high)))  # without the loss a fit is far brighter
        log.set(yscale="log", ylim=(max(darkest, brightest / 10**DECADES) / 2, 3 * brightest))
    panels[0, 0].set(title="cube root")
    panels[0, 1].set(title="logarithmic")
    for axis in panels[-1]:
        axis.set_xlabel(r"$\theta_o$ (deg)")
    panels[len(panels) // 2, 0].set_ylabel(r"BRDF$^{1/3}$ (sr$^{-1/3}$)")
    panels[len(panels) // 2, 1].set_ylabel("BRDF (1/sr)")
    _legend(figure, panels[0, 0], subject, chosen, models or {})
    subject.head(figure)
    return figure


def _row_of_models(
    row: np.ndarray, subject: Subject, degrees: float, chosen: Sequence[int], models: Mapping[str, Subject]
) -> tuple[float, float]:
    """As `_row`: the data in black, and a colour and a kind of line for each model."""
    angles, is_datum, found = curves.lobe(subject, degrees)
    seen = [found["file"][chosen]] if "file" in found else []
    for m, other in enumerate(models.values()):
        lines = curves.lobe(other, degrees)[2]["fit"]
        for c in chosen:
            at = other.model.channels.index(subject.model.channels[c])
            seen.append(lines[at : at + 1])
            for axis, scale in zip(row, (np.cbrt, np.asarray), strict=True):
                axis.plot(angles, scale(lines[at]), LINES[m % len(LINES)], color=OKABE_ITO[m % len(OKABE_ITO)])
    for c in chosen if "file" in found else ():
        for axis, scale in zip(row, (np.cbrt, np.asarray), strict=True):
            axis.plot(angles[is_datum], scale(found["file"][c][is_datum]), **_data(c))
    _place(row, degrees)
    whole = np.concatenate(seen)
    return float(np.nanmin(np.where(whole > 0, whole, np.nan))), float(np.nanmax(whole))


def _data(c: int) -> dict[str, Any]:
    return {**marks("", c, 1.6, 0.4), "color": INK, "zorder": 1}


def _place(row: np.ndarray, degrees: float) -> None:
    for axis in row:
        at_mirror(axis, degrees)
    row[0].text(0.03, 0.94, rf"$\theta_i = {degrees:g}^\circ$", transform=row[0].transAxes, va="top")


def _row(row: np.ndarray, subject: Subject, degrees: float, chosen: Sequence[int]) -> tuple[float, float]:
    """Draw one incidence; the darkest and the brightest value that is to be seen."""
    angles, is_datum, found = curves.lobe(subject, degrees)
    visible = found.get("file", found["fit"])
    for c in chosen:
        name = subject.model.channels[c]
        colour = channel_colour(name, c)
        for axis, scale in zip(row, (np.cbrt, np.asarray), strict=True):
            scaled = {curve: scale(x[c]) for curve, x in found.items()}
            axis.plot(angles, scaled["fit"], "-", color=colour)
            if "alone" in found:
                axis.plot(angles, scaled["alone"], "--", linewidth=0.6, color=colour)
            if "low" in found:
                axis.fill_between(angles, scaled["low"], scaled["high"], alpha=0.25, linewidth=0, color=colour)
            if "file" in found:
                turn = np.cumsum(is_datum) % len(chosen) == chosen.index(c)
                drawn = shown(np.where(is_datum, visible[c], np.nan), turn)
                axis.plot(angles[drawn], scaled["file"][drawn], **marks(name, c, 1.6, 0.4))
    _place(row, degrees)
    visible, fit = visible[chosen], found["fit"][chosen]
    if not np.isfinite(visible).any():  # an incidence at which the file has no datum
        visible = fit
    high = np.nanmax(np.where(np.isfinite(visible), np.fmax(fit, visible), np.nan))
    return float(np.nanmin(np.where(visible > 0, visible, np.nan))), float(high)


def shown(measured: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Which data of a channel are drawn: all of the highlight, elsewhere those of its turn. No mark hides another."""
    finite = np.isfinite(measured)
    if not finite.any():
        return finite
    low, high = np.nanmin(measured), np.nanmax(measured)
    return finite & (turn | (measured > low + HIGHLIGHT * (high - low)))


def _legend(figure: Figure, axis: Axes, subject: Subject, chosen: Sequence[int], models: Mapping[str, Subject]) -> None:
    what, mark = "file, fit" if subject.measurement else "fit", {"markersize": 2.5, "fillstyle": "none"}
    if models:
        handles: list[Artist] = [
            axis.plot([], [], LINES[m % len(LINES)], color=OKABE_ITO[m % len(OKABE_ITO)], label=plain(name))[0]
            for m, name in enumerate(models)
        ]
        if subject.measurement is not None:
            handles += [axis.plot([], [], label=f"{subject.channels[c]}: file", **_data(c))[0] for c in chosen]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return
    handles = [
        axis.plot(
            [], [], f"-{MARKS[c % 5]}", color=channel_colour(subject.model.channels[c], c),
            label=f"{subject.channels[c]}: {what}", **mark,
        )[0]
        for c in chosen
    ]  # fmt: skip
    if subject.model.measured.loses:
        handles += axis.plot([], [], "--", linewidth=0.6, color=FAINT, label="without the grazing loss")
    if subject.trusted is not None:
        handles.append(axis.fill_between([], [], color=FAINT, alpha=0.4, linewidth=0, label="posterior, 5 to 95 %"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


@printable
def peak(subject: Subject) -> Figure:
    """Every datum of the peak against theta_h; beside it the same over its value at the origin, as in HP17 Fig. 15."""
    rows, _, (theta_d, phi_d) = curves.peak(subject)
    figure = new(2.35)
    whole, widths = figure.subplots(1, 2)
    for c, channel in enumerate(subject.model.channels):
        own = [row for row in rows if row["channel"] == channel]
        for axis, ending, kept in ((whole, "", own), (widths, "_rel", [row for row in own if row["near"]])):
            keys = "h", f"file{ending}", f"fit{ending}"
            h, file, fit = np.array([[row[key] for row in kept] for key in keys], float)
            axis.plot(h, fit, "-", color=channel_colour(channel, c))
            axis.plot(h, file, label=subject.channels[c], **marks(channel, c, 2.0, 0.5))
    whole.set(xscale="log", yscale="log", xlabel=r"$\theta_h$ (deg)", ylabel="BRDF (1/sr)", title="every datum")
    whole.set_xticks(DEGREES, [f"{x:g}" for x in DEGREES])
    whole.legend(title="marks: file\nlines: fit", title_fontsize=6.0, loc="lower left")
    widths.set(xlabel=r"$\theta_h$ (deg)", ylabel="BRDF over its value at 0", title="width by channel")
    for axis in (whole, widths):
        axis.grid(alpha=0.25)
    where = rf"$\theta_d = {theta_d:.1f}^\circ$, $\phi_d = {phi_d:.0f}^\circ$"
    subject.head(figure, f"{where}")
    return figure
