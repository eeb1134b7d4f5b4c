"""Tables of scattered directions, CSV or NPZ, one column a wavelength: docs/tables.md is the format."""

import csv
import io
import math
import re
import zipfile
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.npyio import NpzFile

from .archive import shape_of
from .bands import MERL, Bands
from .binary import BRIGHTEST
from .scattered import ScatteredMeasurement
from .source import MerlError, contents

ANGLES = ("theta_i_deg", "theta_o_deg", "phi_deg")
WEIGHT = "weight"
NO_DATUM = ("", "nan")  # a negative number is one: where a dark signal was subtracted, noise is on both sides of zero
LARGEST = 2**30  # bytes of an archive's arrays
PLAUSIBLE_UM = 0.1, 10.0
UNITS_UM = {"nm": 1e-3, "um": 1.0}


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a table.

    Raises:
        MerlError: it cannot be read, or is none; the message names the line, the column and what is wrong.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    columns, values, bands, places = (_npz if path.suffix.lower() == ".npz" else _csv)(path, data)
    _check(path, columns, places)
    values[~(np.abs(values) < BRIGHTEST)] = np.nan
    share = columns.get(WEIGHT, np.ones(values.shape[1]))
    if not np.any(np.isfinite(values) & (share > 0)):
        raise MerlError(
            f"{path}: holds no datum: every value is blank, NaN or above {BRIGHTEST:g}/sr, or has no weight"
        )
    theta_i, theta_o, phi = (np.radians(columns[name]) for name in ANGLES)
    return ScatteredMeasurement(path, "table", theta_i, theta_o, phi, values, share, bands, sha1, blob)


def bands_of(path: Path, names: list[str]) -> Bands:
    """Channels by the names of their columns: ``550nm`` or ``0.55um``, or R, G and B.

    Raises:
        MerlError: something else, or two of the same.
    """
    if set(names) == set(MERL.names):
        return MERL
    if (some := set(names) & set(MERL.names)) and len(some) == len(names):
        lacking = [name for name in MERL.names if name not in some]
        raise MerlError(f"{path}: has no column {lacking[0]}: R, G and B stand together")
    found = []
    for name in names:
        match = re.fullmatch(r"(\d+\.?\d*|\.\d+)(nm|um)", name)
        if match is None:
            raise MerlError(
                f"{path}: column {name!r} is none of {', '.join(ANGLES)}, {WEIGHT}, a wavelength such as 550nm or "
                "0.55um, or R, G and B"
            )
        found.append(round(float(match[1]) * UNITS_UM[match[2]], 9))
    return spectral(path, found)


def spectral(path: Path, wavelengths_um: list[float]) -> Bands:
    """Bands of wavelengths, named after these.

    Raises:
        MerlError: there are none, two are the same, or one is none.
    """
    for x in wavelengths_um:
        if not (math.isfinite(x) and PLAUSIBLE_UM[0] <= x <= PLAUSIBLE_UM[1]):
            raise MerlError(f"{path}: wavelength {x:g} um is not between {PLAUSIBLE_UM[0]:g} and {PLAUSIBLE_UM[1]:g}")
    names = tuple(f"{round(1e3 * x, 4):g}nm" for x in wavelengths_um)
    if not names:
        raise MerlError(f"{path}: has no column of values, such as 550nm")
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise MerlError(f"{path}: wavelength {twice[0]} is there twice")
    return Bands(names, tuple(wavelengths_um))


# Angles and weights by name (N,), values (C, N), bands, and where each sample stands in the file, in words.
Read = tuple[dict[str, np.ndarray], np.ndarray, Bands, Callable[[int], str]]


def _csv(path: Path, data: bytes) -> Read:
    text = io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", newline="")  # decoded line by line: no copy of all
    reader = csv.reader(text)
    head, numbers, lines = None, array("d"), array("l")
    try:
        for cells in reader:
            if not cells or cells[0].lstrip().startswith("#"):
                continue
            if head is None:
                head = _heads(path, cells)
                continue
            numbers.extend(_numbers(path, reader.line_num, head, cells))
            lines.append(reader.line_num)
    except UnicodeDecodeError:
        raise MerlError(f"{path}: is not a table: it is no UTF-8 text") from None
    except csv.Error as error:
        raise MerlError(f"{path}: is not a table: {error}") from None
    if head is None or not numbers:
        raise MerlError(f"{path}: is not a table: it has {'no lines of numbers' if head else 'no line of names'}")
    table = np.frombuffer(numbers).reshape(-1, len(head)).T
    columns = {name: table[k] for k, name in enumerate(head) if name in (*ANGLES, WEIGHT)}
    names = [name for name in head if name not in columns]
    bands = bands_of(path, names)
    order = bands.names if bands is MERL else names
    return columns, table[[head.index(name) for name in order]], bands, lambda k: f"line {lines[k]}"


