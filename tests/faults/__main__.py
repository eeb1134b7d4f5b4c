"""`python -m tests.faults [SECTION ...]`: tries faults and writes results/faults.md; `--few` for a twentieth."""

import sys

import typer

from .tried import RESULTS, TITLES, Tried


def main(sections: list[str] = typer.Argument(None), few: bool = False) -> None:
    """Try the faults of the sections, all of them without a name."""
    from . import folders, kills, loaders

    tried = Tried(None if few else RESULTS)
    for section in sections or TITLES:
        {"loaders": loaders, "folders": folders, "kills": kills}[section].run(tried, few)
    sys.exit(1 if tried.wrong else 0)


if __name__ == "__main__":
    typer.run(main)
