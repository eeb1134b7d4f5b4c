"""Names of a table's columns: which angle, weight or wavelength each of them is, in the words that programs use."""

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from .bands import MERL, Bands
from .source import MerlError

ANGLES = ("theta_i_deg", "theta_o_deg", "phi_deg")
WEIGHT = "weight"
ALIASES = {
    "theta_i_deg": ("theta_i", "theta_in", "theta_inc", "theta_incident", "thetai", "aoi", "angle_of_incidence",
                    "incidence", "incidence_angle", "incident_angle", "theta_l"),
    "theta_o_deg": ("theta_o", "theta_out", "theta_s", "theta_r", "theta_v", "theta_e", "thetao", "thetas", "thetar",
                    "scatter_angle", "scattering_angle", "viewing_angle", "theta_scatter", "theta_scattered"),
    "phi_deg": ("phi", "dphi", "delta_phi", "phi_o", "phi_s", "phi_r", "phi_v", "azimuth", "relative_azimuth"),
    WEIGHT: ("weight", "weights"),
}  # fmt: skip
MEANT = {alias: name for name, aliases in ALIASES.items() for alias in aliases}
DEGREES = {
    "": 1.0,
    "deg": 1.0,
    "degree": 1.0,
    "degrees": 1.0,
    "°": 1.0,
    "rad": math.degrees(1),
    "radians": math.degrees(1),
}
PLAUSIBLE_UM = 1e-3, 100.0  # from soft X-rays to the far infrared: nm given for um, or um for nm, lie outside
UNITS_UM = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0}
BARE = ((100.0, math.inf, "nm"), (0.1, 5.0, "um"))  # a wavelength without a unit is in that one, if it is so large
SHOWN = 12  # names, or errors, of a file that a message repeats


@dataclass(frozen=True)
class Columns:
    """What the columns of a file are.

    Attributes:
        degrees: where an angle or the weight stands, and what it is times to be in degrees, by our name. bands: of the
            values. values: where these stand, in the order of the bands.
    """

    degrees: dict[str, tuple[int, float]]
    bands: Bands
    values: list[int]


def known(cell: str) -> tuple[str, float] | None:
    """Our name of an angle or weight, and the unit of its numbers in degrees; None if it is neither."""
    match = re.fullmatch(r"(.+?)[\s_]*(?:[\[(]?\s*(deg|degrees?|°|rad|radians)?\s*[\])]?)", cell.strip().lower())
    if match is None or (name := MEANT.get(re.sub(r"[\s\-]+", "_", match[1]))) is None:
        return None
    return name, 1.0 if name == WEIGHT else DEGREES[match[2] or ""]


def names_angles(cells: list[str]) -> int:
    """How many of the angles are named."""
    return len({column[0] for column in map(known, cells) if column is not None} & {*ANGLES})


def columns_of(path: Path, cells: list[str]) -> Columns:
    """What the columns are by their names.

    Raises:
        MerlError: one is missing, has no name, is there twice, or is nothing that a table has; all of that in one line.
    """
    names = [cell.strip() for cell in cells]
    meant = {k: column for k, name in enumerate(names) if (column := known(name)) is not None}
    wrong = []
    if missing := [name for name in ANGLES if name not in {angle for angle, _ in meant.values()}]:
        commas = "" if len(names) > 1 else " with commas between"
        in_plane = missing[-1] == ANGLES[2] and len(missing) < len(ANGLES)
        scan = "; a scan in the plane of incidence has phi_deg 180, or the ending .astm" if in_plane else ""
        wrong.append(f"its first line names no column {', '.join(missing)}; it needs {', '.join(ANGLES)}{commas}{scan}")
    if "" in names:
        wrong.append(f"column {names.index('') + 1} has no name; is there a comma too many?")
    repeated = Counter(
        [angle for angle, _ in meant.values()] + [n for k, n in enumerate(names) if n and k not in meant]
    )
    wrong += [f"column {name!r} is there twice" for name, count in repeated.items() if count > 1]
    others = {k: name for k, name in enumerate(names) if name and k not in meant}
    colours = {name for name in others.values() if name in MERL.names}
    bare = [name for name in others.values() if name not in MERL.names and wavelength(name) is None]
    if bare:
        wrong.append(
            f"column {', '.join(map(repr, bare[:SHOWN]))} is none of {', '.join(ANGLES)}, {WEIGHT}, a wavelength such "
            "as 550nm or 0.55um, or R, G and B"
        )
    elif colours and colours != {*MERL.names}:
        lacking = next(name for name in MERL.names if name not in colours)
        wrong.append(f"has no column {lacking}: R, G and B stand together")
    elif colours and len(colours) < len(others):
        wrong.append("has columns R, G and B beside wavelengths: leave one or the other out")
    if wrong:
        raise MerlError(f"{path}: {listed(wrong)} (found: {listed(names, ', ')})")
    degrees = {name: (k, unit) for k, (name, unit) in meant.items()}
    if colours:
        return Columns(degrees, MERL, [names.index(name) for name in MERL.names])
    return Columns(degrees, spectral(path, [wavelength(name) or 0.0 for name in others.values()]), list(others))


def wavelength(name: str) -> float | None:
    """Wavelength of a column of values (um); None if its name is none."""
    match = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*[\[(]?\s*(nm|um|µm|μm|)\s*[\])]?", name)
    if match is None:
        return None
    number = float(match[1])
    unit = match[2] or next((unit for low, high, unit in BARE if low <= number < high), None)
    return None if unit is None else round(number * UNITS_UM[unit], 9)


def spectral(path: Path, wavelengths_um: list[float]) -> Bands:
    """Bands of wavelengths, named after these.

    Raises:
        MerlError: there are none, two are the same, or one is none.
    """
    for x in wavelengths_um:
        if not (math.isfinite(x) and PLAUSIBLE_UM[0] <= x <= PLAUSIBLE_UM[1]):
            raise MerlError(f"{path}: wavelength {x:g} um is not between {PLAUSIBLE_UM[0]:g} and {PLAUSIBLE_UM[1]:g}")
    names = tuple(f"{round(1e3 * x, 4):.10g}nm" for x in wavelengths_um)
    if not names:
        raise MerlError(f"{path}: has no column of values, such as 550nm")
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise MerlError(f"{path}: wavelength {listed(twice, ', ')} is there twice")
    return Bands(names, tuple(wavelengths_um))


def listed(words: list[str], between: str = "; ") -> str:
    """The first of them, and how many more there are."""
    more = len(words) - SHOWN
    return between.join(words[:SHOWN]) + (f"{between}and {more} more" if more > 0 else "")
