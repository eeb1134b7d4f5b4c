"""Results that are there already: a fit takes the place of one only if it is at least as complete."""

import filecmp
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from enum import IntEnum
from itertools import count
from pathlib import Path

from ...merl_io.atomic import UNFINISHED, WriteError, is_being_written, is_unfinished, refused, unfinished
from ...merl_io.source import whole
from ..pipeline.draws import NoPicture, chain_file, chain_of
from ..results.storage import ResultError, read_result
from ..support.outputs import is_ours
from ..support.terminal import note

RESULT = ".json"  # as `is_ours` has it, whatever a result is named


class Completeness(IntEnum):
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
            Completeness.NOTHING: "no fit that succeeded",
            Completeness.FIT: "a fit without a posterior",
            Completeness.CHAIN: "a fit and an unfinished chain",
            Completeness.POSTERIOR: "a fit and a posterior too short for intervals",
            Completeness.INTERVALS: "a fit and a posterior with intervals",
        }[self]


def completeness(path: Path) -> Completeness:
    """How much is in the result of this name, whatever version wrote it."""
    try:
        found = json.loads(whole(path))
        posterior, succeeded = found["posterior"], found["fit"]["succeeded"]
        if posterior:
            return Completeness.INTERVALS if posterior["sufficient"] else Completeness.POSTERIOR
    except (ValueError, KeyError, TypeError, RecursionError):
        return Completeness.NOTHING
    if not succeeded:
        return Completeness.NOTHING
    return Completeness.CHAIN if chain_of(path).is_file() else Completeness.FIT


