"""Arrays in NPZ archives, looked at before memory is taken for them."""

import math
import zipfile

import numpy as np


def shape_of(archive: zipfile.ZipFile, name: str) -> tuple[int, ...]:
    """Shape that an array of numbers says to have.

    Raises:
        KeyError: there is none of this name. ValueError: it holds anything but real numbers, or says to be larger than
            it is.
    """
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as opened:
        if np.lib.format.read_magic(opened) != (1, 0):
            raise ValueError(f"array {name} is of another version of NumPy's format than 1.0")
        shape, _, kind = np.lib.format.read_array_header_1_0(opened)
    if kind.kind not in "fiu":
        raise ValueError(f"array {name} holds no real numbers")
    if math.prod(shape) * kind.itemsize > member.file_size:
        raise ValueError(f"array {name} says to be larger than it is")
    return shape
