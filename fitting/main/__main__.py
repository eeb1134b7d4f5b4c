"""The command ``merlfit``, and ``python -m merlfit``."""

import atexit
import os
import signal
import sys
from contextlib import suppress


def main() -> None:
    """Entry point; until the commands hear Ctrl-C, and after they do, it ends the program without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # which raises wherever an import or an exit is
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    codes: list[int] = []
    atexit.register(_leave, codes)  # before anything else is, and so called last
    from .fitting.commands.cli import main as commands  # pyright: ignore[reportMissingImports] - installed, it lies beside

    try:
        commands()
    except SystemExit as end:
        if isinstance(end.code, int | None):
            codes.append(end.code or 0)
        raise
    codes.append(0)


def _leave(codes: list[int]) -> None:
    """End the process when all is done that waits for its end; Python would take its programs apart first, in 0.8 s.

    Args:
        codes: the exit code; none of an end that Python is to tell of.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or never open
            stream.flush()
    for code in codes[-1:]:
        os._exit(code)


if __name__ == "__main__":
    main()
