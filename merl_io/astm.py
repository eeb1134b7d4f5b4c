"""ASTM E1392-style tables of angle-resolved scatter, ``.astm``: lines of a keyword and its value, ``VARS``, and rows.

``VARS`` names the columns: ``theta_s`` and, unless a line of the header states it for all, ``theta_i`` (degrees);
``phi_i`` and ``phi_s`` where it is no scan in the plane of incidence; then values, by wavelength (``650nm``), as ``R``,
``G`` and ``B``, or as one ``BRDF``, ``BSDF`` or cosine-corrected ``CCBRDF`` or ``CCBSDF`` (BRDF times cos theta_s).
As in the standard light comes from azimuth 180, so that the mirror direction is at theta_s = theta_i and azimuth 0, and
a negative theta_s is on the light's side.
"""

from pathlib import Path

import numpy as np

from .bands import MERL, Bands
from .columns import spectral, wavelength
from .foreign import lines_of, numbers_of, stated_band, usable
from .scattered import ScatteredMeasurement
from .source import MerlError, contents
from .table import impossible, upright

ANGLES = {"theta_i": None, "phi_i": 180.0, "theta_s": None, "phi_s": 0.0}  # degrees, where nobody states them
COSINE = {"BRDF": False, "BSDF": False, "CCBRDF": True, "CCBSDF": True, "CCBDF": True}


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a file.

    Raises:
        MerlError: it cannot be read, is no such file, or holds what is no isotropic reflection.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    header, names, rows = _parts(path, lines_of(path, data, "ASTM file"))
    angles, at = _angles(path, header, names), {name.lower(): k for k, name in enumerate(names)}
    values = [k for k, name in enumerate(names) if name.lower() not in ANGLES]
    bands, corrected, notes = _bands(path, header, [names[k] for k in values])
    table, places = _table(path, names, rows)
    columns = {name: table[at[name]] if name in at else np.full(len(places), x) for name, x in angles.items()}
    columns = {
        "theta_i_deg": columns["theta_i"], "theta_o_deg": columns["theta_s"],
        "phi_deg": columns["phi_s"] - columns["phi_i"],
    }  # fmt: skip
    if wrong := impossible(columns, lambda k: f"line {places[k]}"):
        raise MerlError(f"{path}: {wrong[0]}: it is no angle of reflected light")
    theta_i, theta_o, phi = upright(columns)
    brdf = table[values] / np.cos(theta_o) if corrected else table[values]
    measured = ScatteredMeasurement(
        path, "ASTM", theta_i, theta_o, phi, brdf, np.ones(len(phi)), bands, sha1, blob, notes=notes
    )
    return usable(measured, lambda k: f"line {places[k]}")


Rows = list[tuple[int, str]]


def _parts(path: Path, lines: Rows) -> tuple[dict[str, str], list[str], Rows]:
    """Values by keyword, names of columns, and numbered rows.

    Raises:
        MerlError: no line names the columns, or there are no rows.
    """
    header: dict[str, str] = {}
    for k, (_, line) in enumerate(lines):
        keyword, _, value = line.replace("\t", " ").partition(" ")
        if keyword.upper() == "VARS":
            names = [name for name in value.replace(",", " ").split() if name]
            if not lines[k + 1 :]:
                raise MerlError(f"{path}: has no rows after VARS")
            return header, names, lines[k + 1 :]
        header[keyword.upper().rstrip(":=")] = value.strip(" :=\"'")
    raise MerlError(
        f"{path}: is no ASTM file: no line begins with VARS and names its columns, such as VARS theta_i,theta_s,650nm"
    )


def _angles(path: Path, header: dict[str, str], names: list[str]) -> dict[str, float]:
    """Every angle (degrees) of the header, or the usual one; of no meaning where a column has it.

    Raises:
        MerlError: one that has to be stated is not, or is no number.
    """
    found, there = {}, {name.lower() for name in names}
    for name, usual in ANGLES.items():
        text = header.get(name.upper())
        if name not in there and text is None and usual is None:
            raise MerlError(
                f"{path}: VARS names no {name}: add the column"
                + (", or a line such as THETA_I 30 before VARS" if name == "theta_i" else "")
                + f" (found: {', '.join(names)})"
            )
        try:
            found[name] = (usual or 0.0) if text is None else float(text.split()[0])
        except (ValueError, IndexError):
            raise MerlError(f"{path}: {name.upper()} is {text!r}, not an angle in degrees") from None
    return found


def _bands(path: Path, header: dict[str, str], names: list[str]) -> tuple[Bands, bool, tuple[str, ...]]:
    """Bands of the columns of values, whether they are times cos theta_s, and notes.

    Raises:
        MerlError: a column is nothing that such a file has.
    """
    if [name.upper() for name in names] in (list("RGB"), ["RED", "GREEN", "BLUE"]):
        return MERL, False, ()
    if len(names) == 1 and names[0].upper() in COSINE:
        stated = header.get("WAVELENGTH", "")
        um = wavelength(stated)
        bands, notes = stated_band(path, stated) if um is None else (spectral(path, [um]), ())
        return bands, COSINE[names[0].upper()], notes
    for name in names:
        if wavelength(name) is None:
            raise MerlError(
                f"{path}: column {name!r} of VARS is none of {', '.join(ANGLES)}, a wavelength such as 650nm, R, G and "
                f"B together, or a single {', '.join(COSINE)}"
            )
    return spectral(path, [wavelength(name) or 0.0 for name in names]), False, ()


def _table(path: Path, names: list[str], rows: Rows) -> tuple[np.ndarray, list[int]]:
    """Numbers by column, (K, N), and the lines they stand on.

    Raises:
        MerlError: a row has another number of cells, or anything else than numbers in it.
    """
    numbers = [numbers_of(path, number, line.replace(",", " ")) for number, line in rows]
    for (number, _), row in zip(rows, numbers, strict=True):
        if len(row) != len(names):
            raise MerlError(f"{path}: line {number} has {len(row)} cells, and VARS names {len(names)} columns")
    return np.array(numbers).T, [number for number, _ in rows]
