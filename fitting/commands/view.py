"""`merlfit view`: results in a page of the browser, to look at and to edit."""

import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import get_args

from ..pipeline.draws import NoPicture
from ..results.storage import read_result
from ..support.compilation import use_persistent_cache
from ..support.terminal import Stopped, console, fail, note, writable_folder
from ..view.frames import Shown
from ..view.live import Live
from .export import To

MISSING = "merlfit view needs packages that are not installed: pip install 'merlfit[view]'"


def view_results(paths: Sequence[Path], file: Path | None, out: Path | None, port: int, browser: bool) -> None:
    """Serve the page until it is stopped; exits with 2 after bad input.

    Args:
        file: that was measured, if it moved since the fit. out: folder for what is saved, by default that of each
            result. port: of the page, 0 for any that is free. browser: whether to open it.
    """
    try:
        from ..view.server import serve
    except ImportError:
        raise fail(MISSING) from None
    if file is not None and len(paths) > 1:
        raise fail("--file is for one result at a time")
    if out is not None:
        writable_folder(out)
    use_persistent_cache()
    shown = [_shown(path, file) for path in paths]

    def ready(address: str, once: str) -> None:
        console.print(f"{address}\nOpen it in a browser of this machine; Ctrl-C ends it.", soft_wrap=True)
        if browser:  # one of a terminal comes back when it is left
            Thread(target=webbrowser.open, args=[once], daemon=True).start()

    try:
        with suppress(Stopped):  # which is how it ends
            serve(Live(shown, out, get_args(To)), port, ready)
    except OSError as error:
        raise fail(
            f"--port {port}: {str(error.strerror or error).split(' (')[0]}: choose another, or leave it out"
        ) from None
    console.print("ended")


def _shown(path: Path, file: Path | None) -> Shown:
    try:
        found = Shown(path, read_result(path), file)
    except NoPicture as error:
        raise fail(f"{path}: there is no material to look at: {error}") from None
    if why := found.subject.lacks.get("measurement"):
        note(f"{path}: the file is not shown: {why}")
    return found
