"""Colour: differences as people see them, and pictures for screens. RGB is linear sRGB, 1 is white."""

import numpy as np

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
LUMINANCE = XYZ[1]


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
    """CIELAB distance of pixels as a screen shows them, (...), from (..., 3): what is brighter than white is white."""
    return np.linalg.norm(cielab(np.clip(one, 0, 1)) - cielab(np.clip(other, 0, 1)), axis=-1)


def displayed(radiance: np.ndarray) -> np.ndarray:
    """8-bit sRGB (IEC 61966-2-1) of linear values, brighter than white cut off."""
    x = np.clip(np.nan_to_num(radiance), 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)
