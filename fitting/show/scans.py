"""The picture of scans: samples of scattered directions against the viewer's angle, for each angle of incidence."""

import numpy as np
from matplotlib.figure import Figure

from ..fit.total_scatter import incidences_of
from ..pipeline.draws import NoPicture
from . import prediction
from .style import DECADES, at_mirror, marks, new, printable
from .subject import Subject

BESIDE_DEG = 2.0  # samples so near to the plane of incidence, and to an incidence, are drawn
SHOWN = 3  # channels that are drawn
MOST = 8  # panels


@printable
def scans(subject: Subject) -> Figure:
    """A panel an incidence: samples beside the plane of incidence against the signed angle of the viewer, and the fit.

    The angle theta_s is positive on the mirror's side. The fit is as the apparatus would have measured it. Of many
    channels three are drawn, of many incidences eight, evenly chosen.
    """
    m = subject.scattered
    if m is None:
        raise NoPicture("the file does not hold scattered directions, or is not there")
    across = np.degrees(np.arcsin(np.abs(np.sin(m.theta_o) * np.sin(m.phi))))  # from the plane
    theta_s = np.degrees(m.theta_o) * np.where(np.cos(m.phi) < 0, 1, -1)
    every = [
        (float(np.degrees(t)), (across < BESIDE_DEG) & (np.abs(np.degrees(m.theta_i - t)) < BESIDE_DEG))
        for t in incidences_of(m)
    ]
    every = [(degrees, near) for degrees, near in every if near.any()]
    if not every:
        raise NoPicture("no samples of the file lie in a plane of incidence")
    shown = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, MOST).round().astype(int))]
    order = np.argsort(subject.model.wavelengths_um)
    chosen = order[np.unique(np.linspace(0, len(order) - 1, SHOWN).round().astype(int))]
    rows = -(-len(shown) // 2)
    figure = new(0.7 + 1.3 * rows)
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).ravel()
    seen = []
    for axis, (degrees, near) in zip(panels, shown, strict=False):
        angles, _ = prediction.viewers(degrees, np.degrees(subject.grid.theta_h))
        fit = prediction.predicted_lobe(
            subject.fitted, *prediction.plane_of_incidence(np.radians(degrees), np.radians(angles))
        )
        for c in chosen:
            look = marks(subject.model.channels[c], c, 2.0, 0.5)
            axis.plot(angles, fit[c], "-", color=look["color"])
            axis.plot(theta_s[near], np.where(m.values[c] > 0, m.values[c], np.nan)[near], **look)
        at_mirror(axis, degrees)
        axis.text(0.03, 0.94, rf"$\theta_i = {degrees:.3g}^\circ$", transform=axis.transAxes, va="top")
        seen.append(m.values[chosen][:, near])
    values = np.concatenate([x.ravel() for x in seen])
    if not np.any(values > 0):
        raise NoPicture("no samples of these channels in a plane of incidence are above 0")
    low, high = (float(end(values[values > 0])) for end in (np.nanmin, np.nanmax))
    panels[0].set(yscale="log", ylim=(max(low, high / 10**DECADES) / 2, 3 * high), xlim=(-99, 99))
    for axis in panels[len(shown) :]:
        axis.set_axis_off()
    for axis in panels[max(len(shown) - 2, 0) : len(shown)]:
        axis.set_xlabel(r"$\theta_s$ (deg)")
        axis.tick_params(labelbottom=True)
    panels[2 * (rows // 2)].set_ylabel("BRDF (1/sr)")
    handles = [
        panels[0].plot([], [], **{**marks(subject.model.channels[c], c, 2.5, 0.5), "linestyle": "-"},
                       label=f"{subject.channels[c]}: file, fit")[0]
        for c in chosen
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    subject.head(figure)
    return figure
