"""Colour: of wavelengths, differences as people see them, and pictures for screens. RGB is linear sRGB, 1 is white."""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from ..merl_io.bands import MERL, XYZ, Bands

LUMINANCE = XYZ[1]
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
VISIBLE_NM = np.arange(360.0, 831.0)
OBSERVER = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
"""CIE 1931 standard observer (2 degrees) as sums of Gaussians: height, peak, width below and above it (nm), to about
1 % of the peak (Wyman, Sloan & Shirley 2013, JCGT 2(2), Eq. 4)."""
REFLECTANCE_NM = np.arange(380.0, 781.0, 20.0)
DAYLIGHT = (
    49.9755, 82.7549, 93.4318, 104.865, 117.812, 115.923, 109.354, 104.790, 104.405, 100.000, 95.7880, 90.0062, 87.6987,
    83.6992, 80.2146, 78.2842, 71.6091, 61.6040, 75.0870, 46.4182, 63.3828,
)  # fmt: skip
"""CIE standard illuminant D65 at these wavelengths (ISO/CIE 11664-2), 100 at 560 nm."""
HELD = 1e3  # weight of what reflectances have to be, against their steepness


def observer(wavelength_nm: np.ndarray) -> np.ndarray:
    """x, y and z of the CIE 1931 observer, (3, N)."""

    def lobe(height: float, peak: float, below: float, above: float) -> np.ndarray:
        width = np.where(wavelength_nm < peak, below, above)
        return height * np.exp(-(((wavelength_nm - peak) / width) ** 2) / 2)

    return np.stack([sum((lobe(*one) for one in lobes), np.zeros(1)) for lobes in OBSERVER])


@cache
def weights_of(bands: Bands) -> np.ndarray:
    """What each band adds to R, G and B, (3, C).

    Bands that are named R, G and B stay what they are. Of others the reflectance is linear between the wavelengths and
    constant beyond them; it is seen by the CIE 1931 observer under light of equal energy (illuminant E), whose white
    becomes sRGB's (D65) by Bradford's transform: each row sums to one, so that white is white.
    """
    if set(bands.names) == set(MERL.names):
        return np.array([[float(name == own) for name in bands.names] for own in MERL.names])
    order = np.argsort(bands.wavelengths_um)
    known, each = 1e3 * np.array(bands.wavelengths_um)[order], np.eye(len(bands))[order]
    spectra = np.array([np.interp(VISIBLE_NM, known, each[:, k]) for k in range(len(bands))])
    seen = observer(VISIBLE_NM)
    white = BRADFORD @ XYZ.sum(1) / BRADFORD.sum(1)
    adapted = np.linalg.solve(BRADFORD, white[:, None] * BRADFORD)
    return np.linalg.solve(XYZ, adapted @ (seen @ spectra.T / seen.sum(1, keepdims=True)))


@cache
def reflectances() -> np.ndarray:
    """Spectra at `REFLECTANCE_NM`, linear between, that red, green and blue are of, (3, 21), as renderers need them.

    They lie between 0 and 1, their sum is 1, and under D65 each has its colour of linear sRGB, as `observer` sees it:
    so R, G and B times them have that colour, too. Of all such spectra the least steep (the idea is Mallett & Yuksel
    2019, doi:10.2312/sr.20191216). Three channels do not tell a spectrum: under other light the colour is a guess.
    """
    count = len(REFLECTANCE_NM)
    hats = np.stack([np.interp(VISIBLE_NM, REFLECTANCE_NM, each) for each in np.eye(count)])
    seen = (observer(VISIBLE_NM) * np.interp(VISIBLE_NM, REFLECTANCE_NM, DAYLIGHT)) @ hats.T
    to_rgb = np.linalg.solve(XYZ, seen * (XYZ.sum(1) / seen.sum(1))[:, None])
    each = np.eye(3)
    rows = [np.kron(each, np.diff(np.eye(count), axis=0)), HELD * np.kron(each, to_rgb),
            HELD * np.kron(np.ones(3), np.eye(count))]  # fmt: skip
    wanted = np.concatenate([np.zeros(3 * (count - 1)), HELD * each.ravel(), HELD * np.ones(count)])
    return lsq_linear(np.concatenate(rows), wanted, (0.0, 1.0)).x.reshape(3, count)


def coloured(values: Any, bands: Bands) -> Any:  # noqa: ANN401 - an array of NumPy or JAX
    """R, G and B, (3, ...), of values by band, (C, ...); what is outside of sRGB's gamut is cut off at 0."""
    if bands.names == MERL.names:
        return values
    arrays = values.__array_namespace__()
    found = arrays.tensordot(arrays.asarray(weights_of(bands), dtype=values.dtype), values, axes=1)
    return arrays.maximum(found, 0)


def cielab(radiance: np.ndarray) -> np.ndarray:
    """CIELAB (L*, a*, b*) of linear sRGB, (..., 3), relative to white (1, 1, 1); brighter than white is not cut off.

    A distance of about 1 is just noticeable (CIE 1976, D65).
    """
    xyz = np.maximum(radiance, 0.0) @ XYZ.T / XYZ.sum(1)
    delta = 6 / 29
    f = np.where(xyz > delta**3, np.cbrt(xyz), xyz / (3 * delta**2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """CIELAB distance of pixels, (...), from (..., 3), with highlights as they are, brighter than white."""
    return np.linalg.norm(cielab(one) - cielab(other), axis=-1)


def displayed(radiance: np.ndarray) -> np.ndarray:
    """8-bit sRGB (IEC 61966-2-1) of linear values, brighter than white cut off."""
    x = np.clip(np.nan_to_num(radiance), 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)