def _heads(path: Path, cells: list[str]) -> list[str]:
    head = [cell.strip() for cell in cells]
    if missing := [name for name in ANGLES if name not in head]:
        commas = "" if len(head) > 1 else " with commas between"
        raise MerlError(f"{path}: its first line names no column {missing[0]}; it needs {', '.join(ANGLES)}{commas}")
    if "" in head:
        raise MerlError(f"{path}: column {head.index('') + 1} has no name; is there a comma too many?")
    if twice := [name for k, name in enumerate(head) if name in head[:k]]:
        raise MerlError(f"{path}: column {twice[0]!r} is there twice")
    return head


def _numbers(path: Path, line: int, head: list[str], cells: list[str]) -> list[float]:
    if len(cells) != len(head):
        raise MerlError(f"{path}: line {line} has {len(cells)} cells, and there are {len(head)} columns")
    try:
        found = [float(cell) for cell in cells]
    except ValueError:
        found = [_number(cell) for cell in cells]
    for name, cell, x in zip(head, cells, found, strict=True):
        if not math.isfinite(x) and not (name not in (*ANGLES, WEIGHT) and cell.strip().lower() in NO_DATUM):
            mend = "" if name in (*ANGLES, WEIGHT) else "; leave the cell of a missing value blank"
            raise MerlError(f"{path}: line {line}: {name} is {cell.strip()!r}, not a finite number{mend}")
    return found


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _npz(path: Path, data: bytes) -> Read:
    names = (*ANGLES, "wavelengths_um", "values", WEIGHT)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
        if size > LARGEST:
            raise MerlError(f"{path}: holds {size} bytes, more than the {LARGEST} that a table may have")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            found = {name: _array(arrays, name) for name in names if name in arrays.files}
    except MerlError:
        raise
    except Exception as error:  # of any kind: zipfile, zlib and NumPy raise many
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise MerlError(f"{path}: is not a readable NPZ archive of numbers ({said})") from None
    if missing := [name for name in names if name not in found and name != WEIGHT]:
        raise MerlError(f"{path}: has no array {missing[0]}; it needs {', '.join(names[:-1])}")
    count, channels = len(np.atleast_1d(found[ANGLES[0]])), found["wavelengths_um"].size
    shapes = {**dict.fromkeys((*ANGLES, WEIGHT), (count,)), "wavelengths_um": (channels,), "values": (count, channels)}
    for name, x in found.items():
        if x.shape != shapes[name]:
            raise MerlError(f"{path}: array {name} has shape {x.shape}, not {shapes[name]}")
        if (bad := np.argwhere(~np.isfinite(x) & ~(np.isnan(x) & (name == "values")))).size:
            raise MerlError(f"{path}: array {name} is not a finite number at {tuple(bad[0].tolist())}")
    if not count:
        raise MerlError(f"{path}: holds no samples")
    bands = spectral(path, found.pop("wavelengths_um").tolist())
    return found, found.pop("values").T, bands, lambda k: f"sample {k + 1}"


def _array(arrays: NpzFile, name: str) -> np.ndarray:
    """Numbers, looked at before memory is taken for them."""
    archive: Any = arrays.zip  # there as long as the file is open
    shape_of(archive, name)
    return np.asarray(arrays[name], float)


def _check(path: Path, columns: dict[str, np.ndarray], places: Callable[[int], str]) -> None:
    """Refuse directions below the horizon and weights that are none."""
    for name in ANGLES[:2]:
        if (bad := np.flatnonzero((columns[name] < 0) | (columns[name] >= 90))).size:
            raise MerlError(f"{path}: {places(bad[0])}: {name} {columns[name][bad[0]]:g} is not in [0, 90)")
    if WEIGHT in columns and (bad := np.flatnonzero(columns[WEIGHT] < 0)).size:
        raise MerlError(f"{path}: {places(bad[0])}: weight {columns[WEIGHT][bad[0]]:g} is negative")
