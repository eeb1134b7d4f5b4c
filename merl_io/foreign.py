"""Files of other programs: their lines and numbers, the wavelength that they state, and what all of them leave out."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from .bands import Bands
from .binary import BRIGHTEST
from .columns import spectral
from .outliers import examined
from .scattered import ScatteredMeasurement
from .source import MerlError

UNSTATED_UM = 0.55  # stands for a wavelength that nobody states; only diffraction asks for it
NANOMETRES = re.compile(r"(?<![\d.])(\d{3,5}(?:\.\d+)?)\s?nm(?![a-z])", re.IGNORECASE)
HORIZON = np.pi / 2 - 1e-6  # rad: 90 degrees may be stored a little less


def lines_of(path: Path, data: bytes, what: str) -> list[tuple[int, str]]:
    """Numbered lines of a text that are not empty.

    Raises:
        MerlError: it is no text.
    """
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise MerlError(f"{path}: is no {what}: it is no UTF-8 text") from None
    return [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]


def numbers_of(path: Path, number: int, line: str) -> list[float]:
    """All numbers of a line, NaN among them.

    Raises:
        MerlError: there is anything else in it.
    """
    try:
        return [float(word) for word in line.split()]
    except ValueError:
        raise MerlError(f"{path}: line {number}: {line[:40]!r} is not a row of numbers") from None


def stated_band(path: Path, remarks: str) -> tuple[Bands, tuple[str, ...]]:
    """The band of the only wavelength (nm) in a file's remarks or its name; without one a made-up band, and a note."""
    for text in (remarks, path.stem.replace("_", " ")):
        wavelengths = {*NANOMETRES.findall(text)}
        if len(wavelengths) == 1:
            return spectral(path, [1e-3 * float(wavelengths.pop())]), ()
    note = (
        f"states no wavelength: {1e3 * UNSTATED_UM:g} nm is taken, which matters to diffraction alone; to state it, "
        f"rename the file, such as {path.stem}_633nm{path.suffix}"
    )
    return spectral(path, [UNSTATED_UM]), (note,)


def usable(measured: ScatteredMeasurement, place: Callable[[int], str] | None = None) -> ScatteredMeasurement:
    """The same without directions at the horizon or below it, and without what is no number.

    Args:
        place: where a sample stands in the file, in words; given for lists of directions, whose outliers are left out.

    Raises:
        MerlError: nothing is left.
    """
    above = np.flatnonzero((measured.theta_i < HORIZON) & (measured.theta_o < HORIZON))
    values, notes = measured.values[:, above], measured.notes
    values = np.where(np.abs(values) < BRIGHTEST, values, np.nan)
    if not np.isfinite(values).any():
        raise MerlError(f"{measured.path}: holds no datum: every value is not finite, or at the horizon or below it")
    if below := len(measured.phi) - len(above):
        notes = (*notes, f"{below} samples with light or viewer at the horizon or below it are left out")
    kept = replace(
        measured, theta_i=measured.theta_i[above], theta_o=measured.theta_o[above], phi=measured.phi[above],
        values=values, share=measured.share[above], notes=notes,
        solid_angle=None if measured.solid_angle is None else measured.solid_angle[above],
    )  # fmt: skip
    return kept if place is None else examined(kept, lambda k: place(int(above[k])))
