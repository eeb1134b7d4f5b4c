"""ALTA's text, ``.dat`` or ``.alta``: coordinates of two directions and values, in the parametrization of the header.

The parametrizations are those of ALTA's library (Belcour et al. 2016), angles in radians; v is the viewer, l the light.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .bands import MERL
from .foreign import lines_of, numbers_of, stated_band, usable
from .scattered import ScatteredMeasurement
from .source import MerlError, contents

Vectors = tuple[np.ndarray, np.ndarray]  # of light and viewer, (N, 3) each


def _upright(theta: np.ndarray, phi: np.ndarray | float) -> np.ndarray:
    """Unit vectors (N, 3) of angles."""
    return np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)


def _projected(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Unit vectors of an angle to the normal that is laid down in the plane, towards the azimuth."""
    return _upright(np.hypot(x, y), np.arctan2(y, x))


def _half_difference(theta_h: np.ndarray, phi_h: np.ndarray | float, theta_d: np.ndarray, phi_d: np.ndarray) -> Vectors:
    """Rusinkiewicz' angles; the difference vector is the viewer's."""
    x, y, z = np.moveaxis(_upright(theta_d, phi_d), -1, 0)
    x, z = x * np.cos(theta_h) + z * np.sin(theta_h), z * np.cos(theta_h) - x * np.sin(theta_h)
    x, y = x * np.cos(phi_h) - y * np.sin(phi_h), x * np.sin(phi_h) + y * np.cos(phi_h)
    viewer, half = np.stack([x, y, z], -1), _upright(theta_h, phi_h)
    return 2 * np.sum(half * viewer, -1, keepdims=True) * half - viewer, viewer


DIRECTIONS: dict[str, tuple[int, Callable[..., Vectors]]] = {
    "ISOTROPIC_TL_TV_PROJ_DPHI": (3, lambda tl, x, y: (_upright(tl, 0.0), _projected(x, y))),
    "ISOTROPIC_TV_TL_DPHI": (3, lambda tv, tl, dphi: (_upright(tl, dphi), _upright(tv, 0.0))),
    "SPHERICAL_TL_PL_TV_PV": (4, lambda tl, pl, tv, pv: (_upright(tl, pl), _upright(tv, pv))),
    "RUSIN_TH_TD_PD": (3, lambda th, td, pd: _half_difference(th, 0.0, td, pd)),
    "RUSIN_TH_PH_TD_PD": (4, _half_difference),
    "CARTESIAN": (6, lambda *x: (np.stack(x[3:], -1), np.stack(x[:3], -1))),
}
"""By the name of a parametrization (``PARAM_IN``): how many coordinates it has, and light and viewer of these."""
OUTPUTS = ("INV_STERADIAN", "INV_STERADIAN_COSINE_FACTOR", "RGB_COLOR")  # PARAM_OUT
LARGE = 100.0  # rad: no angle that anybody measures
ROUNDED = 1e-3  # of the length of a unit vector
CONFIDENCE = {"0": 0, "1": 1, "2": 2}  # columns of a value's interval behind the values (VS)


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a file.

    Raises:
        MerlError: it cannot be read, is no such file, or is of a parametrization that is not known.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    lines = lines_of(path, data, "ALTA file")
    remarks = [line[1:].split(None, 1) for _, line in lines if line.startswith("#")]
    header = {words[0]: words[-1].strip() for words in remarks if len(words) == 2}
    coordinates, channels, extra = _sizes(path, header)
    width = coordinates + channels + extra
    rows, places = [], []
    for number, line in lines:
        if not line.startswith("#"):
            rows.append(numbers_of(path, number, line))
            places.append(number)
            if len(rows[-1]) != width:
                raise MerlError(
                    f"{path}: line {number} has {len(rows[-1])} numbers, and by the header there are {width}"
                )
    if not rows:
        raise MerlError(f"{path}: has no samples: lines of {width} numbers")
    table = np.array(rows).T
    usual = np.where(np.abs(table[:coordinates]) < LARGE, table[:coordinates], LARGE)  # the others are refused
    light, viewer = DIRECTIONS[header["PARAM_IN"]][1](*usual)
    wrong = (usual == LARGE).any(0)
    for x in (light, viewer):
        wrong |= np.abs(np.linalg.norm(x, axis=1) - 1) > ROUNDED
    if wrong.any():
        raise MerlError(
            f"{path}: line {places[int(np.argmax(wrong))]}: its coordinates are no angles (rad) or unit vectors"
        )
    theta_i, theta_o = (np.arctan2(np.hypot(x[:, 0], x[:, 1]), x[:, 2]) for x in (light, viewer))
    azimuth_i, azimuth_o = (np.arctan2(x[:, 1], x[:, 0]) for x in (light, viewer))
    values, output = table[coordinates : coordinates + channels], header.get("PARAM_OUT")
    if output == "INV_STERADIAN_COSINE_FACTOR":
        with np.errstate(divide="ignore", invalid="ignore"):  # at the horizon, where samples are left out
            values = values / np.cos(theta_o)
    bands, notes = (MERL, ()) if channels == 3 else stated_band(path, "\n".join(" ".join(words) for words in remarks))
    if output is None:
        notes = (
            *notes, "does not say what its values are: a BRDF in 1/sr is taken; if they are BRDF times cos theta_o, "
            "write a line '#PARAM_OUT INV_STERADIAN_COSINE_FACTOR' into it",
        )  # fmt: skip
    if extra:
        notes = (*notes, "the intervals of its values are not read")
    measured = ScatteredMeasurement(
        path,
        "ALTA",
        theta_i,
        theta_o,
        azimuth_o - azimuth_i,
        values,
        np.ones(len(theta_i)),
        bands,
        sha1,
        blob,
        notes=notes,
    )
    return usable(measured, lambda k: f"line {places[k]}")


def _sizes(path: Path, header: dict[str, str]) -> tuple[int, int, int]:
    """How many coordinates a line has, how many values, and how many columns of intervals behind.

    Raises:
        MerlError: the header lacks something, or states what is not read.
    """
    if missing := [f"#{name}" for name in ("DIM", "PARAM_IN") if name not in header]:
        raise MerlError(f"{path}: is no ALTA file: it has no line {' or '.join(missing)}")
    named, output = header["PARAM_IN"], header.get("PARAM_OUT", OUTPUTS[0])
    if named not in DIRECTIONS:
        raise MerlError(f"{path}: #PARAM_IN {named} is not read, only {', '.join(DIRECTIONS)}")
    if output not in OUTPUTS:
        raise MerlError(f"{path}: #PARAM_OUT {output} is not read, only {', '.join(OUTPUTS)}")
    if header.get("FORMAT", "text") != "text":
        raise MerlError(f"{path}: #FORMAT {header['FORMAT']} is not read, only text")
    coordinates, dims, intervals = DIRECTIONS[named][0], header["DIM"].split(), header.get("VS", "0").split()
    if dims not in ([str(coordinates), "1"], [str(coordinates), "3"]) or (output == "RGB_COLOR" and dims[1] != "3"):
        raise MerlError(
            f"{path}: #DIM {header['DIM']} does not fit {named} and {output}: {coordinates} coordinates, 1 value or 3"
        )
    channels = int(dims[1])
    if len(intervals) not in (1, channels) or not CONFIDENCE.keys() >= set(intervals):
        raise MerlError(f"{path}: #VS {header['VS']} is not read, only 0, 1 or 2 for each value")
    columns = [CONFIDENCE[each] for each in intervals]
    return coordinates, channels, sum(columns) if len(columns) == channels else columns[0] * channels
