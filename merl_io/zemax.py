"""Zemax' (OpticStudio's) ``.bsdf`` text: scatter over azimuth and radial angle about the specular direction.

The header says which angles of incidence, azimuths and radial angles there are (degrees). For each incidence follow the
total integrated scatter (``TIS``) and a row of values for each azimuth. Azimuth 0 leads from the specular direction
over the normal to the light. Files of symmetric scatter end at azimuth 180.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .atomic import write_text
from .bands import MERL, XYZ
from .binary import BRIGHTEST
from .foreign import lines_of, numbers_of, stated_band, usable
from .scattered import ScatteredMeasurement, cosine_shares
from .source import PLAIN, MerlError, contents

WORDS = {
    "Source": None, "Symmetry": ("PlaneSymmetrical", "Asymmetrical"), "SpectralContent": ("Monochrome", "XYZ"),
    "ScatterType": ("BRDF",),
}  # fmt: skip
COUNTED = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
SPECTRA = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
MENDS = {
    "BTDF": "light that passes through; only BRDF is read",
    "ASymmetrical4D": "an anisotropic material; only isotropic ones are read",
}


@dataclass
class Scatter:
    """What a file says.

    Attributes:
        words: by keyword. angles: by keyword (degrees). blocks: numbers of every incidence, by spectrum. tis: stated,
            likewise. remarks: all lines behind ``#``.
    """

    words: dict[str, str] = field(default_factory=dict)
    angles: dict[str, np.ndarray] = field(default_factory=dict)
    blocks: dict[str, list[np.ndarray]] = field(default_factory=dict)
    tis: dict[str, list[float]] = field(default_factory=dict)
    remarks: str = ""


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a file: its samples above the horizon, each with a share of solid angle.

    Raises:
        MerlError: it cannot be read, is no such file, or holds what is no isotropic reflection.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    scatter = _scatter(path, lines_of(path, data, "Zemax .bsdf file"))
    names = SPECTRA[scatter.words["SpectralContent"]]
    theta_i, azimuth, radial = (np.radians(scatter.angles[name]) for name in COUNTED[1:])
    values = np.array([scatter.blocks[name] for name in names])
    if len(names) == 1:
        bands, notes = stated_band(path, scatter.remarks)
    else:
        values = np.where(np.abs(values) < BRIGHTEST, values, np.nan)
        values, bands = np.tensordot(np.linalg.inv(XYZ), values, 1), MERL
        notes = ("its X, Y and Z are read as linear sRGB, as if D65 were white",)
    padded = np.logical_and.accumulate((values == 0).all(0)[..., ::-1], axis=-1)[..., ::-1]
    solid = _solid_angles(azimuth, radial, scatter.words["Symmetry"] == "PlaneSymmetrical")
    if radial[0] == 0:  # there all azimuths are one direction
        values[..., 0] = values[..., 0].mean(-1, keepdims=True)
        solid[0, 0] = solid[:, 0].sum()
        padded[:, 1:, 0] = True
    theta_o, phi = _directions(theta_i, azimuth, radial)
    solid = np.broadcast_to(solid, padded.shape)
    share = cosine_shares(theta_i)[:, None, None] * solid
    left_out = np.sum(padded[..., 1:] & (theta_o[..., 1:] < np.pi / 2))
    if left_out:
        notes = (
            *notes,
            f"{left_out} samples at the largest radial angles are 0, as what was not measured is: left out",
        )
    tis = tuple(zip(theta_i.tolist(), scatter.tis[names[len(names) // 2]], strict=True))
    measured = ScatteredMeasurement(
        path, "Zemax", np.broadcast_to(theta_i[:, None, None], padded.shape)[~padded], theta_o[~padded],
        phi[~padded], values[:, ~padded], share[~padded], bands, sha1, blob, notes=notes,
        solid_angle=solid[~padded], stated_tis=tis,
    )  # fmt: skip
    return usable(measured)


def write(
    path: Path, axes: tuple[np.ndarray, np.ndarray, np.ndarray], values: np.ndarray, tis: np.ndarray,
    remarks: Sequence[str],
) -> None:  # fmt: skip
    """Write a file of one wavelength that is symmetric to the plane of incidence.

    Args:
        axes: incidences (T,), azimuths from 0 to 180 (A,), radial angles (R,), in degrees. values: BRDF (1/sr), 0 below
            the horizon, (T, A, R). tis: total integrated scatter, (T,). remarks: lines for people.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    lines = [f"# {line.translate(PLAIN)}" for line in remarks]
    lines += ["Source\tMeasured", "Symmetry\tPlaneSymmetrical", "SpectralContent\tMonochrome", "ScatterType\tBRDF"]
    lines += ["SampleRotation\t1", "0"]
    for name, x in zip(COUNTED[1:], axes, strict=True):
        lines += [f"{name}\t{len(x)}", "\t".join(f"{angle:.8g}" for angle in x)]
    lines += ["", "Monochrome", "DataBegin"]
    for share, block in zip(tis, values, strict=True):
        lines += [f"TIS\t{share:.6g}", *("\t".join(f"{x:.5e}" for x in row) for row in block)]
    write_text(path, "\n".join([*lines, "DataEnd"]) + "\n")


