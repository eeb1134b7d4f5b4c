"""The file of a measurement, opened: what the system says against it is one line that names it."""

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

LONGEST = 1000  # characters of a message, whatever a file puts into it


def shortened(message: str) -> str:
    """Of a message that is too long its beginning, which names the file, and its end."""
    half = LONGEST // 2 - 3
    return message if len(message) <= LONGEST else f"{message[:half]} ... {message[-half:]}"


class MerlError(ValueError):
    """A file that cannot be read or written as a measurement; the message is one line that names it and the mend."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


def is_regular(path: Path) -> bool:
    """Whether there is a regular file of this name, and it can be seen; no name is an error."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a folder that is closed, a name too long, a NUL in it
        return False


@contextmanager
def opened(path: Path) -> Iterator[tuple[IO[bytes], int]]:
    """A file to read and its length (bytes).

    Raises:
        MerlError: there is none of this name, it is no regular file, or it cannot be opened or read.
    """
    try:
        info = _status(path)
        if not stat.S_ISREG(info.st_mode):
            kind = "a directory; name the files in it" if path.is_dir() else "not a regular file"
            raise MerlError(f"{path}: is {kind}")
        with open(path, "rb") as file:
            yield file, info.st_size
    except FileNotFoundError:
        raise MerlError(f"{path}: no such file") from None
    except PermissionError:
        raise MerlError(f"{path}: no permission to read it; check its mode and owner") from None
    except OSError as error:
        raise MerlError(f"{path}: cannot be read ({error.strerror or error})") from None


def _status(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except ValueError:  # a NUL in it
        raise MerlError(f"{str(path)!r}: is not the name of a file") from None


def contents(path: Path, fitted_sha1: str | None = None) -> tuple[bytes, str, str]:
    """Bytes of a file, their SHA-1 and that of git's blob.

    Raises:
        MerlError: it cannot be read, or is not the one that was fitted.
    """
    with opened(path) as (file, _):
        data = file.read()
    sha1, blob = hashlib.sha1(data), hashlib.sha1(b"blob %d\0" % len(data))
    blob.update(data)
    same_as_fitted(path, sha1.hexdigest(), fitted_sha1)
    return data, sha1.hexdigest(), blob.hexdigest()


def same_as_fitted(path: Path, sha1: str, fitted_sha1: str | None) -> None:
    """Refuse another file than that one, if it has to be one.

    Raises:
        MerlError: it is another.
    """
    if fitted_sha1 not in (None, sha1):
        raise MerlError(f"{path}: is not the file that was fitted (other SHA-1)")
