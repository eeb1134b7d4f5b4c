"""Numbers of the charts on a material's page: a row a direction and channel; what there is not is None."""

from typing import Any

import numpy as np

from ...model.geometry import Geometry
from . import prediction
from .peak import peak_of
from .prediction import WIDEST_DEG, plane_of_incidence, viewers
from .spheres import PARTS
from .subject import Subject

INCIDENCES_DEG = (0, 15, 30, 45, 60, 75)
BETWEEN = 61  # viewers of a lobe that see no row of theta_h
Rows = list[dict[str, Any]]


def lobes(subject: Subject) -> tuple[Rows, Rows]:
    """Lobes in the plane of incidence, and what they consist of.

    Returns:
        ``i``, ``o`` (deg), ``channel``, ``file``, ``fit``, ``alone`` (without the grazing loss), ``low`` and ``high``
        of the posterior's predictions; ``i``, ``o``, ``part``, ``value`` of what each lobe and the body add, of the
        middle channel.
    """
    plane: Rows = []
    parts: Rows = []
    for degrees in INCIDENCES_DEG:
        angles, is_datum = viewers(degrees, np.degrees(subject.grid.theta_h), BETWEEN)
        shown = np.flatnonzero(is_datum | (np.abs(angles) < WIDEST_DEG))
        plane += _plane(subject, degrees, angles, is_datum, shown)
        i, o = plane_of_incidence(np.radians(degrees), np.radians(angles))
        added = prediction.parts_of(subject.fitted, Geometry.from_vectors(i, o))
        for name, brdf in added.items():
            lobe = brdf[len(subject.model.channels) // 2]
            parts += [
                {
                    "i": degrees,
                    "o": short(float(angles[k]), 5),
                    "part": PARTS.get(name, name),
                    "value": short(float(lobe[k])),
                }
                for k in shown
            ]
    return plane, parts


def _plane(subject: Subject, degrees: float, angles: np.ndarray, is_datum: np.ndarray, shown: np.ndarray) -> Rows:
    m, file = subject.model, subject.measurement
    i, o = plane_of_incidence(np.radians(degrees), np.radians(angles))
    none = np.full((len(m.channels), len(angles)), np.nan)
    fit = prediction.predicted_lobe(subject.fitted, i, o)
    alone = prediction.predicted_lobe(subject.fitted, i, o, loss=False) if m.measured.loses else none
    seen = none if file is None else prediction.measured_lobe(file, subject.grid, *prediction.half_difference(i, o))
    seen = np.where(is_datum, seen, np.nan)
    bands = none[None].repeat(2, 0)
    if subject.likely is not None:
        bands = prediction.band(subject.likely, Geometry.from_vectors(i, o))
    columns = {"fit": fit, "file": seen, "alone": alone, "low": bands[0], "high": bands[1]}
    return [
        {"i": degrees, "o": short(float(angles[k]), 5), "channel": channel}
        | {name: short(float(values[c, k])) for name, values in columns.items()}
        for c, channel in enumerate(m.channels)
        for k in shown
    ]


def peak(subject: Subject) -> tuple[Rows, Rows]:
    """Of file and fit at one theta_d and phi_d, over theta_h; as HP17 Fig. 15, also over their values at the origin.

    Returns:
        ``h`` (deg), ``channel``, ``file``, ``fit``, ``file_rel``, ``fit_rel``, ``near`` (1 where the width is to be
        seen); ``channel``, ``wavelength`` (nm), and theta_h (deg) at which it has fallen to half: ``file``, ``fit``.
    """
    found, rows, widths = peak_of(subject), [], []
    for c, channel in enumerate(subject.model.channels):
        halves = {"file": found.file_half[c], "fit": found.fit_half[c]}
        wavelength = 1000 * subject.model.wavelengths_um[c]
        widths.append({"channel": channel, "wavelength": wavelength} | halves)
        rows += [
            {
                "h": short(float(h)), "channel": channel, "file": short(float(file)), "fit": short(float(fit)),
                "file_rel": short(file / found.file[c, 0]), "fit_rel": short(fit / found.fit[c, 0]),
                "near": int(h < found.reach_deg),
            }
            for h, file, fit in zip(found.theta_h_deg, found.file[c], found.fit[c], strict=True)
        ]  # fmt: skip
    return rows, widths


def short(x: float, digits: int = 4) -> float | None:
    """A number of few digits; None for none."""
    return float(f"{x:.{digits}g}") if np.isfinite(x) else None
