"""Arrays in NPZ archives, looked at before memory is taken for them."""

import io
import math
import zipfile
from collections.abc import Callable
from typing import IO

import numpy as np

RATIO, FREE = 20, 2**26  # of an archive's length, and bytes beside: what is measured or sampled packs no better


def arrays(
    file: IO[bytes] | io.BytesIO, wanted: Callable[[str], bool], texts: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Those arrays of an archive whose names are wanted: real numbers, and text where the name is one of ``texts``.

    Raises:
        ValueError: it is no such archive, is damaged, or its arrays would take more memory than its length allows; the
            message is a line.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            names = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            members = {name: info for name, info in names.items() if wanted(name)}
            need = sum(_bytes(archive, info, name in texts) for name, info in members.items())
            if need > RATIO * file.seek(0, 2) + FREE:
                raise ValueError(f"its arrays would take {need / 2**20:.0f} MiB, which no measurement packs so small")
            return {name: _array(archive, info) for name, info in members.items()}
    except Exception as error:  # of any kind: zipfile, zlib and NumPy raise many
        raise ValueError((str(error).splitlines() or [type(error).__name__])[0][:200]) from None


def _bytes(archive: zipfile.ZipFile, member: zipfile.ZipInfo, text: bool) -> int:
    """Memory that an array says to need, numbers as float64."""
    name = member.filename.removesuffix(".npy")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others may take any memory to unpack
        raise ValueError(f"array {name} is packed as NumPy packs none")
    with archive.open(member) as opened:
        if np.lib.format.read_magic(opened) != (1, 0):
            raise ValueError(f"array {name} is of another version of NumPy's format than 1.0")
        shape, _, kind = np.lib.format.read_array_header_1_0(opened)
    if min(shape, default=0) < 0:
        raise ValueError(f"array {name} says to have less than nothing in it")
    if kind.kind not in ("U" if text else "fiu"):
        raise ValueError(f"array {name} holds no {'text' if text else 'real numbers'}")
    if math.prod(shape) * kind.itemsize > member.file_size:
        raise ValueError(f"array {name} says to be larger than it is")
    return math.prod(shape) * max(kind.itemsize, 8)


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as opened:
        return np.lib.format.read_array(opened, allow_pickle=False)
