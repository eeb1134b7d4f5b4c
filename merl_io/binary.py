"""MERL ``.binary`` files: three little-endian int32 dims, then three planes of float64, scaled per channel.

Matusik et al. 2003: dims (90, 90, 180) are theta_h (square-root scale), theta_d and phi_d, the last one fastest; planes
are red, green, blue; stored numbers times (1, 1.15, 1.66)/1500 are a BRDF in 1/sr. A negative number means no datum.
"""

import hashlib
import os
import stat
import struct
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import IO

import numpy as np

from .atomic import WriteError, write_atomically
from .bands import MERL, Bands

DIMS = (90, 90, 180)
CHANNELS = 3
SCALES = np.array([1.0 / 1500, 1.15 / 1500, 1.66 / 1500])
HEADER = struct.Struct("<3i")
COLOURS = ("red", "green", "blue")
PLANE_BYTES = int(np.prod(DIMS)) * 8
FILE_BYTES = HEADER.size + CHANNELS * PLANE_BYTES
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


class MerlError(ValueError):
    """A file that cannot be read or written as MERL; the message is one line that names the file and the mend."""


@dataclass(frozen=True)
class Measurement:
    """One measured material.

    Attributes:
        path: where it was read. values: BRDF (1/sr), shape (3, 90, 90, 180), NaN where there is no datum.
        valid: shape (90, 90, 180), False where any channel is negative, not finite or absurdly bright (`BRIGHTEST`).
        negative, nan, inf: how many stored numbers were so; the last with those that are absurdly bright.
        sha1: of the whole file. blob_sha1: the same as git names its blob, by which genuine files are known.
    """

    path: Path
    values: np.ndarray
    valid: np.ndarray
    negative: int
    nan: int
    inf: int
    sha1: str
    blob_sha1: str

    @property
    def name(self) -> str:
        """Name of the material: that of the file without ``.binary``."""
        return self.path.stem

    @property
    def bands(self) -> Bands:
        """Of the planes of ``values``."""
        return MERL

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


def read(path: str | os.PathLike[str], fitted_sha1: str | None = None) -> Measurement:
    """Read a MERL file; holds one float64 copy of its numbers.

    Args:
        fitted_sha1: of the file that was fitted, if it must be that one.

    Raises:
        MerlError: missing, a directory, no permission, truncated, too long, other dims, another format, no valid bin,
            not the one that was fitted.
    """
    path = Path(path)
    try:
        info = path.stat()
        if not stat.S_ISREG(info.st_mode):
            kind = "a directory; name the .binary files in it" if path.is_dir() else "not a regular file"
            raise MerlError(f"{path}: is {kind}")
        with open(path, "rb") as file:
            return _read(path, file, info.st_size, fitted_sha1)
    except FileNotFoundError:
        raise MerlError(f"{path}: no such file") from None
    except PermissionError:
        raise MerlError(f"{path}: no permission to read it; check its mode and owner") from None
    except OSError as error:
        raise MerlError(f"{path}: cannot be read ({error.strerror or error})") from None
    except MerlError:
        raise
    except ValueError:  # a NUL in it
        raise MerlError(f"{str(path)!r}: is not the name of a file") from None


