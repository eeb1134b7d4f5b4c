"""`python -m tests.bench [SECTION ...]`: every section in a process of its own, results in results/bench/.

Sections can be run anew one by one. Files are made in a temporary folder unless ``--files`` names one to keep.
"""

import importlib
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from . import record

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
ON_CPU = (  # short ones first
    "fit", "presets", "cold", "growth", "channels", "batch", "cluster", "solver", "against_scipy", "against_numpy",
    "rivals",
)  # fmt: skip
CALIBRATIONS = (
    "calibration", "calibration_scattered", "first_order", "first_order_rivals", "first_order_scattered",
)  # fmt: skip
APART = (  # only when they are named
    "tiers", "convergence", "sums", "posterior", *CALIBRATIONS, "predictions", "halves", "nickel", "gpu", "report",
)  # fmt: skip
SECTIONS = (*ON_CPU, *APART)


@app.command()
def main(
    sections: Annotated[
        list[str] | None, typer.Argument(help=f"{', '.join(SECTIONS)}; all but {', '.join(APART)} by default.")
    ] = None,
    few: Annotated[bool, typer.Option("--few", help="Fewer materials for comparisons, no batch of all files.")] = False,
    files: Annotated[Path | None, typer.Option(help="Folder to keep the MERL files in, 35 MB each.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = record.RESULTS,
    on_cpu: Annotated[bool, typer.Option("--on-cpu", hidden=True, help="Run the section gpu without a GPU.")] = False,
) -> None:
    """Measure."""
    if unknown := set(sections or ()) - set(SECTIONS):
        raise typer.BadParameter(f"unknown section {', '.join(sorted(unknown))}; known: {', '.join(SECTIONS)}")
    failed = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = files or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if sections and len(sections) == 1:
            name = "calibration" if sections[0] in CALIBRATIONS else sections[0]
            module = importlib.import_module(f"{__package__}.{name}")
            run = getattr(module, sections[0]) if sections[0] in CALIBRATIONS else module.run
            run(folder.resolve(), out, not few, **({"on_cpu": on_cpu} if sections == ["gpu"] else {}))
        else:
            for section in sections or ON_CPU:
                options = ["--files", str(folder), "--out", str(out), *(["--few"] if few else [])]
                done = subprocess.run(
                    [sys.executable, "-m", __package__ or "tests.bench", section, *options], check=False
                )
                failed += [section] if done.returncode else []
    record.summary(out)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    app()
