"""NVIDIA's ``.mbsdf``: isotropic measurements of the MDL SDK, reflection on a regular grid of angles.

A line ``NVIDIA ARC MBSDF V1``, lines ``NAME="value"``, a line that says which part follows (``MBSDF_DATA=`` or
``MBSDF_DATA_REFLECTION=``), then, little-endian: 0 for one channel or 1 for RGB, how many theta and how many phi
(uint32 each), and BRDFs (float32) by theta_i, theta_o, phi and channel. Angles lie in the middle of equal cells of
[0, pi/2] and [0, pi]; phi is pi on the mirror's side.
"""

from pathlib import Path

import numpy as np

from .bands import MERL
from .foreign import stated_band, usable
from .scattered import ScatteredMeasurement
from .source import MerlError, contents

MAGIC = b"NVIDIA ARC MBSDF V1\n"
REFLECTION = b"\nMBSDF_DATA=\n", b"\nMBSDF_DATA_REFLECTION=\n"
TRANSMISSION = b"\nMBSDF_DATA_TRANSMISSION=\n"
HEAD = 12  # bytes before the values


def read(path: str | Path, fitted_sha1: str | None = None) -> ScatteredMeasurement:
    """Read a file: the middles of its cells, each with a share of solid angle.

    Raises:
        MerlError: it cannot be read, is no such file, is cut off, or holds transmission alone.
    """
    path = Path(path)
    data, sha1, blob = contents(path, fitted_sha1)
    if not data.startswith(MAGIC):
        raise MerlError(f"{path}: is no MBSDF file: its first line is not {MAGIC.decode().strip()!r}")
    starts = [at + len(mark) for mark in REFLECTION if (at := data.find(mark)) >= 0]
    if not starts:
        alone = "holds transmission alone; only reflection is read" if TRANSMISSION in data else "has no MBSDF_DATA"
        raise MerlError(f"{path}: {alone}")
    remarks, at = data[: min(starts)].decode("utf-8", "replace"), min(starts)
    if len(data) < at + HEAD:
        raise MerlError(f"{path}: is cut off in its header; download or copy it again")
    kind, thetas, phis = (int(x) for x in np.frombuffer(data, "<u4", 3, at))
    if kind > 1 or not thetas or not phis:
        raise MerlError(f"{path}: has values of type {kind} (0 or 1), {thetas} theta and {phis} phi")
    channels = 3 if kind else 1
    count = thetas * thetas * phis
    end = at + HEAD + 4 * channels * count
    if len(data) < end:
        raise MerlError(f"{path}: is cut off: it has {len(data)} bytes, not {end}; download or copy it again")
    stored = np.frombuffer(data, "<f4", channels * count, at + HEAD).reshape(thetas, thetas, phis, channels)
    theta, turns = np.linspace(0, np.pi / 2, thetas + 1), np.linspace(0, np.pi, phis + 1)
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in (theta, theta, turns)]
    distinct = _distinct(stored), _distinct(stored.swapaxes(0, 1))
    measured = np.ix_(np.arange(thetas) < distinct[0], np.arange(thetas) < distinct[1], np.ones(phis, bool))
    theta_i, theta_o, phi = (x[measured].ravel() for x in np.meshgrid(*middles, indexing="ij"))
    solid = np.broadcast_to(-np.diff(np.cos(theta))[:, None] * np.full(phis, 2 * np.pi / phis), stored.shape[:3])
    share = np.diff(np.sin(theta))[:, None, None] * solid
    bands, notes = (MERL, ()) if kind else stated_band(path, remarks)
    for name, number in zip(("theta_i", "theta_o"), distinct, strict=True):
        if number < thetas:
            degrees = np.degrees(theta[number])
            notes = (*notes, f"from {name} {degrees:g} degrees on it repeats what is before, and is left out there")
    if data.startswith(TRANSMISSION[1:], end):
        notes = (*notes, "its transmission is not read")
    with np.errstate(invalid="ignore"):  # some NaNs are signals
        values = stored[measured].reshape(-1, channels).T.astype(float)
    return usable(
        ScatteredMeasurement(
            path,
            "MBSDF",
            theta_i,
            theta_o,
            phi,
            values,
            share[measured].ravel(),
            bands,
            sha1,
            blob,
            notes=notes,
            solid_angle=solid[measured].ravel(),
        )
    )


def _distinct(stored: np.ndarray) -> int:
    """How many slices along the first axis there are before the last ones that are all copies of one that varies."""
    copies = (stored[1:] == stored[:-1]).reshape(len(stored) - 1, -1).all(1)
    if np.ptp(stored[-1]) == 0:  # a matte material: all slices may be alike
        return len(stored)
    return len(stored) - int(np.logical_and.accumulate(copies[::-1]).sum())
