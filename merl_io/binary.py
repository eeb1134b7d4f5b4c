"""MERL ``.binary`` files: three little-endian int32 dims, then three planes of float64, scaled per channel.

Matusik et al. 2003: dims (90, 90, 180) are theta_h (square-root scale), theta_d and phi_d, the last one fastest; planes
are red, green, blue; stored numbers times (1, 1.15, 1.66)/1500 are a BRDF in 1/sr. A negative number means no datum.
Files with other numbers of bins are read where that is asked for; their axes are divided as MERL's are.
"""

import hashlib
import os
import re
import struct
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import IO, Literal

import numpy as np

from .atomic import WriteError, write_atomically
from .bands import MERL, Bands, ColourSpace, filled
from .source import MerlError, opened, same_as_fitted

Dims = tuple[int, int, int]
DIMS: Dims = (90, 90, 180)
FEWEST, MOST = 6, 1000  # bins of an axis
CHANNELS = 3
SCALES = np.array([1.0 / 1500, 1.15 / 1500, 1.66 / 1500])
HEADER = struct.Struct("<3i")
COLOURS = ("red", "green", "blue")
NO_DATUM = -1.0
BRIGHTEST = 1e15  # 1/sr: beyond any mirror in a 1 degree bin by 11 orders; such a number is no measurement
OUTLIER = 1e4  # times the median over phi_d at the same theta_h and theta_d: masking and 1/cos alone vary along it
MAGIC = {
    b"\x89PNG": "a PNG picture",
    b"v/1\x01": "an OpenEXR picture",
    b"\x89HDF": "an HDF5 file",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "gzip data",
    b"\x93NUMP": "a NumPy array",
    b"BZh": "bzip2 data",
    b"\xff\xd8\xff": "a JPEG picture",
    b"%PDF": "a PDF",
}


