"""Files that appear under their name only when they are whole and on disk."""

import hashlib
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

UNFINISHED = ".merlfit-"  # what names of files and folders begin with that are not whole
DIGITS = 16  # of what is drawn for such a name, and of what follows from that


class WriteError(OSError):
    """A file that cannot be written; the message is one line that names it."""


@contextmanager
def refused(path: Path, done: str) -> Iterator[None]:
    """Say in one line what the system says against what is done with this path: it is made, or written.

    Raises:
        WriteError: instead of any other error of the system.
    """
    try:
        yield
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(f"{path}: cannot be {done} ({error.strerror or error})") from None


def write_atomically(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    """Let ``write`` fill a file beside ``path`` and give it that name when it is whole.

    Raises:
        WriteError: it cannot be written; nothing is left behind, and an older file of that name stays as it was.
    """
    with refused(path, "written"):
        _write(path, write)


def write_bytes(path: Path, data: bytes) -> None:
    """Write what is there atomically.

    Raises:
        WriteError: as of `write_atomically`.
    """

    def write(file: IO[bytes]) -> None:
        file.write(data)

    write_atomically(path, write)


def write_text(path: Path, text: str) -> Path:
    """Write UTF-8 atomically; what of a name is none is a question mark.

    Returns:
        the file.

    Raises:
        WriteError: as of `write_atomically`.
    """
    write_bytes(path, text.encode(errors="replace"))
    return path


def append(path: Path, data: bytes) -> None:
    """Add to the end of a regular file, which is made if needed, and wait until it is on disk.

    Raises:
        WriteError: it cannot be written, or the name is that of a link, which might lead to somebody's file.
    """
    try:
        _append(path, data)
    except OSError as error:
        why = "it is a symbolic link" if path.is_symlink() else error.strerror or error
        raise WriteError(f"{path}: cannot be written ({why})") from None


def appendable(path: Path) -> IO[bytes]:
    """A regular file, which is made if needed, open at its end.

    Raises:
        OSError: it cannot be opened, is a link or no regular file.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):  # as far as the system has them; a pipe is not waited for
        flags |= getattr(os, name, 0)
    file = open(os.open(path, flags, 0o666), "ab")  # noqa: SIM115 - whoever asked for it closes it
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError("it is no regular file")
    return file


def _append(path: Path, data: bytes) -> None:
    with appendable(path) as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def unfinished(folder: Path) -> Path:
    """A new name for what is not whole yet, which nobody else gives: one half of it follows from the other."""
    drawn = secrets.token_hex(DIGITS // 2)
    return folder / f"{UNFINISHED}{drawn}-{_follows(drawn)}"


def is_unfinished(path: Path) -> bool:
    """Whether this name was made by :func:`unfinished`: only then may a later run clear it away."""
    drawn, _, follows = path.stem.removeprefix(UNFINISHED).partition("-")
    return path.name.startswith(UNFINISHED) and follows == _follows(drawn)


def is_being_written(path: Path) -> bool:
    """Whether a process writes what has such a name; no, where that cannot be told."""
    if not path.is_file():
        return False
    with open(path, "rb") as file:
        return not _locked(file.fileno())


@contextmanager
def _held(number: int) -> Iterator[None]:
    """An open file that is seen to be written (`is_being_written`) for as long as this lasts, and closed then."""
    if not _locked(number) or os.name == "nt":  # where a file that is open cannot be renamed
        os.close(number)
        yield
        return
    try:
        yield
    finally:
        os.close(number)


def _locked(number: int) -> bool:
    """Lock an open file for this process; False where another has it."""
    try:
        import fcntl  # not on Windows

        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # a system, or a file system, without locks
        return True
    return True


def _follows(drawn: str) -> str:
    return hashlib.sha256(f"merlfit, not whole: {drawn}".encode()).hexdigest()[:DIGITS]


def _write(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    temporary = unfinished(path.parent)  # of any length, the name may be as long
    made = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # with what the system's umask leaves
    with _held(made):
        try:
            with open(temporary, "wb") as file:  # by its name, which some libraries want
                write(file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
