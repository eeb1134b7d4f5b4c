"""When and how a result was computed, and what it was edited from."""

import os
import sys
from datetime import UTC, datetime
from pathlib import PurePath

from .strict import Many, Strict, Text, readable


class Run(Strict):
    """When and how a result was computed."""

    finished: str
    """When it was computed: date and time in UTC (ISO 8601)."""
    command: Many[Text]
    """Command line; empty where Python called merlfit as a library."""
    folder: Text | None = None
    """Folder that it ran in, from which a relative `source.path` is seen; null if it was gone."""


class EditedFrom(Strict):
    """The fit that a material was edited from."""

    result: Text
    """Its result, as it was named."""
    numbers_sha1: str | None
    """`numbers_sha1` of that result."""
    fitted: dict[str, float]
    """What the fit had, of each number that was changed; what it is now is in `parameters`."""


def this_run() -> Run:
    """Now, and the command line of this process if it is merlfit's."""
    program = PurePath(sys.argv[0] if sys.argv else "")
    ours = program.stem == "merlfit" or (program.name == "__main__.py" and program.parent.name in ("merlfit", "main"))
    command = ["merlfit", *(str(readable(word)) for word in sys.argv[1:])] if ours else []
    return Run(finished=datetime.now(UTC).isoformat(timespec="seconds"), command=command, folder=_here())


def _here() -> str | None:
    """Working folder; None if it is gone."""
    try:
        return os.getcwd()
    except OSError:
        return None
