"""Measurements in files of any format that is read: by the ending of their names."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from . import alta, astm, binary, fred, mbsdf, rgl, table, zemax
from .binary import Dims, Measurement
from .hints import hints
from .scattered import Quantity, ScatteredMeasurement
from .source import MerlError, opened
from .tensor import MAGIC

Input = Measurement | ScatteredMeasurement
DECLARED = "table", "FRED"  # formats of whose values the user may say what they are
TEXT = {*b"\t\n\r", *range(32, 127)}  # bytes


def _bsdf(path: Path, fitted_sha1: str | None) -> ScatteredMeasurement:
    """RGL's tensors or Zemax' text, which share the ending; what is neither is refused as no tensor file."""
    with opened(path) as (file, _):
        head = file.read(64)
    text = set(head) <= TEXT and not MAGIC.startswith(head)  # the beginning of a tensor file may be all that is left
    return (zemax if text else rgl).read(path, fitted_sha1)


SCATTERED = {
    ".csv": table.read,
    ".npz": table.read,
    ".bsdf": _bsdf,
    ".txt": fred.read,
    ".dat": alta.read,
    ".alta": alta.read,
    ".mbsdf": mbsdf.read,
    ".astm": astm.read,
}


def is_scattered(path: str | os.PathLike[str]) -> bool:
    """Whether a file of this name holds scattered directions; every other one is read as MERL's."""
    return Path(path).suffix.lower() in SCATTERED


def read(
    path: str | os.PathLike[str] | Mapping[str, ArrayLike],
    fitted_sha1: str | None = None,
    dims: Dims | None = None,
    name: str = "table",
    quantity: Quantity = "brdf",
) -> Input:
    """Read a measurement.

    Args:
        path: of a file, or a table of scattered directions as arrays: ``theta_i_deg``, ``theta_o_deg``, ``phi_deg``
            (N,), ``wavelengths_um`` (C,), ``values`` (N, C), 1/sr, NaN where there is no datum, and perhaps ``weight``
            (N,) and ``uncertainty`` (N, C), with the meanings and units of docs/tables.md.
        fitted_sha1: of the file that was fitted, if it must be that one. dims: as of `binary.read`.
        name: of the material, of arrays; a file's is that of the file. quantity: what the values of a table are.

    Raises:
        merlfit.merl_io.binary.MerlError: it cannot be used; the message is one line.
    """
    if isinstance(path, Mapping):
        return _as_brdf(table.read_arrays(path, name), quantity)
    if is_scattered(path):
        try:
            return _as_brdf(SCATTERED[Path(path).suffix.lower()](Path(path), fitted_sha1), quantity)
        except MemoryError:
            raise MerlError(f"{path}: takes more memory than there is") from None
    return _as_brdf(binary.read(path, fitted_sha1, dims), quantity)


def _as_brdf(measured: Input, quantity: Quantity) -> Input:
    """The same with BRDFs for values that are declared to be something else.

    Raises:
        MerlError: the format says itself what its values are.
    """
    if quantity == "brdf":
        return measured
    if isinstance(measured, Measurement) or measured.format not in DECLARED:
        mend = " (#PARAM_OUT)" if measured.format == "ALTA" else ""
        raise MerlError(
            f"{measured.path}: {measured.format} files say themselves{mend} what their values are: leave out "
            f"--quantity {quantity}, which is for tables"
        )
    factor = np.cos(measured.theta_o) if quantity == "brdf_cos" else np.pi
    uncertainty = None if measured.uncertainty is None else measured.uncertainty / factor
    return replace(measured, values=measured.values / factor, uncertainty=uncertainty, quantity=quantity)


def remarks(measured: Input) -> list[str]:
    """What a user should know of a file whatever is made of it: what was left out, and what it looks like."""
    return [*measured.notes, *hints(measured)]
