"""FRED's scatter tables, ``.txt``: a line of two angles for each incidence, and lines of angles and BRDF behind it.

Angles are those to the normal and azimuths (degrees); at the azimuth of the incidence lies the specular direction.
"""

from pathlib import Path

import numpy as np

from .foreign import lines_of, numbers_of, stated_band, usable
from .scattered import ScatteredMeasurement
from .source import MerlError, contents

FIRST = "type bsdf_data"
FORMAT = {"angles": "deg", "bsdf": "value"}  # and a scale


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a file.

    Raises:
        MerlError: it cannot be read, is no such file, or has incidences at several azimuths.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    lines = lines_of(path, data, "FRED file")
    if not lines or " ".join(lines[0][1].lower().split()) != FIRST:
        raise MerlError(
            f"{path}: is no FRED file: its first line is not {FIRST!r}; if it is a table of directions, rename it .csv "
            "(docs/tables.md)"
        )
    scale = _scale(path, *lines[1]) if len(lines) > 1 else 1.0
    incidence, rows, places = None, [], []
    for number, line in lines[2:]:
        numbers = numbers_of(path, number, line)
        if len(numbers) == 2:
            incidence = numbers
        elif len(numbers) == 3 and incidence is not None:
            rows.append([*incidence, *numbers])
            places.append(number)
        else:
            raise MerlError(
                f"{path}: line {number} has {len(numbers)} numbers: an incidence has two angles, and each sample after "
                "it two angles and a value"
            )
    if not rows:
        raise MerlError(f"{path}: has no samples: lines of two angles and a value")
    theta_i, phi_i, theta_o, phi_o, value = np.array(rows).T
    if np.ptp(phi_i) > 0:
        raise MerlError(f"{path}: is anisotropic: its incidences have several azimuths; keep the lines of one")
    _check(path, places, theta_i, theta_o, phi_o)
    bands, notes = stated_band(path, "")
    with np.errstate(over="ignore"):  # no datum then
        value = scale * value
    phi = np.radians(180 - (phi_o - phi_i)) + np.pi * (theta_o < 0)
    measured = ScatteredMeasurement(
        path, "FRED", np.radians(theta_i), np.radians(np.abs(theta_o)), phi, value[None], np.ones(len(value)),
        bands, sha1, blob, notes=notes,
    )  # fmt: skip
    return usable(measured, lambda k: f"line {places[k]}")


def _scale(path: Path, number: int, line: str) -> float:
    """What values are multiplied by.

    Raises:
        MerlError: the line states no format, or one that is not read.
    """
    name, *pairs = line.split()
    stated = dict(pair.lower().split("=", 1) for pair in pairs if "=" in pair)
    wrong = {key: x for key, x in stated.items() if FORMAT.get(key, x) != x or key not in {*FORMAT, "scale"}}
    try:
        scale = float(stated.get("scale", "1"))
    except ValueError:
        scale = np.nan
    if name.lower() != "format" or wrong or not FORMAT.keys() <= stated.keys() or not 0 < scale < np.inf:
        raise MerlError(
            f"{path}: line {number}: {line[:60]!r} is not read, only 'format angles=deg bsdf=value scale=NUMBER'"
        )
    return scale


def _check(path: Path, places: list[int], theta_i: np.ndarray, theta_o: np.ndarray, phi_o: np.ndarray) -> None:
    """Refuse angles that are none of this side of the surface."""
    for name, x, most in (("incidence", theta_i, 90), ("scatter", np.abs(theta_o), 90), ("azimuth", phi_o, np.inf)):
        if (bad := np.flatnonzero(~((x >= 0) & (x <= most)) if most == 90 else ~np.isfinite(x))).size:
            k = int(bad[0])
            raise MerlError(f"{path}: line {places[k]}: its angle of {name}, {x[k]:g}, is no angle of reflected light")
