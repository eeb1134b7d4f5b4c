"""RGL's ``.bsdf`` files: isotropic materials measured by Dupuy & Jakob 2018 (doi:10.1145/3272127.3275059).

Every node of the file that lies above the horizon and was measured is a sample with its own direction and value
(`adaptive`); nothing is interpolated. Negative values, which the conversion to RGB makes of saturated colours, are
data. Where the luminance is 0 nothing was measured: RGL's own viewer marks it so; `valid` is inverted in some files.
"""

from pathlib import Path

import numpy as np

from .adaptive import Nodes, slices
from .bands import MERL, Bands, filled
from .binary import BRIGHTEST
from .columns import spectral
from .scattered import ScatteredMeasurement
from .source import MerlError, contents
from .tensor import Tensors, tensors

MOST = 31  # wavelengths that are read: RGL's files have 195, and each brings parameters of its own into the fit
PARTS = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "luminance": 4}  # float32, so many dimensions
ISOTROPIC = 2  # azimuths of light at the most
OURS = "tabulated by merlfit "  # in the description of a file that we have computed
NODES = 1024  # of an axis, at the most: RGL's files have 128; memory goes with two of them multiplied


def read(path: str | Path, fitted_sha1: str | None = None, most: int = MOST) -> ScatteredMeasurement:
    """Read a file: the samples of its nodes above the horizon that were measured.

    Args:
        most: wavelengths that are read, evenly over those of the file, the first and the last among them.

    Memory: three times the file in RGL's layout, and a few MiB.

    Raises:
        merlfit.merl_io.binary.MerlError: it cannot be read, is no such file, or is anisotropic.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    file = tensors(path, data)
    parts = _parts(file)
    spectra, chosen, bands = _spectra(file, parts["luminance"].shape, most)
    incidences, at = tuple(slices(parts)), 0
    values = np.empty((len(bands), sum(len(part.phi) for part in incidences)))
    for part in incidences:
        rows = slice(at, at := at + len(part.phi))
        for plane, k in zip(values, chosen, strict=True):
            with np.errstate(over="ignore", invalid="ignore"):  # no data, below
                value = part.values(spectra[part.azimuth, part.incidence, k])
                plane[rows] = np.where(np.abs(value) < BRIGHTEST, value, np.nan)
    if not any(np.isfinite(plane).any() for plane in values):
        raise MerlError(f"{path}: holds no datum: every value is not finite, or below the horizon")
    theta_i, theta_o, phi, share, solid = (
        np.concatenate([getattr(part, name) for part in incidences])
        for name in ("theta_i", "theta_o", "phi", "share", "solid_angle")
    )
    left_out = spectra.shape[2] - len(bands)
    kept, bands, notes = filled(values, bands)
    values = values[kept] if notes else values
    return ScatteredMeasurement(
        path, "RGL", theta_i, theta_o, phi, values, share, bands, sha1, blob, left_out,
        (*notes, *_computed(file)), solid, between=Nodes(parts, incidences).between,
    )  # fmt: skip


def _computed(file: Tensors) -> list[str]:
    """That a file is not measured, where its description says so, as those that we write do."""
    if "description" not in file.fields:
        return []
    words = file.array("description", "uint8", 1).tobytes().decode(errors="replace")
    return [f"not measured: its description says {words!r}"] if OURS in words else []


def _parts(file: Tensors) -> dict[str, np.ndarray]:
    """All fields but the spectra.

    Raises:
        MerlError: one is missing, of another type or shape, or holds what it cannot.
    """
    parts = {name: file.array(name, "float32", dimensions) for name, dimensions in PARTS.items()}
    parts["jacobian"] = file.array("jacobian", "uint8", 1)
    azimuths, incidences = len(parts["phi_i"]), len(parts["theta_i"])
    if azimuths > ISOTROPIC:
        raise MerlError(
            f"{file.path}: is anisotropic: it has {azimuths} azimuths of light (phi_i); isotropic files have one or two"
        )
    for name in ("vndf", "luminance"):
        shape = parts[name].shape
        if shape[:2] != (azimuths, incidences) or (name == "luminance" and shape[2] != shape[3]):
            raise MerlError(
                f"{file.path}: field {name} has shape {shape}, which does not fit {azimuths} phi_i, {incidences} "
                "theta_i and a square of nodes"
            )
    for name, x in parts.items():
        if max(x.shape) > NODES:
            raise MerlError(f"{file.path}: field {name} has shape {x.shape}, more than {NODES} along an axis")
        if name not in ("theta_i", "phi_i", "jacobian") and min(x.shape[-2:]) < 2:
            raise MerlError(f"{file.path}: field {name} has shape {x.shape}, without two nodes along each side")
        if name not in ("phi_i", "luminance") and not (np.isfinite(x).all() and (x >= 0).all()):
            raise MerlError(f"{file.path}: field {name} holds a number that is negative or not finite")
    if not parts["vndf"].any((2, 3)).all():
        raise MerlError(f"{file.path}: field vndf holds no normal that light sees, at some incidence")
    if (np.diff(parts["theta_i"]) <= 0).any() or not np.isfinite(parts["phi_i"]).all():
        raise MerlError(f"{file.path}: the angles theta_i do not rise, or those of phi_i are not finite")
    return parts


def _spectra(file: Tensors, luminance: tuple[int, ...], most: int) -> tuple[np.ndarray, np.ndarray, Bands]:
    """Values at the nodes (P, T, C, n, n), which of the C are read, and their bands."""
    name = "spectra" if "wavelengths" in file.fields else "rgb"
    if name not in file.fields:
        raise MerlError(f"{file.path}: has neither spectra and wavelengths nor rgb")
    spectra = file.array(name, "float32", 5)
    if name == "rgb":
        count, chosen, bands = 3, np.arange(3), MERL
    else:
        nm = file.array("wavelengths", "float32", 1)
        count = len(nm)
        chosen = np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
        bands = spectral(file.path, [round(1e-3 * float(x), 7) for x in nm[chosen]])
    expected = (*luminance[:2], count, *luminance[2:])
    if spectra.shape != expected:
        raise MerlError(f"{file.path}: field {name} has shape {spectra.shape}, not {expected}")
    return spectra, chosen, bands
