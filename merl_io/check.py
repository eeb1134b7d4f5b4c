"""What a MERL file holds, in a few numbers."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .binary import Dims, Measurement, read


@dataclass(frozen=True)
class FileReport:
    """Summary of one file: dims, fraction of valid bins, counts of bad numbers, outliers, largest values (1/sr)."""

    path: Path
    dims: Dims
    fraction_valid: float
    negative: int
    nan: int
    inf: int
    outliers: int
    largest: tuple[float, float, float]
    genuine: str | None


def summarise(measurement: Measurement) -> FileReport:
    """The summary of a file that was read."""
    largest = [float(np.nanmax(plane)) for plane in measurement.values]
    return FileReport(
        measurement.path, measurement.dims, float(measurement.valid.mean()), measurement.negative, measurement.nan,
        measurement.inf, measurement.outliers, (largest[0], largest[1], largest[2]), measurement.genuine,
    )  # fmt: skip


def inspect_file(path: str | os.PathLike[str], dims: Dims | None = None) -> FileReport:
    """Read and summarise; raises :class:`merlfit.merl_io.binary.MerlError` as :func:`read` does."""
    return summarise(read(path, dims=dims))