def dims_of(text: str) -> Dims:
    """Numbers of bins of theta_h, theta_d and phi_d, as in "45x45x90".

    Raises:
        ValueError: it is no such thing.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})x(\d{1,5})", text)
    h, d, p = (int(x) for x in match.groups()) if match else (0, 0, 0)
    if not all(FEWEST <= n <= MOST for n in (h, d, p)) or p % 2:
        raise ValueError(
            f"dims {text!r} should be three numbers of bins like 45x45x90, of theta_h, theta_d and phi_d, each "
            f"{FEWEST} to {MOST}, the last one even"
        )
    return h, d, p


def dims_text(dims: Dims) -> str:
    """As they are written."""
    return "x".join(map(str, dims))


def plane_bytes(dims: Dims) -> int:
    """Length of one channel in a file."""
    return int(np.prod(dims)) * 8


def file_bytes(dims: Dims) -> int:
    """Length of a file."""
    return HEADER.size + CHANNELS * plane_bytes(dims)


@dataclass(frozen=True)
class Measurement:
    """One measured material.

    Attributes:
        path: where it was read.
        values: BRDF (1/sr), shape (3, 90, 90, 180), or of other dims (3, H, D, P), NaN where there is no datum.
        valid: shape (H, D, P), False where any channel is negative, not finite or absurdly bright (`BRIGHTEST`).
        negative: how many stored numbers are negative.
        nan: how many are no numbers.
        inf: how many are infinite or absurdly bright.
        sha1: of the whole file.
        blob_sha1: the same as git names its blob, by which genuine files are known.
        bands: of the planes of ``values``: fewer than three where others are zero everywhere. notes: on those.
        format, colour_space, left_out, quantity, fraction_uncertain: as of `scattered.ScatteredMeasurement`.
    """

    path: Path
    values: np.ndarray
    valid: np.ndarray
    negative: int
    nan: int
    inf: int
    sha1: str
    blob_sha1: str
    bands: Bands = MERL
    notes: tuple[str, ...] = ()
    format: Literal["MERL"] = "MERL"
    colour_space: ColourSpace = "linear RGB of MERL, as stored"
    left_out: int = 0
    quantity: Literal["brdf"] = "brdf"
    fraction_uncertain: None = None

    @property
    def name(self) -> str:
        """Name of the material: that of the file without ``.binary``."""
        return self.path.stem

    @property
    def dims(self) -> Dims:
        """Numbers of bins."""
        h, d, p = self.valid.shape
        return h, d, p

    @cached_property
    def outliers(self) -> int:
        """Valid bins that are brighter than `OUTLIER` times both the median of their row of phi_d and that of all."""
        brightest = self.values.max(0)
        bright = brightest > OUTLIER * np.median(brightest[self.valid])
        some = bright.any(-1)  # few rows, of most files none
        beside = np.nanmedian(brightest[some], -1, keepdims=True)
        return int(np.sum(bright[some] & (brightest[some] > OUTLIER * beside)))

    @cached_property
    def genuine(self) -> str | None:
        """Name of the MERL material whose published file this is, bit by bit; None for any other file."""
        return genuine_names().get(self.blob_sha1)


def genuine_names() -> dict[str, str]:
    """Material name by git blob SHA-1 for the 100 files of the MERL database."""
    text = (resources.files(__name__.rpartition(".")[0]) / "data" / "merl_git_blob_sha1.txt").read_text()
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return {row[0]: Path(row[-1]).stem for row in rows}


def read(path: str | os.PathLike[str], fitted_sha1: str | None = None, dims: Dims | None = None) -> Measurement:
    """Read a MERL file; holds one float64 copy of its numbers.

    Args:
        fitted_sha1: of the file that was fitted, if it must be that one.
        dims: other numbers of bins than MERL's, which the file may have, too; as :func:`dims_of` has them.

    Raises:
        MerlError: such dims are not read, or the file is missing, a directory, no permission, truncated, too long, of
            other dims, of another format, without a valid bin, not the one that was fitted.
    """
    path = Path(path)
    if dims is not None and not _usable(dims):
        raise MerlError(f"{path}: dims {dims_text(dims)} are not read: {FEWEST} to {MOST} bins an axis, phi_d even")
    with opened(path) as (file, size):
        return _read(path, file, size, fitted_sha1, (DIMS, dims or DIMS))


def _read(path: Path, file: IO[bytes], size: int, fitted_sha1: str | None, allowed: tuple[Dims, ...]) -> Measurement:
    """Plane by plane, never mapped into memory: a file that another program cuts short is an error, not a crash."""
    head = file.read(HEADER.size)
    dims = _dims_in(path, head, size, allowed)
    sha1, blob = hashlib.sha1(head), hashlib.sha1(b"blob %d\0" % file_bytes(dims) + head)
    values, bad = np.empty((CHANNELS, *dims)), np.zeros((CHANNELS, *dims), bool)
    counts = np.zeros(3, int)
    for plane, scale in enumerate(SCALES):
        raw = file.read(plane_bytes(dims))
        if len(raw) < plane_bytes(dims):
            raise MerlError(f"{path}: became shorter while it was read; copy it again, or wait until it is written")
        sha1.update(raw)
        blob.update(raw)
        numbers = np.frombuffer(raw, "<f8").reshape(dims)
        with np.errstate(invalid="ignore"):  # signalling NaNs, which are counted as any others
            kinds = numbers < 0, np.isnan(numbers), numbers * scale >= BRIGHTEST
            np.multiply(numbers, scale, out=values[plane])
        counts += [kind.sum() for kind in kinds]
        np.logical_or.reduce(kinds, out=bad[plane])
    same_as_fitted(path, sha1.hexdigest(), fitted_sha1)
    invalid = np.logical_or.reduce(bad, axis=0)
    if invalid.all():
        share = ", ".join(f"{c} {b.mean():.0%}" for c, b in zip(COLOURS, bad, strict=True))
        raise MerlError(
            f"{path}: holds no valid bin, so that nothing can be fitted: in every bin a channel is negative, not "
            f"finite or above {BRIGHTEST:g}/sr ({share} of the bins)"
        )
    values[:, invalid] = np.nan
    negative, nan, inf = counts.tolist()
    kept, bands, notes = filled(values, MERL)
    planes = values[kept] if notes else values
    digests = sha1.hexdigest(), blob.hexdigest()
    return Measurement(path, planes, ~invalid, negative, nan, inf, *digests, bands, tuple(notes))


def _dims_in(path: Path, head: bytes, size: int, allowed: tuple[Dims, ...]) -> Dims:
    """Refuse a header or a length that is not MERL's, or of one of the dims that are allowed."""
    for magic, what in MAGIC.items():
        if head.startswith(magic):
            raise MerlError(f"{path}: is {what}, not a MERL .binary file")
    if 0 < size < HEADER.size:
        raise MerlError(f"{path}: not a MERL .binary file: it has {size} bytes, of which the header alone takes 12")
    if len(head) < HEADER.size:
        raise MerlError(f"{path}: truncated: {size} of {file_bytes(DIMS)} bytes; download or copy it again")
    dims = HEADER.unpack(head)
    if dims not in allowed:
        if struct.unpack(">3i", head) in allowed:
            raise MerlError(f"{path}: is big-endian; MERL files are little-endian, convert it first")
        if any(not 0 < n < 100_000 for n in dims):
            raise MerlError(
                f"{path}: not a MERL .binary file: its first 12 bytes are not three dimensions (other formats go by "
                "their ending: docs/formats.md)"
            )
        mend = f"; --dims {dims_text(dims)} allows them" if size == file_bytes(dims) and _usable(dims) else ""
        raise MerlError(f"{path}: its dimensions are {dims_text(dims)}, those of MERL {dims_text(DIMS)}{mend}")
    expected = file_bytes(dims)
    if size < expected:
        raise MerlError(f"{path}: truncated: {size} of {expected} bytes; download or copy it again")
    if size > expected:
        whose = "MERL has" if dims == DIMS else f"{dims_text(dims)} bins are"
        raise MerlError(f"{path}: too long: {size} bytes where {whose} {expected}; it was altered or joined")
    return dims