def _read(path: Path, file: IO[bytes], size: int, fitted_sha1: str | None) -> Measurement:
    """Plane by plane, never mapped into memory: a file that another program cuts short is an error, not a crash."""
    head = file.read(HEADER.size)
    _check_header(path, head, size)
    sha1, blob = hashlib.sha1(head), hashlib.sha1(b"blob %d\0" % FILE_BYTES + head)
    values, bad = np.empty((CHANNELS, *DIMS)), np.zeros((CHANNELS, *DIMS), bool)
    counts = np.zeros(3, int)
    for plane, scale in enumerate(SCALES):
        raw = file.read(PLANE_BYTES)
        if len(raw) < PLANE_BYTES:
            raise MerlError(f"{path}: became shorter while it was read; copy it again, or wait until it is written")
        sha1.update(raw)
        blob.update(raw)
        numbers = np.frombuffer(raw, "<f8").reshape(DIMS)
        with np.errstate(invalid="ignore"):  # signalling NaNs, which are counted as any others
            kinds = numbers < 0, np.isnan(numbers), numbers * scale >= BRIGHTEST
            np.multiply(numbers, scale, out=values[plane])
        counts += [kind.sum() for kind in kinds]
        np.logical_or.reduce(kinds, out=bad[plane])
    if fitted_sha1 not in (None, sha1.hexdigest()):
        raise MerlError(f"{path}: is not the file that was fitted (other SHA-1)")
    invalid = np.logical_or.reduce(bad, axis=0)
    if invalid.all():
        share = ", ".join(f"{c} {b.mean():.0%}" for c, b in zip(COLOURS, bad, strict=True))
        raise MerlError(
            f"{path}: holds no valid bin, so that nothing can be fitted: in every bin a channel is negative, not "
            f"finite or above {BRIGHTEST:g}/sr ({share} of the bins)"
        )
    values[:, invalid] = np.nan
    negative, nan, inf = counts.tolist()
    return Measurement(path, values, ~invalid, negative, nan, inf, sha1.hexdigest(), blob.hexdigest())


def _check_header(path: Path, head: bytes, size: int) -> None:
    """Refuse a header or a length that is not MERL's."""
    for magic, what in MAGIC.items():
        if head.startswith(magic):
            raise MerlError(f"{path}: is {what}, not a MERL .binary file")
    if len(head) < HEADER.size:
        raise MerlError(f"{path}: truncated: {size} of {FILE_BYTES} bytes; download or copy it again")
    dims = HEADER.unpack(head)
    if dims != DIMS:
        if struct.unpack(">3i", head) == DIMS:
            raise MerlError(f"{path}: is big-endian; MERL files are little-endian, convert it first")
        if any(not 0 < n < 100_000 for n in dims):
            raise MerlError(f"{path}: not a MERL .binary file: its first 12 bytes are not three dimensions")
        found, expected = ("x".join(map(str, d)) for d in (dims, DIMS))
        raise MerlError(f"{path}: its dimensions are {found}, those of MERL {expected}")
    if size < FILE_BYTES:
        raise MerlError(f"{path}: truncated: {size} of {FILE_BYTES} bytes; download or copy it again")
    if size > FILE_BYTES:
        raise MerlError(f"{path}: too long: {size} bytes where MERL has {FILE_BYTES}; it was altered or joined")


def write(path: str | os.PathLike[str], values: np.ndarray, valid: np.ndarray | None = None) -> None:
    """Write a BRDF as a MERL file, atomically: a reader sees the old file or the whole new one.

    Args:
        values: BRDF (1/sr), shape (3, 90, 90, 180). valid: shape (90, 90, 180); bins outside it, and bins in which any
            channel is negative or not finite, are stored as -1, MERL's mark for no datum.

    A value comes back from :func:`read` to within one unit in the last place, because of the scale factors.

    Raises:
        MerlError: wrong shape, or the file cannot be written.
    """
    path = Path(path)
    if values.shape != (CHANNELS, *DIMS):
        raise MerlError(f"{path}: a MERL file holds values of shape {(CHANNELS, *DIMS)}, not {values.shape}")
    kept = np.isfinite(values).all(0) & (np.nan_to_num(values, nan=-1.0) >= 0).all(0)
    if valid is not None:
        kept &= valid

    def fill(file: IO[bytes]) -> None:
        file.write(HEADER.pack(*DIMS))
        for plane, scale in zip(values, SCALES, strict=True):
            file.write(np.where(kept, plane / scale, NO_DATUM).astype("<f8").tobytes())

    try:
        write_atomically(path, fill)
    except WriteError as error:
        raise MerlError(str(error)) from None
