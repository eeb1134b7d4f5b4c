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
SIGMA = "(?:uncertainty|unc|sigma|stdev|std|sd|u)"  # beside the name of a value: its standard uncertainty
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
            values. values, uncertainties: where these stand, in the order of the bands; None for what has none.
    """

    degrees: dict[str, tuple[int, float]]
    bands: Bands
    values: list[int]
    uncertainties: list[int | None]


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
    uncertain = {k: of for k, name in others.items() if (of := uncertain_of(name)) is not None}
    others = {k: name for k, name in others.items() if k not in uncertain}
    colours = {name for name in others.values() if name in MERL.names}
    bare = [name for name in others.values() if name not in MERL.names and wavelength(name) is None]
    if bare:
        wrong.append(
            f"column {', '.join(map(repr, bare[:SHOWN]))} is none of {', '.join(ANGLES)}, {WEIGHT}, a wavelength such "
            "as 550nm or 0.55um, R, G and B, or an uncertainty such as sigma_550nm"
        )
    elif colours and colours != {*MERL.names}:
        lacking = next(name for name in MERL.names if name not in colours)
        wrong.append(f"has no column {lacking}: R, G and B stand together")
    elif colours and len(colours) < len(others):
        wrong.append("has columns R, G and B beside wavelengths: leave one or the other out")
    wrong += _misplaced({names[k]: of for k, of in uncertain.items()}, [*others.values()])
    if wrong:
        raise MerlError(f"{path}: {listed(wrong)} (found: {listed(names, ', ')})")
    degrees = {name: (k, unit) for k, (name, unit) in meant.items()}
    bands = MERL if colours else spectral(path, [wavelength(name) or 0.0 for name in others.values()])
    values = [names.index(name) for name in MERL.names] if colours else [*others]
    by_value = {_value(of or names[values[0]]): k for k, of in uncertain.items()}
    return Columns(degrees, bands, values, [by_value.get(_value(names[k])) for k in values])


def uncertain_of(name: str) -> str | None:
    """Of which value a column is the uncertainty; empty where it does not say, None where it is none."""
    if re.fullmatch(SIGMA, name, re.IGNORECASE):
        return ""
    before = re.fullmatch(rf"{SIGMA}(?:[\s_]+|(?=[\[(]))[\[(]?(.+?)[\])]?", name, re.IGNORECASE)
    match = before or re.fullmatch(rf"(.+?)[\s_]+{SIGMA}", name, re.IGNORECASE)
    return match[1] if match and _value(match[1]) is not None else None


def _value(name: str) -> str | float | None:
    """What tells a column of values from others, however it is written; None of what is none."""
    return name if name in MERL.names else wavelength(name)


def _misplaced(uncertain: dict[str, str], values: list[str]) -> list[str]:
    """Uncertainties, by the name of their column, of what the file has no values of, or of one value twice."""
    known, wrong = [_value(name) for name in values], []
    for name, of in uncertain.items():
        if not of and len(values) != 1:
            wrong.append(
                f"column {name!r} does not say of which value: name it such as sigma_{values[0] if values else '550nm'}"
            )
        elif of and _value(of) not in known:
            wrong.append(f"column {name!r} is an uncertainty of {of}, and there are no values of that")
    of_each = [_value(of or values[0]) for of in uncertain.values() if of or len(values) == 1]
    twice = [of for of, count in Counter(of_each).items() if count > 1]
    return wrong + ["one value has two columns of uncertainties"] * bool(twice)


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
