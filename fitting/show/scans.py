"""The picture of scans: samples of scattered directions against the viewer's angle, for each angle of incidence."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...merl_io.scattered import ScatteredMeasurement
from ..fit.total_scatter import incidences_of
from ..pipeline.draws import NoPicture
from . import prediction
from .style import DECADES, at_mirror, marks, new, printable
from .subject import Subject

BESIDE_DEG = 2.0  # samples so near to the plane of incidence, and to an incidence, are drawn
SHOWN = 3  # channels that are drawn
MOST = 8  # panels


def beside_plane(m: ScatteredMeasurement, theta_i: float) -> tuple[np.ndarray, np.ndarray]:
    """Signed angles of samples' viewers (deg), positive on the mirror's side, and which samples are beside the plane.

    Args:
        theta_i: the incidence (rad).
    """
    across = np.degrees(np.arcsin(np.abs(np.sin(m.theta_o) * np.sin(m.phi))))
    near = (across < BESIDE_DEG) & (np.abs(np.degrees(m.theta_i - theta_i)) < BESIDE_DEG)
    return np.degrees(m.theta_o) * np.where(np.cos(m.phi) < 0, 1, -1), near


def _vectors(m: ScatteredMeasurement, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of light (towards ``-x``) and viewer of samples, (N, 3) each."""
    i, o, phi = m.theta_i[rows], m.theta_o[rows], m.phi[rows]
    light = np.stack([-np.sin(i), np.zeros_like(i), np.cos(i)], -1)
    return light, np.stack([-np.sin(o) * np.cos(phi), -np.sin(o) * np.sin(phi), np.cos(o)], -1)


@dataclass(frozen=True)
class Scan:
    """Samples beside the plane of incidence, in the order of the viewer's signed angle.

    Attributes:
        degrees: theta_i. theta_s: of the viewers (deg), (N,). file, fit: BRDF (1/sr), (C, N); the fit in the samples'
            own directions, as the apparatus would have measured it.
    """

    degrees: float
    theta_s: np.ndarray
    file: np.ndarray
    fit: np.ndarray


def scans_of(subject: Subject) -> list[Scan]:
    """A scan for each angle of incidence that has samples beside its plane; NoPicture where none has."""
    m = subject.scattered
    if m is None:
        raise NoPicture("the file does not hold scattered directions, or is not there")
    found = [(float(np.degrees(theta_i)), *beside_plane(m, theta_i)) for theta_i in incidences_of(m)]
    most = max((int(np.count_nonzero(near)) for _, _, near in found), default=0)  # one compiled program for all
    scans = []
    for degrees, theta_s, near in found:
        rows = np.flatnonzero(near)[np.argsort(theta_s[near])]
        if len(rows):
            i, o = _vectors(m, np.pad(rows, (0, most - len(rows)), mode="edge"))
            fit = prediction.predicted_lobe(subject.fitted, i, o)[:, : len(rows)]
            scans.append(Scan(degrees, theta_s[rows], m.values[:, rows], fit))
    if not scans:
        raise NoPicture("no samples of the file lie in a plane of incidence")
    return scans


def in_numbers(subject: Subject) -> dict[str, Any]:
    """Scans of the middle channel as a table's rows.

    Returns:
        ``channel``: its name, None of a file with one alone; ``table``: of each incidence ``degrees``, ``count`` of
        samples, ``brightest`` of them (1/sr), ``at`` (deg), ``fit`` (1/sr) there, and of the fit over the file
        ``median``, ``low`` and ``high`` (5 and 95 %) over viewers up to ``farthest`` (deg), to which it was fitted, NaN
        where no sample is above 0; ``samples``: of each incidence its ``rows`` of theta_s, file and fit.
    """
    channels = subject.model.channels
    c = int(np.argsort(subject.model.wavelengths_um)[len(channels) // 2])
    table, samples, farthest = [], [], float(np.degrees(subject.theta_max))
    for scan in scans_of(subject):
        lit = scan.file[c] > 0
        theta_s, file, fit = scan.theta_s[lit], scan.file[c][lit], scan.fit[c][lit]
        k = int(np.argmax(file)) if lit.any() else None
        brightest, at, there = (np.nan,) * 3 if k is None else (file[k], theta_s[k], fit[k])
        ratio = (fit / file)[np.abs(theta_s) <= farthest]
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95]) if ratio.size else [np.nan] * 3
        table.append({
            "degrees": scan.degrees, "count": int(np.isfinite(scan.file[c]).sum()), "brightest": brightest, "at": at,
            "fit": there, "median": middle, "low": low, "high": high,
        })  # fmt: skip
        samples.append({"degrees": scan.degrees, "rows": list(zip(theta_s, file, fit, strict=True))})
    return {
        "channel": channels[c] if len(channels) > 1 else None,
        "farthest": farthest,
        "table": table,
        "samples": samples,
    }


@printable
def scans(subject: Subject) -> Figure:
    """A panel an incidence: samples beside the plane of incidence against the signed angle of the viewer, and the fit.

    The fit is drawn for the samples' own directions, up to `BESIDE_DEG` off the plane and off the incidence, as the
    apparatus would have measured it: a narrow lobe would be another one in the plane itself. Of many channels three are
    drawn, of many incidences eight, evenly chosen.
    """
    every = scans_of(subject)
    shown = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, MOST).round().astype(int))]
    order = np.argsort(subject.model.wavelengths_um)
    chosen = order[np.unique(np.linspace(0, len(order) - 1, SHOWN).round().astype(int))]
    down = -(-len(shown) // 2)
    figure = new(0.7 + 1.3 * down)
    panels = figure.subplots(down, 2, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, scan in zip(panels, shown, strict=False):
        for c in chosen:
            look = marks(subject.model.channels[c], c, 2.0, 0.5)
            axis.plot(scan.theta_s, scan.fit[c], "-", color=look["color"])
            axis.plot(scan.theta_s, np.where(scan.file[c] > 0, scan.file[c], np.nan), **look)
        at_mirror(axis, scan.degrees)
        axis.text(0.03, 0.94, rf"$\theta_i = {scan.degrees:.3g}^\circ$", transform=axis.transAxes, va="top")
    values = np.concatenate([scan.file[chosen].ravel() for scan in shown])
    if not np.any(values > 0):
        raise NoPicture("no samples of these channels in a plane of incidence are above 0")
    low, high = (float(end(values[values > 0])) for end in (np.nanmin, np.nanmax))
    panels[0].set(yscale="log", ylim=(max(low, high / 10**DECADES) / 2, 3 * high), xlim=(-99, 99))
    for axis in panels[len(shown) :]:
        axis.set_axis_off()
    for axis in panels[max(len(shown) - 2, 0) : len(shown)]:
        axis.set_xlabel(r"$\theta_s$ (deg)")
        axis.tick_params(labelbottom=True)
    panels[2 * (down // 2)].set_ylabel("BRDF (1/sr)")
    handles = [
        panels[0].plot([], [], **{**marks(subject.model.channels[c], c, 2.5, 0.5), "linestyle": "-"},
                       label=f"{subject.channels[c]}: file, fit")[0]
        for c in chosen
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    subject.head(figure)
    return figure