def vectors(theta_i: np.ndarray, azimuth: np.ndarray, radial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of light, (T, 1, 1, 3), and of all scattered directions, (T, A, R, 3); the light's azimuth is 0."""
    t, a, r = theta_i[:, None, None], azimuth[:, None], radial
    across = np.cos(r) * -np.sin(t) + np.sin(r) * np.cos(a) * np.cos(t)
    beside = np.sin(r) * np.sin(a) + 0 * t
    up = np.cos(r) * np.cos(t) + np.sin(r) * np.cos(a) * np.sin(t)
    return np.stack([np.sin(t), 0 * t, np.cos(t)], -1), np.stack([across, beside, up], -1)


def _directions(theta_i: np.ndarray, azimuth: np.ndarray, radial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle to the normal and azimuth relative to the light of all scattered directions (T, A, R)."""
    across, beside, up = np.moveaxis(vectors(theta_i, azimuth, radial)[1], -1, 0)
    return np.arctan2(np.hypot(across, beside), up), np.arctan2(beside, across)


def _solid_angles(azimuth: np.ndarray, radial: np.ndarray, symmetric: bool) -> np.ndarray:
    """What every direction stands for (A, R): half-way to those beside it, and its mirror image."""
    ends = azimuth[[0, -1]]
    if symmetric:
        ends = np.array([0.0, np.pi])
    elif (gap := 2 * np.pi - (ends[1] - ends[0])) > 0:
        ends = ends + np.array([-gap, gap]) / 2
    wide = np.diff(np.concatenate([ends[:1], (azimuth[1:] + azimuth[:-1]) / 2, ends[1:]])) * (2 if symmetric else 1)
    edges = np.concatenate([radial[:1], (radial[1:] + radial[:-1]) / 2, radial[-1:]])
    return wide[:, None] * -np.diff(np.cos(edges))


def _scatter(path: Path, lines: list[tuple[int, str]]) -> Scatter:
    """The file's parts.

    Raises:
        MerlError: a line is none that such a file has, or is missing.
    """
    scatter = Scatter(remarks="\n".join(line for _, line in lines if line.startswith("#")))
    waiting = [pair for pair in reversed(lines) if not pair[1].startswith("#")]
    while waiting:
        number, line = waiting.pop()
        name, *rest = line.split()
        if name in WORDS and rest:
            scatter.words[name] = rest[0]
            if (known := WORDS[name]) and rest[0] not in known:
                mend = MENDS.get(rest[0], f"known: {', '.join(known)}")
                raise MerlError(f"{path}: line {number}: {name} is {rest[0]!r}: {mend}")
        elif name in COUNTED and len(rest) == 1 and rest[0].isdecimal():
            scatter.angles[name] = _numbers(path, waiting, int(rest[0]), f"line {number}: {name}")
        elif name in sum(SPECTRA.values(), ()) and not rest:
            _block(path, name, waiting, scatter)
        else:
            raise MerlError(
                f"{path}: line {number}: {line[:40]!r} begins no part of a Zemax .bsdf file, such as "
                f"{', '.join((*WORDS, *COUNTED))}, Monochrome"
            )
    _check(path, scatter)
    return scatter


def _block(path: Path, name: str, waiting: list[tuple[int, str]], scatter: Scatter) -> None:
    """Values of all incidences in one spectrum, from DataBegin to DataEnd."""
    if missing := [each for each in (*WORDS, *COUNTED) if each not in {"Source", *scatter.words, *scatter.angles}]:
        raise MerlError(f"{path}: has no {missing[0]} before its data")
    _angles(path, scatter.angles)
    shape = [len(scatter.angles[each]) for each in COUNTED[2:]]
    scatter.blocks[name], scatter.tis[name] = [], []
    if not waiting or waiting.pop()[1] != "DataBegin":
        raise MerlError(f"{path}: has no DataBegin after {name}")
    while waiting and waiting[-1][1] != "DataEnd":
        number, line = waiting.pop()
        first, *rest = line.split()
        if first != "TIS" or len(rest) != 1:
            raise MerlError(
                f"{path}: line {number}: {line[:40]!r} stands where TIS or DataEnd should: an incidence has "
                f"{shape[0]} rows (ScatterAzimuth) of {shape[1]} numbers (ScatterRadial)"
            )
        scatter.tis[name] += numbers_of(path, number, rest[0])
        block = _numbers(path, waiting, shape[0] * shape[1], f"line {number}: TIS")
        scatter.blocks[name].append(block.reshape(shape))
    if not waiting:
        raise MerlError(f"{path}: is cut off: it has no DataEnd after {name}; download or copy it again")
    waiting.pop()


def _numbers(path: Path, waiting: list[tuple[int, str]], count: int, of: str) -> np.ndarray:
    """So many of the next lines."""
    numbers: list[float] = []
    while waiting and len(numbers) < count:
        numbers += numbers_of(path, *waiting.pop())
    if len(numbers) != count:
        raise MerlError(f"{path}: {of} is followed by {len(numbers)} numbers, not {count}")
    return np.array(numbers)


def _angles(path: Path, angles: dict[str, np.ndarray]) -> None:
    """Refuse angles that do not rise, or lie where they cannot."""
    if len(angles["SampleRotation"]) > 1:
        raise MerlError(f"{path}: is anisotropic: it has {len(angles['SampleRotation'])} angles of SampleRotation")
    for name, most in zip(COUNTED[1:], (90, 360, 180), strict=True):
        x = angles[name]
        if not (len(x) and (np.diff(x) > 0).all() and x[0] >= 0 and x[-1] <= most):
            raise MerlError(f"{path}: the angles of {name} do not rise from 0 or more to {most} at the most")


def _check(path: Path, scatter: Scatter) -> None:
    """Refuse a file that lacks a spectrum or an incidence."""
    for name in SPECTRA.get(scatter.words.get("SpectralContent", ""), ("Monochrome",)):
        if name not in scatter.blocks:
            raise MerlError(f"{path}: has no {name} with DataBegin and DataEnd")
        count, incidences = len(scatter.blocks[name]), len(scatter.angles["AngleOfIncidence"])
        if count != incidences:
            raise MerlError(f"{path}: {name} has {count} blocks, and there are {incidences} angles of incidence")
