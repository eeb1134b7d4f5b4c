"""`merlfit check`: what files hold, as tables. A look at a file needs no model, and does not wait for jax."""

from collections.abc import Sequence
from pathlib import Path

import typer
from rich.table import Table

from ...merl_io.binary import BRIGHTEST, OUTLIER, Dims, MerlError, said
from ...merl_io.check import FileReport, ScatteredReport, inspect_file
from ..support.numbers import number
from ..support.tables import table
from ..support.terminal import BAD_INPUT, console, fail, note


def check_files(files: list[Path], allowed: Dims | None) -> None:
    """Print what files hold; whatever is wrong with one, the others have their turn. Exits with 2 after bad input."""
    reports, bad = [], 0
    for path in files:
        try:
            reports.append(inspect_file(path, allowed))
        except MerlError as error:
            bad += 1
            fail(str(error))
    gridded = [each for each in reports if isinstance(each, FileReport)]
    listed = [each for each in reports if not isinstance(each, FileReport)]
    if gridded:
        console.print(check_table(gridded))
    if listed:
        console.print(scattered_table(listed))
    for each in reports:
        for line in each.told:
            note(f"{each.path}: {line}")
    if bad:
        raise typer.Exit(BAD_INPUT)


def check_table(reports: Sequence[FileReport]) -> Table:
    """What `merlfit check` prints."""
    title = (
        f"MERL files (bins: of theta_h, theta_d and phi_d; inf: infinite, or above {BRIGHTEST:g}/sr; "
        f"outliers: over {OUTLIER:g} times as bright as their neighbours; max: largest value, 1/sr; genuine: by SHA-1)"
    )
    numbers = ("valid", "negative", "NaN", "inf", "outliers", "max R", "max G", "max B")
    return table(title, ("file", "bins", *numbers, "genuine MERL"), ("file", "genuine MERL"), (
        (str(r.path), said(r.dims), f"{r.fraction_valid:.1%}", str(r.negative), str(r.nan), str(r.inf), str(r.outliers),
         *(number(x) for x in r.largest), f"yes: {r.genuine}" if r.genuine else "no")
        for r in reports
    ))  # fmt: skip


def scattered_table(reports: Sequence[ScatteredReport]) -> Table:
    """What `merlfit check` prints of files of scattered directions."""
    found = table(
        "files of scattered directions (angles: least and largest, degrees; max: largest value, 1/sr, and its theta_i, "
        "theta_o, phi)",
        ("file", "format", "samples", "channels", "valid", "theta_i", "theta_o", "theta_h", "max", "max at"),
        ("file", "channels"),
    )
    for r in reports:
        first, last, count = r.channels
        many = f"{count} of {count + r.left_out}" if r.left_out else str(count)
        channels = f"{many}: {first} to {last}" if count > 1 else first
        angles = (f"{low:.1f} {high:.1f}" for low, high in (r.theta_i, r.theta_o, r.theta_h))
        row = (str(r.path), r.format, str(r.samples), channels, f"{r.fraction_valid:.1%}")
        found.add_row(*row, *angles, number(r.largest), " ".join(f"{x:.1f}" for x in r.brightest))
    return found