def _usable(dims: Dims) -> bool:
    try:
        return dims_of(dims_text(dims)) == dims
    except ValueError:
        return False


def write(path: str | os.PathLike[str], values: np.ndarray, valid: np.ndarray | None = None, dims: Dims = DIMS) -> None:
    """Write a BRDF as a MERL file, atomically: a reader sees the old file or the whole new one.

    Args:
        values: BRDF (1/sr), shape (3, 90, 90, 180). valid: shape (90, 90, 180); bins outside it, and bins in which any
            channel is negative or not finite, are stored as -1, MERL's mark for no datum.
        dims: numbers of bins, if they are not MERL's.

    A value comes back from :func:`read` to within one unit in the last place, because of the scale factors.

    Raises:
        MerlError: wrong shape, or the file cannot be written.
    """
    path = Path(path)
    if values.shape != (CHANNELS, *dims):
        raise MerlError(f"{path}: a MERL file holds values of shape {(CHANNELS, *dims)}, not {values.shape}")
    if valid is not None and valid.shape != dims:
        raise MerlError(f"{path}: which bins are valid has the shape {dims}, not {valid.shape}")
    kept = np.isfinite(values).all(0) & (np.nan_to_num(values, nan=-1.0) >= 0).all(0)
    if valid is not None:
        kept &= valid

    def fill(file: IO[bytes]) -> None:
        file.write(HEADER.pack(*dims))
        for plane, scale in zip(values, SCALES, strict=True):
            file.write(np.where(kept, plane / scale, NO_DATUM).astype("<f8").tobytes())

    try:
        write_atomically(path, fill)
    except WriteError as error:
        raise MerlError(str(error)) from None
