"""Stand-ins for a fit that worker processes can import: what they do is in the name of the file."""

import os
import signal
import time

from merlfit.fitting.batch.unit import Ended
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.support.terminal import Stopped

from .made_results import made

FOREVER = 60.0


def task(unit, report):
    """``quick``, ``slow``, ``killed`` (always), ``once`` (killed the first time), ``told`` (to stop, the first time),
    ``halted``, ``raises``, ``prints``; of a cluster:
    ``waits`` (says which process it is, at first long enough to be killed), ``patient`` (until it is stopped),
    ``tells`` (says which process it is), ``idle`` (does nothing, always),
    ``alone`` (fails where another is at work)."""
    kind = unit.name.split("-")[0]
    try:
        began = unit.out / f"{unit.name}.began"
        first = not began.exists()
        began.write_text(str(os.getpid()))
        report("reading")
        if kind == "killed" or (kind == "once" and first):
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "told" and first:
            os.kill(os.getpid(), signal.SIGTERM)
        if kind == "halted":
            os.kill(os.getpid(), signal.SIGSTOP)
        if kind == "raises":
            return Ended(Ending.FAILED, error=f"{unit.path}: it raises")
        if kind == "prints":
            os.write(1, b"said by a library\n")
        if kind == "waits":
            told = unit.path.with_suffix(".told")
            if not told.exists():
                told.touch()
                report(str(os.getpid()))
                time.sleep(FOREVER)
        while kind == "patient":
            report("reading")
            time.sleep(0.1)
        if kind == "tells":
            report(str(os.getpid()))
        if kind == "alone":
            (unit.path.parent / "at-work").mkdir()  # fails where there is one
            time.sleep(2)
            (unit.path.parent / "at-work").rmdir()
        if kind in ("slow", "idle"):
            time.sleep(FOREVER)
    except Stopped as stop:
        write_result(unit.target, made(unit.name))
        return Ended(Ending.STOPPED, made(unit.name), code=stop.code)
    write_result(unit.target, made(unit.name))
    return Ended(Ending.FITTED, made(unit.name))
