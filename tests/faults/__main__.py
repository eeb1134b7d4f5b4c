"""`python -m tests.faults [SECTION ...]`: tries faults and writes results/faults.md.

`--few` tries a twentieth and writes nothing, `--times N` has folders and kills tried so often, `--out` names a folder.
A section is loaders, inputs, commands, folders, kills or clusters, or one trial of the last three, `folders.vanish`.
"""

import sys
from pathlib import Path

import typer

from .tried import RESULTS, TITLES, Tried


def main(
    sections: list[str] = typer.Argument(None), few: bool = False, times: int | None = None, out: Path = RESULTS
) -> None:
    """Try the faults of the sections, all of them without a name."""
    from . import clusters, commands, folders, inputs, kills, loaders

    tried = Tried(None if few else out)
    for asked in sections or TITLES:
        section, _, trial = asked.partition(".")
        only = [trial] if trial else []
        tried.begin(section, only)
        if section in ("loaders", "inputs", "commands"):
            {"loaders": loaders, "inputs": inputs, "commands": commands}[section].run(tried, few)
        else:
            {"folders": folders, "kills": kills, "clusters": clusters}[section].run(tried, only, few, times)
    sys.exit(1 if tried.wrong else 0)


if __name__ == "__main__":
    typer.run(main)
