"""Files that appear under their name only when they are whole and on disk."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

UNFINISHED = ".merlfit-"  # what names of files and folders begin with that are not whole


class WriteError(OSError):
    """A file that cannot be written; the message is one line that names it."""


def write_atomically(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    """Let ``write`` fill a file beside ``path`` and give it that name when it is whole.

    Raises:
        WriteError: it cannot be written; nothing is left behind, and an older file of that name stays as it was.
    """
    try:
        _write(path, write)
    except OSError as error:
        raise WriteError(f"{path}: cannot be written ({error.strerror or error})") from None


def write_bytes(path: Path, data: bytes) -> None:
    """Write what is there atomically.

    Raises:
        WriteError: as of `write_atomically`.
    """

    def write(file: IO[bytes]) -> None:
        file.write(data)

    write_atomically(path, write)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 atomically.

    Raises:
        WriteError: as of `write_atomically`.
    """
    write_bytes(path, text.encode())


def umask() -> int:
    """Permissions that new files and folders of this process do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _write(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=UNFINISHED)  # of any length, the name may be as long
    os.close(handle)
    try:
        with open(temporary, "wb") as file:  # by its name, which some libraries want
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
