"""Tables of scattered directions, CSV or NPZ, one column a wavelength: docs/tables.md is the format."""

import hashlib
import io
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .archive import arrays
from .bands import Bands
from .binary import BRIGHTEST
from .columns import ANGLES, WEIGHT, listed, spectral
from .delimited import read_lines, refuse
from .outliers import examined
from .scattered import ScatteredMeasurement
from .source import MerlError, contents

UNCERTAINTY = "uncertainty"
NAMES = (*ANGLES, "wavelengths_um", "values", WEIGHT, UNCERTAINTY)  # of an NPZ file's arrays; the last two may lack


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a table.

    Raises:
        MerlError: it cannot be read, or is none; the message names the line, the column and what is wrong.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    return _measured(path, (_npz if path.suffix.lower() == ".npz" else _csv)(path, data), sha1, blob)


def read_arrays(arrays: Mapping[str, ArrayLike], name: str) -> ScatteredMeasurement:
    """A table whose columns are arrays, named and shaped as in an NPZ file.

    Args:
        name: of the material; messages and the result call the table ``name``.npz.

    Raises:
        MerlError: it is no table; the message names the array and what is wrong.
    """
    path = Path(f"{name}.npz")
    if unknown := [str(key) for key in arrays if key not in NAMES]:
        raise MerlError(f"{path}: no array of a table is called {listed(unknown, ', ')}: {', '.join(NAMES)}")
    if wrong := [key for key, x in arrays.items() if np.iscomplexobj(x)]:
        raise MerlError(f"{path}: array {wrong[0]} holds complex numbers")
    try:  # copies: what is no datum becomes NaN, and these are the caller's
        numbers = {key: np.ma.filled(np.ma.array(x, float, copy=True), np.nan) for key, x in arrays.items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise MerlError(f"{path}: holds what is no number ({error})") from None
    digest = hashlib.sha1(b"".join(key.encode() + numbers[key].tobytes() for key in sorted(numbers))).hexdigest()
    return _measured(path, _of_arrays(path, numbers), digest, digest)


def _measured(path: Path, read: "Read", sha1: str, blob: str) -> ScatteredMeasurement:
    columns, values, uncertainty, bands, places = read
    values[~(np.abs(values) < BRIGHTEST)] = np.nan
    share = columns.get(WEIGHT, np.ones(values.shape[1]))
    if not np.any(np.isfinite(values) & (share > 0)):
        raise MerlError(
            f"{path}: holds no datum: every value is blank, NaN or above {BRIGHTEST:g}/sr, or has no weight"
        )
    measured = ScatteredMeasurement(path, "table", *upright(columns), values, share, bands, sha1, blob)
    if uncertainty is not None:
        uncertainty = np.where((uncertainty > 0) & np.isfinite(values), uncertainty, np.nan)
        some = bool(np.isfinite(uncertainty).any())
        notes = () if some else ("its uncertainties are all blank or 0, as if there were none",)
        measured = replace(measured, uncertainty=uncertainty if some else None, notes=notes)
    return examined(measured, places)


# Angles and weights by name (N,), values and their uncertainties (C, N), bands, and where each sample stands in the
# file, in words.
Read = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray | None, Bands, Callable[[int], str]]


def _csv(path: Path, data: bytes) -> Read:
    lines = read_lines(path, data)
    assert lines.columns is not None
    table = np.frombuffer(lines.numbers).reshape(-1, len(lines.names)).T
    columns = {name: table[k] * unit for name, (k, unit) in lines.columns.degrees.items()}
    stated, place = lines.columns.uncertainties, lambda k: f"line {lines.lines[k]}"
    uncertainty = None
    if stated.count(None) < len(stated):
        uncertainty = np.stack([np.full(table.shape[1], np.nan) if k is None else table[k] for k in stated])
    wrong = lines.wrong + impossible(columns, place) + negative(uncertainty, lines.columns.bands, place)
    refuse(path, wrong, lines.names)
    return columns, table[lines.columns.values], uncertainty, lines.columns.bands, place


def _npz(path: Path, data: bytes) -> Read:
    try:
        numbers = {name: x.astype(float) for name, x in arrays(io.BytesIO(data), NAMES.__contains__).items()}
    except ValueError as error:
        raise MerlError(f"{path}: is not a readable NPZ archive of numbers ({error})") from None
    return _of_arrays(path, numbers)


def _of_arrays(path: Path, columns: dict[str, np.ndarray]) -> Read:
    if missing := [name for name in NAMES[:-2] if name not in columns]:
        raise MerlError(f"{path}: has no array {missing[0]}; it needs {', '.join(NAMES[:-2])}")
    count, channels = len(np.atleast_1d(columns[ANGLES[0]])), columns["wavelengths_um"].size
    shapes = {**dict.fromkeys((*ANGLES, WEIGHT), (count,)), "wavelengths_um": (channels,)}
    shapes |= dict.fromkeys(blank := ("values", UNCERTAINTY), (count, channels))
    for name, x in columns.items():
        if x.shape != shapes[name]:
            raise MerlError(f"{path}: array {name} has shape {x.shape}, not {shapes[name]}")
        if (bad := np.argwhere(~np.isfinite(x) & ~(np.isnan(x) & (name in blank)))).size:
            raise MerlError(f"{path}: array {name} is not a finite number at {tuple(bad[0].tolist())}")
    if not count:
        raise MerlError(f"{path}: holds no samples")
    bands = spectral(path, columns.pop("wavelengths_um").tolist())
    values, uncertainty = columns.pop("values").T, columns.pop(UNCERTAINTY, None)
    uncertainty = None if uncertainty is None else uncertainty.T
    wrong = impossible(columns, place := lambda k: f"sample {k + 1}") + negative(uncertainty, bands, place)
    refuse(path, wrong, list(columns))
    return columns, values, uncertainty, bands, place


def impossible(columns: dict[str, np.ndarray], place: Callable[[int], str]) -> list[str]:
    """Directions below the horizon, and weights that are none."""
    wrong = [(k, f"{name} {columns[name][k]:g} is not in (-90, 90)")
             for name in ANGLES[:2] for k in np.flatnonzero(np.abs(columns[name]) >= 90)]  # fmt: skip
    if WEIGHT in columns:
        wrong += [(k, f"weight {columns[WEIGHT][k]:g} is negative") for k in np.flatnonzero(columns[WEIGHT] < 0)]
    return [f"{place(int(k))}: {why}" for k, why in sorted(wrong)]


def negative(uncertainty: np.ndarray | None, bands: Bands, place: Callable[[int], str]) -> list[str]:
    """Uncertainties (C, N) that are none."""
    if uncertainty is None:
        return []
    return [
        f"{place(k)}: the uncertainty of {bands.names[c]}, {uncertainty[c, k]:g}, is negative; leave it blank where "
        "none is known"
        for k, c in np.argwhere(uncertainty.T < 0).tolist()
    ]


def upright(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (rad) without the signs that goniometers give them: -30 at an azimuth is 30 at the opposite one."""
    theta_i, theta_o, phi = (np.radians(columns[name]) for name in ANGLES)
    return np.abs(theta_i), np.abs(theta_o), phi + np.pi * ((theta_i < 0) ^ (theta_o < 0))
