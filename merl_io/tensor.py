"""Tensor files, Mitsuba's format for named arrays: RGL's ``.bsdf`` files are such.

``tensor_file`` and a zero byte, the version 1.0 in two bytes, the number of fields (uint32); of every field the length
of its name (uint16), its name, the number of its dimensions (uint16), its type (uint8), where its numbers begin in the
file (uint64), and its sizes (uint64 each). All is little-endian.
"""

import io
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .binary import MAGIC as OTHERS
from .source import MerlError

MAGIC = b"tensor_file\0"
VERSION = 1, 0
TYPES = (
    "nothing", "uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64"
)  # fmt: skip
MOST_FIELDS, MOST_DIMENSIONS = 256, 16  # RGL's files have 10 of 5 at the most; more are made to fill the memory


@dataclass(frozen=True)
class Tensors:
    """The arrays of a file, which are read where they lie.

    Attributes:
        fields: by name: number of the type, first byte, sizes.
    """

    path: Path
    data: bytes
    fields: dict[str, tuple[int, int, tuple[int, ...]]]

    def array(self, name: str, type_: str, dimensions: int) -> np.ndarray:
        """One of them, without a copy.

        Raises:
            MerlError: there is none of this name, type and number of dimensions, or it is empty, or cut off.
        """
        if name not in self.fields:
            raise MerlError(f"{self.path}: has no field {name}")
        number, first, shape = self.fields[name]
        stored = TYPES[number] if number < len(TYPES) else f"of unknown type {number}"
        if stored != type_:
            raise MerlError(f"{self.path}: field {name} is {stored}, not {type_}")
        if len(shape) != dimensions or 0 in shape:
            raise MerlError(f"{self.path}: field {name} has shape {shape}, not {dimensions} sizes above 0")
        kind, count = np.dtype(type_).newbyteorder("<"), math.prod(shape)
        end = first + count * kind.itemsize
        if end > len(self.data):
            raise MerlError(
                f"{self.path}: truncated: field {name} ends at byte {end}, the file at {len(self.data)}; "
                "download or copy it again"
            )
        return np.frombuffer(self.data, kind, count, first).reshape(shape)


def tensors(path: Path, data: bytes) -> Tensors:
    """The header of a tensor file.

    Raises:
        MerlError: it is none, or of another version, or cut off.
    """
    for magic, what in OTHERS.items():
        if data.startswith(magic):
            raise MerlError(f"{path}: is {what}, not a tensor file")
    if not MAGIC.startswith(data[: len(MAGIC)]):
        raise MerlError(f"{path}: is not a tensor file: it does not begin with 'tensor_file'")
    header = io.BytesIO(data)
    header.seek(len(MAGIC))

    def numbers(kinds: str) -> tuple[Any, ...]:
        packed = header.read(struct.calcsize(f"<{kinds}"))
        if len(packed) < struct.calcsize(f"<{kinds}"):
            raise MerlError(f"{path}: truncated in its header, at byte {len(data)}; download or copy it again")
        return struct.unpack(f"<{kinds}", packed)

    if (version := numbers("BB")) != VERSION:
        raise MerlError(f"{path}: is a tensor file of version {version[0]}.{version[1]}; 1.0 is read")
    (count,) = numbers("I")
    if count > MOST_FIELDS:
        raise MerlError(f"{path}: is damaged: its header tells of {count} fields")
    fields = {}
    for _ in range(count):
        (length,) = numbers("H")
        name = ascii(numbers(f"{length}s")[0].decode("utf-8", "replace"))[1:-1]
        dimensions, kind, first = numbers("HBQ")
        if dimensions > MOST_DIMENSIONS:
            raise MerlError(f"{path}: is damaged: field {name[:40]} has {dimensions} dimensions")
        if name in fields:
            raise MerlError(f"{path}: field {name} is there twice")
        fields[name] = kind, first, numbers(f"{dimensions}Q")
    return Tensors(path, data, fields)


def packed(fields: Mapping[str, np.ndarray]) -> bytes:
    """A tensor file of arrays by name; each begins at a multiple of 8 bytes.

    Raises:
        ValueError: one is of a type that the format has not.
    """
    arrays = {name: np.ascontiguousarray(x) for name, x in fields.items()}
    labels = {name: name.encode() for name in arrays}
    end = len(MAGIC) + 6 + sum(2 + len(labels[name]) + 2 + 1 + 8 + 8 * x.ndim for name, x in arrays.items())
    head, body = [MAGIC + struct.pack("<BBI", *VERSION, len(arrays))], []
    for name, x in arrays.items():
        gap = -end % 8
        head.append(struct.pack("<H", len(labels[name])) + labels[name])
        head.append(struct.pack(f"<HBQ{x.ndim}Q", x.ndim, TYPES.index(x.dtype.name), end + gap, *x.shape))
        body.append(bytes(gap) + x.astype(x.dtype.newbyteorder("<"), copy=False).tobytes())
        end += len(body[-1])
    return b"".join(head + body)
