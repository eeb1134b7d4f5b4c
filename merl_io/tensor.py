"""Tensor files, Mitsuba's format for named arrays: RGL's ``.bsdf`` files are such.

``tensor_file`` and a zero byte, the version 1.0 in two bytes, the number of fields (uint32); of every field the length
of its name (uint16), its name, the number of its dimensions (uint16), its type (uint8), where its numbers begin in the
file (uint64), and its sizes (uint64 each). All is little-endian.
"""

import math
import struct
from dataclasses import dataclass
from pathlib import Path

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
class Field:
    """Where an array is in the file: its type by number, its first byte, its sizes."""

    type: int
    offset: int
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Tensors:
    """The arrays of a file, which are read where they lie."""

    path: Path
    data: bytes
    fields: dict[str, Field]

    def array(self, name: str, type_: str, dimensions: int) -> np.ndarray:
        """One of them, without a copy.

        Raises:
            MerlError: there is none of this name, type and number of dimensions, or it is empty, or cut off.
        """
        if name not in self.fields:
            raise MerlError(f"{self.path}: has no field {name}")
        field = self.fields[name]
        found = TYPES[field.type] if field.type < len(TYPES) else f"of unknown type {field.type}"
        if found != type_:
            raise MerlError(f"{self.path}: field {name} is {found}, not {type_}")
        if len(field.shape) != dimensions or 0 in field.shape:
            raise MerlError(f"{self.path}: field {name} has shape {field.shape}, not {dimensions} sizes above 0")
        kind = np.dtype(type_).newbyteorder("<")
        count = math.prod(field.shape)
        end = field.offset + count * kind.itemsize
        if end > len(self.data):
            raise MerlError(
                f"{self.path}: truncated: field {name} ends at byte {end}, the file at {len(self.data)}; "
                "download or copy it again"
            )
        return np.frombuffer(self.data, kind, count, field.offset).reshape(field.shape)


class _Cursor:
    """What is read of the header, one thing after the other."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.at = path, data, 0

    def bytes(self, count: int) -> bytes:
        found = self.data[self.at : self.at + count]
        self.at += count
        if len(found) < count:
            raise MerlError(
                f"{self.path}: truncated in its header, at byte {len(self.data)}; download or copy it again"
            )
        return found

    def numbers(self, kinds: str) -> tuple[int, ...]:
        return struct.unpack(f"<{kinds}", self.bytes(struct.calcsize(f"<{kinds}")))


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
    cursor = _Cursor(path, data)
    cursor.bytes(len(MAGIC))
    version = cursor.numbers("BB")
    if version != VERSION:
        raise MerlError(f"{path}: is a tensor file of version {version[0]}.{version[1]}; 1.0 is read")
    (count,) = cursor.numbers("I")
    if count > MOST_FIELDS:
        raise MerlError(f"{path}: is damaged: its header tells of {count} fields")
    found = {}
    for _ in range(count):
        name, field = _field(cursor)
        if name in found:
            raise MerlError(f"{path}: field {name} is there twice")
        found[name] = field
    return Tensors(path, data, found)


def _field(cursor: _Cursor) -> tuple[str, Field]:
    (length,) = cursor.numbers("H")
    name = ascii(cursor.bytes(length).decode("utf-8", "replace"))[1:-1]
    dimensions, kind, offset = cursor.numbers("HBQ")
    if dimensions > MOST_DIMENSIONS:
        raise MerlError(f"{cursor.path}: is damaged: field {name[:40]} has {dimensions} dimensions")
    return name, Field(kind, offset, cursor.numbers(f"{dimensions}Q"))
