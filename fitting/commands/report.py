"""`merlfit report` in a terminal: its progress, and what it says."""

import os
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import typer

from ..show.results_table import results_in, tell_errors
from ..show.sheet import Head
from ..show.site import refuse_foreign, write_site
from ..support.numbers import counted
from ..support.terminal import FAILED_FIT, Stopped, console, fail, note, reporting, writable_folder


def report_on(
    folder: Path, out: Path, files: Path | None, jobs: int | None, origin: str | None, force: bool = False,
    head: Head | None = None,
) -> None:  # fmt: skip
    """Write the pages and say where they begin; ends with an error line where there is nothing.

    Exits with 2 if a result cannot be read, with 1 if a page cannot be made; the others are.

    Args:
        force: write over any file. head: of the sheets that are printed, None for none.
    """
    rows = results_in(folder)
    if head is not None and head.sample is not None and len(rows) > 1:
        raise fail(
            f"--sample {head.sample}: is of one result, and {folder} has {len(rows)}; leave it out, or move the one"
        )
    if files is not None and not os.path.isdir(files):
        raise fail(f"--files {files}: no such folder")
    writable_folder(out)
    try:
        refuse_foreign(out, force)
        with reporting("pages", "pages") as say:
            made = write_site(rows, folder, out, files, jobs, say, origin, head)
    except BrokenProcessPool:
        raise fail(
            f"a process that made pages was killed, perhaps for want of memory: {out} is not whole; try --jobs 1"
        ) from None
    except Stopped as stop:
        note(f"stopped by {stop}: {out} is not whole; the same command writes it anew")
        raise SystemExit(stop.code) from None
    code = tell_errors(rows)
    for lines, failed in made:
        for line in lines:
            note(line)
        code = code or (FAILED_FIT if failed else 0)
    console.print(f"wrote {out / 'index.html'}: {counted(len(made), 'page')}; open it in a browser")
    if code:
        raise typer.Exit(code)
