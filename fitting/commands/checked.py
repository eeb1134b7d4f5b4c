"""`merlfit check`: what files hold, as tables. A look at a file needs no model, and does not wait for jax."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from ...merl_io.bands import MERL
from ...merl_io.binary import BRIGHTEST, OUTLIER, Dims, Measurement, MerlError, dims_text
from ...merl_io.inputs import read, remarks
from ...merl_io.scattered import Quantity, ScatteredMeasurement, half_difference
from ..support.numbers import number
from ..support.tables import table
from ..support.terminal import BAD_INPUT, console, fail, note

Row = tuple[str, ...]


def check_files(files: list[Path], allowed: Dims | None, quantity: Quantity = "brdf") -> None:
    """Print what files hold; whatever is wrong with one, the others have their turn. Exits with 2 after bad input."""
    gridded, listed, notes, bad = [], [], [], 0
    for path in files:
        try:
            measured = read(path, dims=allowed, quantity=quantity)
        except MerlError as error:
            bad += 1
            fail(str(error))
            continue
        if isinstance(measured, Measurement):
            gridded.append(row_of_bins(measured))
        else:
            listed.append(row_of_directions(measured))
        notes += [f"{path}: {line}" for line in remarks(measured)]
        del measured  # before the next one takes its memory
    if gridded:
        console.print(check_table(gridded))
    if listed:
        console.print(scattered_table(listed))
    for line in notes:
        note(line)
    if bad:
        raise typer.Exit(BAD_INPUT)


def check_table(rows: Iterable[Row]) -> Table:
    """What `merlfit check` prints."""
    title = (
        f"MERL files (bins: of theta_h, theta_d and phi_d; inf: infinite, or above {BRIGHTEST:g}/sr; "
        f"outliers: over {OUTLIER:g} times as bright as their neighbours; max: largest value, 1/sr; genuine: by SHA-1)"
    )
    numbers = ("valid", "negative", "NaN", "inf", "outliers", "max R", "max G", "max B")
    return table(title, ("file", "bins", *numbers, "genuine MERL"), ("file", "genuine MERL"), rows)


def row_of_bins(m: Measurement) -> Row:
    """A file's row in it."""
    largest = dict(zip(m.bands.names, (float(np.nanmax(plane)) for plane in m.values), strict=True))
    counts = (f"{m.valid.mean():.1%}", str(m.negative), str(m.nan), str(m.inf), str(m.outliers))
    brightest = (number(largest.get(name, 0.0)) for name in MERL.names)
    return str(m.path), dims_text(m.dims), *counts, *brightest, f"yes: {m.genuine}" if m.genuine else "no"


def scattered_table(rows: Iterable[Row]) -> Table:
    """What `merlfit check` prints of files of scattered directions."""
    title = (
        "files of scattered directions (angles: least and largest, degrees; max: largest value, 1/sr, and its theta_i, "
        "theta_o, phi)"
    )
    heads = ("file", "format", "samples", "channels", "valid", "theta_i", "theta_o", "theta_h", "max", "max at")
    return table(title, heads, ("file", "channels"), rows)


def row_of_directions(m: ScatteredMeasurement) -> Row:
    """A file's row in it."""
    names, count = m.bands.names, len(m.bands)
    many = f"{count} of {count + m.left_out}" if m.left_out else str(count)
    channels = f"{many}: {names[0]} to {names[-1]}" if count > 1 else names[0]
    channels += " with uncertainties" if m.uncertainty is not None else ""
    theta_h = half_difference(m.theta_i, m.theta_o, m.phi)[0]
    angles = (f"{np.degrees(x.min()):.1f} {np.degrees(x.max()):.1f}" for x in (m.theta_i, m.theta_o, theta_h))
    k = int(np.argmax(np.max(np.nan_to_num(m.values, nan=-np.inf), axis=0)))
    brightest = (np.degrees(m.theta_i[k]), np.degrees(m.theta_o[k]), np.degrees(m.phi[k]) % 360)
    return (
        str(m.path), m.format, str(len(m.theta_i)), channels, f"{m.valid.mean():.1%}", *angles,
        number(float(np.nanmax(m.values))), " ".join(f"{x:.1f}" for x in brightest),
    )  # fmt: skip
