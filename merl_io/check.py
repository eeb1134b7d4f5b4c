"""What a file holds, in a few numbers."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .bands import MERL
from .binary import Dims, Measurement
from .inputs import read, told
from .scattered import ScatteredMeasurement, half_difference


@dataclass(frozen=True)
class FileReport:
    """Summary of one file: dims, fraction of valid bins, counts of bad numbers, outliers, largest values (1/sr).

    Attributes:
        told: lines on what is left out of it, and what it looks like.
    """

    path: Path
    dims: Dims
    fraction_valid: float
    negative: int
    nan: int
    inf: int
    outliers: int
    largest: tuple[float, ...]
    genuine: str | None
    told: list[str]


@dataclass(frozen=True)
class ScatteredReport:
    """Summary of a file of scattered directions.

    Attributes:
        format: as of the measurement. samples: directions. channels: first and last, and how many. left_out: how many
            wavelengths of the file are not read. fraction_valid: of the values. theta_i, theta_o, theta_h: least and
            largest (deg). largest: value, 1/sr. brightest: theta_i, theta_o, phi of it (deg). told: as above.
    """

    path: Path
    format: str
    samples: int
    channels: tuple[str, str, int]
    left_out: int
    fraction_valid: float
    theta_i: tuple[float, float]
    theta_o: tuple[float, float]
    theta_h: tuple[float, float]
    largest: float
    brightest: tuple[float, float, float]
    told: list[str]


def summarise_scattered(m: ScatteredMeasurement) -> ScatteredReport:
    """The summary of a file that was read."""
    theta_h = half_difference(m.theta_i, m.theta_o, m.phi)[0]
    i, o, h = ((float(np.degrees(x.min())), float(np.degrees(x.max()))) for x in (m.theta_i, m.theta_o, theta_h))
    names, k = m.bands.names, int(np.argmax(np.max(np.nan_to_num(m.values, nan=-np.inf), axis=0)))
    at = (float(np.degrees(m.theta_i[k])), float(np.degrees(m.theta_o[k])), float(np.degrees(m.phi[k]) % 360))
    return ScatteredReport(
        m.path, m.format, len(m.theta_i), (names[0], names[-1], len(names)), m.left_out, float(m.valid.mean()),
        i, o, h, float(np.nanmax(m.values)), at, told(m),
    )  # fmt: skip


def summarise(measurement: Measurement) -> FileReport:
    """The summary of a file that was read."""
    found = dict(zip(measurement.bands.names, (float(np.nanmax(plane)) for plane in measurement.values), strict=True))
    largest = tuple(found.get(name, 0.0) for name in MERL.names)
    return FileReport(
        measurement.path, measurement.dims, float(measurement.valid.mean()), measurement.negative, measurement.nan,
        measurement.inf, measurement.outliers, largest, measurement.genuine, told(measurement),
    )  # fmt: skip


def inspect_file(path: str | os.PathLike[str], dims: Dims | None = None) -> FileReport | ScatteredReport:
    """Read and summarise; raises :class:`merlfit.merl_io.binary.MerlError` as :func:`read` does."""
    found = read(path, dims=dims)
    return summarise(found) if isinstance(found, Measurement) else summarise_scattered(found)
