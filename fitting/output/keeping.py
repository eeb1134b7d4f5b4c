"""Results that are there already: a fit takes the place of one only if it is at least as complete."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from itertools import count
from pathlib import Path

from ...merl_io.atomic import UNFINISHED, WriteError, umask
from ..pipeline.run import chain_of


class Complete(IntEnum):
    """How much a result holds, least first."""

    NOTHING = 0
    FIT = 1
    CHAIN = 2  # whose sampling was interrupted
    POSTERIOR = 3
    INTERVALS = 4

    @property
    def words(self) -> str:
        """For a message."""
        return {
            Complete.NOTHING: "no fit that succeeded",
            Complete.FIT: "a fit without a posterior",
            Complete.CHAIN: "a fit and an unfinished chain",
            Complete.POSTERIOR: "a fit and a posterior too short for intervals",
            Complete.INTERVALS: "a fit and a posterior with intervals",
        }[self]


def completeness(path: Path) -> Complete:
    """How much is in the result of this name, whatever version wrote it."""
    try:
        found = json.loads(path.read_bytes())
        posterior, succeeded = found["posterior"], found["fit"]["succeeded"]
        if posterior:
            return Complete.INTERVALS if posterior["sufficient"] else Complete.POSTERIOR
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return Complete.NOTHING
    if not succeeded:
        return Complete.NOTHING
    return Complete.CHAIN if chain_of(path).is_file() else Complete.FIT


class Taken(WriteError):
    """A folder that another run writes to."""


@contextmanager
def claimed(out: Path, alone: bool = True) -> Iterator[None]:
    """Claim a folder for as long as this lasts, and clear away what a run that was killed left unfinished in it.

    Args:
        alone: if not, others that are content with that may write there, too; then nothing is cleared away.

    Raises:
        Taken: another run has it.
    """
    try:
        import fcntl  # not on Windows

        folder = os.open(out, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        free = alone
        try:
            fcntl.flock(folder, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Taken(f"{out}: another merlfit is writing there; wait for it, or name another folder") from None
        except OSError:  # a file system without locks
            free = False
        if free:
            _clear(out)
        yield
    finally:
        os.close(folder)


def _clear(out: Path) -> None:
    """Files and folders that were not whole when the process that wrote them was killed."""
    for left in out.glob(f"{UNFINISHED}*"):
        with suppress(OSError):
            shutil.rmtree(left) if left.is_dir() else left.unlink()


class Place:
    """Where a result is written: ``folder`` and, in it, ``path``; ``said`` at the end, if there is something to say."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.path, self.said = folder, folder / f"{name}.json", ""
        self._before = _which(self.path)

    @property
    def written(self) -> bool:
        """Whether a result was written here since; one that stood here before is none."""
        return _which(self.path) not in (None, self._before)


def _which(path: Path) -> tuple[int, int] | None:
    """Tells one file of a name from the next; None where there is none."""
    with suppress(OSError):
        found = path.stat()
        return found.st_ino, found.st_mtime_ns
    return None


@contextmanager
def place_of(out: Path, name: str) -> Iterator[Place]:
    """Where to write the result ``name`` of ``out``.

    Where one stands already, the new one is written into a folder beside it, and moved to its place in the end, however
    that comes, if it is of the same model and at least as complete. Otherwise both stay where they are.
    """
    target = Place(out, name)
    if completeness(target.path) == Complete.NOTHING:
        yield target
        return
    beside = Path(tempfile.mkdtemp(dir=out, prefix=UNFINISHED))
    new = Place(beside, name)
    try:
        yield new
    finally:
        before, after = completeness(target.path), completeness(new.path)
        models = [_model(place.path) for place in (target, new)]
        other = after > Complete.NOTHING and models[0] != models[1]  # a fit of another model says other things
        if not other and after >= before and not after == before == Complete.CHAIN:  # whose chain is the longer?
            _move(new.path, target.path)
            new.path = target.path
        elif new.path.exists():
            named = next(folder for k in count(2) if not (folder := out / f"{name}.{k}").exists())
            beside.chmod(0o777 & ~umask())
            new.path = beside.rename(named) / new.path.name
            of_model, of_new = (f" of the {model} model" if other else "" for model in models)
            new.said = f"{target.path} stays as it was, with {before.words}{of_model}; "
            new.said += f"{new.path} is the new one, {after.words}{of_new}"
        with suppress(OSError):  # not empty
            beside.rmdir()


def _model(path: Path) -> str | None:
    """Name of the model of a result; None if there is none."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        return str(json.loads(path.read_bytes())["model"]["name"])
    return None


def _move(new: Path, target: Path) -> None:
    """A result and its chain to the place of another; the chain of that goes even if there is no new one."""
    if chain_of(new).exists():
        os.replace(chain_of(new), chain_of(target))
    else:
        chain_of(target).unlink(missing_ok=True)
    os.replace(new, target)
