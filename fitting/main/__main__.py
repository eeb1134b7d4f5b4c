"""The command ``merlfit``, and ``python -m merlfit``."""

import atexit
import os
import signal
import sys
import threading
from contextlib import suppress


def main() -> None:
    """Entry point; until the commands hear Ctrl-C, and after they do, it ends the program without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # which raises wherever an import or an exit is
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .fitting.commands.cli import main as commands  # pyright: ignore[reportMissingImports] - installed, it lies beside

    code = 0
    try:
        commands()
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        code = end.code or 0
    if sys.getprofile() or sys.gettrace():  # they have something to say when the program ends
        sys.exit(code)
    _leave(code)


def _leave(code: int) -> None:
    """End the process as `multiprocessing` ends its own: taking modules and programs apart, Python would take 0.8 s."""
    threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue] - waits for threads
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or never open
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
