"""`merlfit cost` in a terminal: its progress, and what it says."""

from pathlib import Path

import typer

from ..cost.frontier import FILE, keep
from ..cost.measure import ROWS, CostError, measure, tidy
from ..cost.report import frontier_figure, gains, table, write_markdown
from ..show.style import save
from ..support.compilation import cache_folder
from ..support.outputs import refuse_others
from ..support.terminal import FAILED_FIT, Stopped, console, fail, note, reporting, writable_folder

OUTPUTS = FILE, "cost.md", "cost.png", ROWS


def measure_on(file: Path | None, out: Path, repeats: int, force: bool = False) -> None:
    """Measure, write what was found, and print it; what was measured is kept whatever ends it.

    Args:
        force: write over any file.
    """
    writable_folder(out)
    refuse_others([out / name for name in OUTPUTS], force)
    try:
        with reporting("cost", "cost") as say:
            frontier = measure(file, out, repeats, say)
        kept = [keep(frontier, folder) for folder in (out, *([] if file else [cache_folder()]))]
        write_markdown(frontier, out / "cost.md")
        save(frontier_figure(frontier), out / "cost.png")
        tidy(out)
    except Stopped as stop:
        note(f"stopped by {stop}; what was measured is kept; the same command continues from there")
        raise typer.Exit(stop.code) from None
    except OSError as error:
        raise fail(f"{error}; what was measured is kept; the same command continues from there") from None
    except CostError as error:
        fail(str(error))
        raise typer.Exit(FAILED_FIT) from None
    console.print(table(frontier))
    console.print(gains(frontier))
    used = "" if file else f"; fits will use {kept[1]}"
    console.print(f"wrote {kept[0]}, cost.md, cost.png and rows.json beside it{used}")