@contextmanager
def claimed(out: Path, alone: bool = True) -> Iterator[None]:
    """Claim a folder for as long as this lasts, and clear away what a run that was killed left unfinished in it.

    A result that it had finished, but not moved to its place, is moved there first.

    Args:
        alone: if not, others that are content with that may write there, too; then nothing is cleared away.

    Raises:
        WriteError: another run has it.
    """
    with ExitStack() as stack:
        try:
            import fcntl  # not on Windows

            folder = os.open(out, os.O_RDONLY)
            stack.callback(os.close, folder)
            fcntl.flock(folder, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise WriteError(f"{out}: another merlfit is writing there; wait for it, or name another folder") from None
        except (ImportError, OSError) as error:  # a system, or a file system, without locks
            why = getattr(error, "strerror", None) or "this system has no locks"
            note(f"{out}: cannot be locked ({why}): take care that no other merlfit writes there")
        else:
            if alone:
                _clear(out)
        yield


def _clear(out: Path) -> None:
    """Files and folders that were not whole when the process that wrote them was killed."""
    for left in filter(is_unfinished, sorted(out.glob(f"{UNFINISHED}*"))):
        with suppress(OSError):
            for path in sorted(left.glob("*.json")):
                if completeness(path) > Completeness.NOTHING:
                    place = _settled(ResultSlot(out, path.stem), ResultSlot(left, path.stem))
                    note(place.said or f"{place.path} is of a run that was killed before it had put it there")
            if left.is_dir():
                shutil.rmtree(left)
            elif not is_being_written(left):  # by a command that needs no folder for itself, or by Python
                left.unlink()


class ResultSlot:
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
def place_of(out: Path, name: str, alone: bool = True) -> Iterator[ResultSlot]:
    """Where to write the result ``name`` of ``out``.

    Where one stands already, or may come in the meantime, the new one is written into a folder beside it, and moved to
    its place in the end, however that comes, if it is of the same file and model and at least as complete. Otherwise
    both stay where they are.

    Args:
        alone: as of `claimed`.

    Raises:
        WriteError: a file of that name is no result, or the system lets none be put there.
    """
    target = ResultSlot(out, name)
    if os.path.exists(target.path) and not _is_result(target.path):
        raise WriteError(f"{target.path}: is there already, and no result of merlfit: move it, or name another folder")
    if alone and completeness(target.path) == Completeness.NOTHING:
        yield target
        return
    beside = unfinished(out)
    with refused(target.path, "written"):
        beside.mkdir()
    new = ResultSlot(beside, name)
    try:
        yield new
    finally:
        with refused(target.path, "written"):
            settled = _settled(target, new)
        new.path, new.said = settled.path, settled.said
        with suppress(OSError):  # not empty
            beside.rmdir()


def _settled(target: ResultSlot, new: ResultSlot) -> ResultSlot:
    """Where a result is in the end that was written beside that of its name: in its place, or in its own folder."""
    if not new.path.exists():
        return new
    if _takes_place(new.path, target.path):
        if not target.path.exists() and _came_first(target.path, new.path):
            return _settled(target, new)
        _move(new.path, target.path)
        return target
    before, after = completeness(target.path), completeness(new.path)
    words = _apart(_of(target.path), _of(new.path)) if _is_other(new.path, target.path) else ("", "")
    foreign = not _is_result(target.path)
    stays = f"{target.path} stays as it was, {'no result' if foreign else f'with {before.words}{words[0]}'}"
    if earlier := next((path for path in results_beside(target.path) if _takes_place(new.path, path)), None):
        moved = ResultSlot(earlier.parent, earlier.stem)
        _move(new.path, earlier)
    else:
        named = next(path for k in count(2) if not (path := target.folder / f"{target.path.stem}.{k}").exists())
        moved = ResultSlot(new.folder.rename(named), target.path.stem)
    moved.said = f"{stays}; {moved.path} is the new one, {after.words}{words[1]}"
    return moved


def _takes_place(new: Path, old: Path) -> bool:
    """Whether a result may be put in the place of what stands there."""
    before, after = completeness(old), completeness(new)
    foreign = os.path.exists(old) and not _is_result(old)
    return not foreign and not _is_other(new, old) and after >= before and not _loses_a_chain(new, old)


def _is_result(path: Path) -> bool:
    """Whether a file is a result, also one whose keys some other program has put into another order."""
    return is_ours(path, RESULT) or completeness(path) != Completeness.NOTHING


def _loses_a_chain(new: Path, old: Path) -> bool:
    """Whether the chain of an old result is worth more than the new one's: of unfinished ones nobody knows which is."""
    if Completeness.CHAIN == completeness(old) == completeness(new):
        return not filecmp.cmp(chain_of(new), chain_of(old), shallow=False)
    return _has_its_chain(old, old) and not _has_its_chain(new, new) and not _has_its_chain(new, old)


def _is_other(new: Path, old: Path) -> bool:
    """Whether two results say other things, being of another file or model."""
    return Completeness.NOTHING not in (completeness(old), completeness(new)) and _of(old) != _of(new)


def results_beside(path: Path) -> Iterator[Path]:
    """Where results are of other files or models, or less complete ones, that came later under a name."""
    for k in count(2):
        folder = path.parent / f"{path.stem}.{k}"
        if not folder.exists():
            return
        yield folder / path.name


def _of(path: Path) -> tuple[str, str, str] | None:
    """What a result is of: SHA-1 of the file, name of the model, and what was edited; None if there is none."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        found = json.loads(whole(path))
        edited = found.get("edited_from") and [[q["name"], q["value"]] for q in found["parameters"]]
        return str(found["source"]["sha1"]), str(found["model"]["name"]), str(edited or "")
    return None


def _apart(old: tuple[str, str, str] | None, new: tuple[str, str, str] | None) -> list[str]:
    """In words for each of two what it is of that the other is not."""
    (sha1, model, edited), (sha1_new, model_new, edited_new) = old or ("", "", ""), new or ("", "", "")
    files = [f" of another file (SHA-1 {sha1[:8]})", f" of the file with SHA-1 {sha1_new[:8]}"]
    models = [f" of the {model} model", f" of the {model_new} model"]
    values = [" edited to other values" if each else "" for each in (edited, edited_new)]
    return [
        (models[k] if model != model_new else "") + (files[k] if sha1 != sha1_new else "")
        + (values[k] if edited != edited_new else "") for k in range(2)
    ]  # fmt: skip


def _came_first(target: Path, new: Path) -> bool:
    """Whether another result came to an empty place; if not, the new one has the name, its chain not yet."""
    try:
        os.link(new, target)
    except FileExistsError:
        return True
    except OSError:  # a file system without links
        return False
    return False


def _move(new: Path, target: Path) -> None:
    """A result and its chain to the place of another; the chain of that goes even if there is no new one.

    Whoever is killed in between leaves a chain that the old result does not tell of (`chain_file`), and a new one that
    is adopted later.
    """
    if chain_of(new).exists():
        os.replace(chain_of(new), chain_of(target))
    elif not _has_its_chain(new, target):
        chain_of(target).unlink(missing_ok=True)
    os.replace(new, target)
    new.unlink(missing_ok=True)  # which is there still if both names were of one file (`_came_first`)


def _has_its_chain(new: Path, target: Path) -> bool:
    """Whether the chain beside ``target`` is that of the result ``new``."""
    with suppress(ResultError, NoPicture):
        return bool(chain_file(read_result(new), target))
    return False
