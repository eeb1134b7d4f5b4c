"""Data of the figures that have lines, once: the printed pictures and, as rows, the charts of the pages draw them."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ...model.parameters import SURFACES
from . import prediction
from .prediction import PEAK_DIFFERENCE_DEG, WIDEST_DEG, plane_of_incidence, viewers
from .subject import Subject

PAGE_INCIDENCES_DEG = (0, 15, 30, 45, 60, 75)
ON_PAGE = 61  # viewers of a lobe that see no row of theta_h
CURVES = ("fit", "file", "alone", "low", "high")
HALVES_SHOWN = 6.0  # half widths that the plot of normalised peaks reaches to
Rows = list[dict[str, Any]]
"""Rows of a chart: a row a direction and channel; what there is not is None."""
PARTS = {"specular": "reflection", "diffracted": "diffraction", "body": "body"}
"""What the sharp lobes and the body are called, by their names in the models."""


def part_name(lobe: str) -> str:
    """What a lobe or the body is called; of a sum with the surface that it is of."""
    kind, _, which = lobe.partition("_")
    return f"{PARTS.get(kind, kind)} ({SURFACES[which]})" if which in SURFACES else PARTS.get(lobe, lobe)


def lobe(subject: Subject, degrees: float, **named: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """File and fit in the plane of incidence.

    Args:
        degrees: theta_i. named: how many viewers lie between (`viewers`).

    Returns:
        viewers (deg), and which of them see a row of theta_h, (N,); by name what there is of `CURVES`, BRDF (1/sr),
        (C, N): ``alone`` is the fit without the grazing loss, ``low`` and ``high`` are of the posterior's predictions.
    """
    angles, is_datum = viewers(degrees, np.degrees(subject.grid.theta_h), **named)
    i, o = plane_of_incidence(np.radians(degrees), np.radians(angles))
    found = {"fit": prediction.predicted_lobe(subject.fitted, i, o)}
    if subject.measurement is not None:
        where = prediction.half_difference(i, o)
        found["file"] = prediction.measured_lobe(subject.measurement, subject.grid, *where)
    if subject.model.measured.loses:
        found["alone"] = prediction.predicted_lobe(subject.fitted, i, o, loss=False)
    if subject.likely is not None:
        found["low"], found["high"] = prediction.band(subject.likely, prediction.from_vectors(i, o))
    return angles, is_datum, found


def added(subject: Subject, degrees: float, **named: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """What each lobe and the body add in the plane of incidence: viewers (deg), and by part the middle channel's."""
    angles, _ = viewers(degrees, np.degrees(subject.grid.theta_h), **named)
    where = prediction.from_vectors(*plane_of_incidence(np.radians(degrees), np.radians(angles)))
    found = prediction.parts_of(subject.fitted, where).items()
    return angles, {part_name(name): brdf[len(subject.model.channels) // 2] for name, brdf in found}


def lobe_rows(subject: Subject) -> tuple[Rows, Rows]:
    """Rows of `lobe` and `added`: ``i``, ``o`` (deg), ``channel``, curves; ``i``, ``o``, ``part``, ``value``.

    Of the file only data are shown.
    """
    plane: Rows = []
    parts: Rows = []
    for degrees in PAGE_INCIDENCES_DEG:
        angles, is_datum, found = lobe(subject, degrees, between=ON_PAGE)
        kept = np.flatnonzero(is_datum | (np.abs(angles) < WIDEST_DEG))
        place = [{"i": degrees, "o": float(angles[k])} for k in kept]
        if "file" in found:
            found["file"] = np.where(is_datum, found["file"], np.nan)
        for c, channel in enumerate(subject.model.channels):
            curves = {name: found[name][c] if name in found else None for name in CURVES}
            plane += _rows(({**at, "channel": channel} for at in place), curves, kept)
        for part, brdf in added(subject, degrees, between=ON_PAGE)[1].items():
            parts += _rows(({**at, "part": part} for at in place), {"value": brdf}, kept)
    return plane, parts


def _rows(heads: Iterable[dict[str, Any]], curves: Mapping[str, np.ndarray | None], kept: Iterable[int]) -> Rows:
    """One a place: what is said of it, then numbers."""
    return [
        head | {name: float(x[k]) if x is not None and np.isfinite(x[k]) else None for name, x in curves.items()}
        for head, k in zip(heads, kept, strict=True)
    ]


def peak(subject: Subject) -> tuple[Rows, Rows, tuple[float, float]]:
    """Every datum of the peak above the horizon, and how wide it is.

    Returns:
        ``h`` (deg), ``channel``, ``near`` (1 where the width is to be seen), ``file``, ``fit`` (1/sr), and
        ``file_rel``, ``fit_rel``: over their values at the origin (HP17 Fig. 15); ``channel``, ``wavelength`` (nm),
        ``file``, ``fit``: where they have fallen to half (deg); theta_d and phi_d (deg).
    """
    grid, channels = subject.grid, subject.model.channels
    d = int(np.argmin(np.abs(np.degrees(grid.theta_d) - PEAK_DIFFERENCE_DEG)))
    p = len(grid.phi_d) // 2
    seen = grid.theta_h < np.pi / 2 - grid.theta_d[d]
    where = grid.theta_h[seen], grid.theta_d[d], grid.phi_d[p]
    fit = prediction.brdf_of(subject.fitted, prediction.from_half_difference(*where))
    file = np.full_like(fit, np.nan) if subject.measurement is None else subject.measurement.values[:, seen, d, p]
    degrees, brdf = np.degrees(grid.theta_h[seen]), {"file": file, "fit": fit}
    widths: Rows = [
        {"channel": channel, "wavelength": 1000 * subject.model.wavelengths_um[c],
         **{kind: half_width(degrees, x[c]) for kind, x in brdf.items()}}
        for c, channel in enumerate(channels)
    ]  # fmt: skip
    widest = max([0.0, *(row[kind] for row in widths for kind in brdf if row[kind])])
    near = degrees < min(HALVES_SHOWN * widest or 90.0, 90.0)
    at = [{"h": h, "near": int(x)} for h, x in zip(degrees, near, strict=True)]
    rows: Rows = []
    for c, channel in enumerate(channels):
        curves = {kind: x[c] for kind, x in brdf.items()} | {f"{kind}_rel": x[c] / x[c, 0] for kind, x in brdf.items()}
        rows += _rows(({**each, "channel": channel} for each in at), curves, range(len(at)))
    return rows, widths, (float(np.degrees(grid.theta_d[d])), float(np.degrees(grid.phi_d[p])))


def half_width(degrees: np.ndarray, values: np.ndarray) -> float | None:
    """Where values that fall from the first one reach half of it, linear between; None where they do not."""
    below = np.flatnonzero(values < values[0] / 2)
    if not below.size or below[0] == 0:
        return None
    k = below[0]
    share = (values[k - 1] - values[0] / 2) / (values[k - 1] - values[k])
    return float(degrees[k - 1] + share * (degrees[k] - degrees[k - 1]))
