"""What the commands say: tables and errors, what is being done and for how long."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

BAD_INPUT, FAILED_FIT = 2, 1  # exit codes
console = Console()
if not console.is_terminal:
    console = Console(width=140)  # tables in logs and pipes are not squeezed to 80 columns
errors = Console(stderr=True)


def fail(message: str) -> typer.Exit:
    """Print one line; what to raise unless others go on."""
    errors.print(f"merlfit: {message}", style="red", highlight=False, soft_wrap=True, markup=False)
    return typer.Exit(BAD_INPUT)


def progress_display() -> Progress:
    """What is being done and for how long, on a terminal."""
    return Progress(
        SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip


def writable_folder(out: Path) -> None:
    """Make the folder now: an hour of fits is not to end with nowhere to go."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise fail(f"{out}: results cannot be written there ({error.strerror or error})") from None


def reporter(progress: Progress, task: TaskID, label: str) -> Callable[[str], None]:
    """Stages to the progress display on a terminal, to plain lines elsewhere (a new stage, not every step)."""
    last = [""]

    def report(stage: str) -> None:
        progress.update(task, description=f"{label}: {stage}")
        if not console.is_terminal and stage.split(":")[0] != last[0]:
            last[0] = stage.split(":")[0]
            console.print(f"{label}: {stage}", markup=False)

    return report
