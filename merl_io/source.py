"""Files, opened to be read: what the system says against one is one line that names it."""

import hashlib
import os
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

LARGEST, LARGEST_TOML = 2**31, 2**20  # bytes: of tables and RGL's files, whose own have 30 MiB; of settings and scenes

LONGEST = 1000  # characters of a message, whatever a file puts into it
BIDI = (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))  # and separators of lines
PLAIN = {
    **{code: 0x2400 + code for code in range(0x20) if chr(code) not in "\t\n"}, 0x7F: 0x2421,  # their own pictures
    **dict.fromkeys((*range(0x80, 0xA0), *BIDI), 0xFFFD),
}  # fmt: skip
"""For ``str.translate``: what would steer a terminal or turn a line around (C0, C1, bidi), as one visible letter."""


def shortened(message: str) -> str:
    """A message; of one that is too long its beginning, which names the file, and its end."""
    half = LONGEST // 2 - 3
    return message if len(message) <= LONGEST else f"{message[:half]} ... {message[-half:]}"


class MerlError(ValueError):
    """What is asked for cannot be done: the message is one line that names the file or the setting, and the mend."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


def is_regular(path: Path) -> bool:
    """Whether there is a regular file of this name, and it can be seen; no name is an error."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a folder that is closed, a name too long, a NUL in it
        return False


@contextmanager
def opened(path: Path, refusal: type[ValueError] = MerlError, most: int = LARGEST) -> Iterator[tuple[IO[bytes], int]]:
    """A file to read and its length (bytes).

    Args:
        refusal: what is raised. most: bytes that such a file may have.

    Raises:
        refusal: there is none of this name, it is no regular file or too large, it cannot be opened or read, or what
            is done with it takes more memory than there is.
    """
    try:
        _check(path, _status(path, refusal), refusal, most)  # some devices begin to work when they are opened
        with open(path, "rb", opener=_at_once) as file:
            info = os.fstat(file.fileno())
            _check(path, info, refusal, most)  # another may have its name by now
            yield file, info.st_size
    except FileNotFoundError:
        raise refusal(f"{path}: no such file") from None
    except PermissionError:
        raise refusal(f"{path}: no permission to read it; check its mode and owner") from None
    except OSError as error:
        raise refusal(f"{path}: cannot be read ({error.strerror or error})") from None
    except MemoryError:
        raise refusal(f"{path}: takes more memory than there is") from None


def _check(path: Path, info: os.stat_result, refusal: type[ValueError], most: int) -> None:
    """Refuse what is no regular file, or too large."""
    if not stat.S_ISREG(info.st_mode):
        kind = "a directory; name the files in it" if stat.S_ISDIR(info.st_mode) else "not a regular file"
        raise refusal(f"{path}: is {kind}")
    if info.st_size > most:
        raise refusal(f"{path}: has {info.st_size / 2**20:.0f} MiB; such a file has {most / 2**20:.0f} at the most")


def _at_once(path: str, flags: int) -> int:
    """Open without waiting for whoever would write to it, if it is a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _status(path: Path, refusal: type[ValueError]) -> os.stat_result:
    try:
        return path.stat()
    except ValueError:  # a NUL in it
        raise refusal(f"{str(path)!r}: is not the name of a file") from None


def whole(path: Path, refusal: type[ValueError] = MerlError, most: int = LARGEST) -> bytes:
    """All bytes of a file; raises as :func:`opened` does."""
    with opened(path, refusal, most) as (file, size):
        return file.read(size)


def sha1_of(path: Path) -> str:
    """SHA-1 of a file in hexadecimal digits; raises as :func:`opened` does."""
    with opened(path) as (file, _):
        return hashlib.file_digest(file, "sha1").hexdigest()  # pyright: ignore[reportArgumentType] - it is a file


def toml(path: Path, what: str, refusal: type[ValueError]) -> dict[str, Any]:
    """What a file of TOML says.

    Args:
        what: it should hold, for a message. refusal: what is raised.

    Raises:
        refusal: it cannot be read, or is no TOML.
    """
    try:
        return tomllib.loads(whole(path, refusal, LARGEST_TOML).decode("utf-8-sig"))  # some editors put a mark first
    except refusal:
        raise
    except RecursionError:
        raise refusal(f"{path}: its lists or tables lie in each other too deeply for {what}") from None
    except ValueError as error:  # no UTF-8, no TOML, a number or a date that Python has none of
        raise refusal(f"{path}: is not TOML: {error}") from None


def contents(path: Path, fitted_sha1: str | None = None) -> tuple[bytes, str, str]:
    """Bytes of a file, their SHA-1 and that of git's blob.

    Raises:
        MerlError: it cannot be read, or is not the one that was fitted.
    """
    data = whole(path)
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
