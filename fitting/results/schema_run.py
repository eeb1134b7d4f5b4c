"""When and how a result was computed."""

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
