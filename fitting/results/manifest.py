"""The manifest of a folder of results: what was run there, with which settings, and how each file ended.

``manifest.jsonl`` has a line, a JSON object, for each thing that happened, the oldest first: it only grows, so that
nothing that was written is lost with the process that writes it. A last line that is torn is left out by who reads.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from ...merl_io.atomic import WriteError, append
from ...merl_io.source import MerlError, is_regular, opened
from ..settings.config import Config
from ..support.outputs import is_ours
from .schema import Result
from .schema_run import this_run
from .storage import versions
from .strict import Text

NAME = "manifest.jsonl"
BEGINS = b'{"at": "'  # every line
LONGEST = 2**24  # bytes of a line: a command may name a hundred thousand files; what is longer is of nobody we know


class Ending(StrEnum):
    """How the work on a file ended."""

    FITTED = "fitted"  # a result is written, of a fit that succeeded or did not
    BAD_INPUT = "bad input"
    FAILED = "failed"
    STOPPED = "stopped"
    LOST = "lost"  # with the process that worked on it


class Line(BaseModel):
    """What happened: a run ``began`` or ``ended``, or the work on a ``file`` did, or was not needed."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    at: str
    """Date and time, UTC."""
    event: Literal["began", "file", "ended"]
    command: list[Text] = []  # of `began`, as all down to `versions`
    files: int = 0
    jobs: int | Literal["one a worker"] = 0
    """Files at once."""
    executor: str = ""
    """``Here``, ``Pool``, or the address of a cluster."""
    settings: dict[str, Any] = {}
    versions: dict[str, str] = {}
    material: Text = ""  # of `file`, as all down to `seconds`
    file: Text = ""
    ended: Ending | Literal["kept"] = "kept"
    """``kept``: a result of the same file, settings and versions was there."""
    status: str | None = None
    """Status of the fit, if there is one."""
    error: Text | None = None
    sha1: str | None = None
    stopped: bool = False  # of `ended`
    seconds: float | None = None


class Journal:
    """The manifest of a folder, for one run."""

    def __init__(self, out: Path) -> None:
        """Begin, or go on.

        Raises:
            WriteError: a file of that name is no manifest.
        """
        self.path = out / NAME
        if is_regular(self.path) and not self.path.is_symlink() and not (is_ours(self.path) or _begun(self.path)):
            raise WriteError(
                f"{self.path}: is there already, and no manifest of merlfit: move it, or name another folder"
            )
        if _is_torn(self.path):
            append(self.path, b"\n")

    def began(self, config: Config, files: int, jobs: int | Literal["one a worker"], executor: str) -> None:
        """A run begins."""
        self._write(
            event="began", command=this_run().command, files=files, jobs=jobs, executor=executor,
            settings=config.plain(), versions=versions(),
        )  # fmt: skip

    def ended(self, file: Path, ended: Ending | Literal["kept"], result: Result | None, error: str = "") -> None:
        """The work on a file ended, with a result or an error."""
        self._write(
            event="file", material=file.stem, file=str(file), ended=ended,
            status=result.fit.status if result else None, error=error or None,
            sha1=result.source.sha1 if result else None, seconds=result.seconds["total"] if result else None,
        )  # fmt: skip

    def closed(self, stopped: bool, seconds: float) -> None:
        """The run ends."""
        self._write(event="ended", stopped=stopped, seconds=round(seconds, 1))

    def _write(self, **told: Any) -> None:  # noqa: ANN401 - fields of a line
        line = Line(at=datetime.now(UTC).isoformat(timespec="seconds"), **told)
        append(self.path, (json.dumps(line.model_dump(mode="json", exclude_unset=True)) + "\n").encode())


def _begun(path: Path) -> bool:
    """Whether all of a manifest is the beginning of its first line: a full disk cut it off."""
    with suppress(MerlError), opened(path) as (file, size):
        return size < LONGEST and file.read().startswith(BEGINS) and _is_torn(path)
    return False


def _is_torn(path: Path) -> bool:
    """Whether a manifest does not end with the end of a line."""
    with suppress(MerlError), opened(path) as (file, size):
        file.seek(max(0, size - 1))
        return file.read() not in (b"", b"\n")
    return False


def lines(out: Path) -> Iterator[Line]:
    """What the manifest of a folder says; lines that are torn or of another program are left out."""
    with suppress(MerlError), opened(out / NAME) as (file, _):
        while line := file.readline(LONGEST):
            with suppress(ValidationError):
                yield Line.model_validate_json(line)
