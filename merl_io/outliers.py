"""What of scattered samples is no measurement of the material: single ones far too bright, and empty channels."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .bands import filled
from .scattered import ScatteredMeasurement, half_difference, order

HOT = 5.0  # times as large as every neighbour, cosines divided out, and as the median of all: an outlier
NEIGHBOURS = 12  # in sqrt(theta_h), theta_d and phi_d
INSIDE = 2  # of these are no further from the mirror's direction, as none are of a highlight's own brightest sample
MISALIGNED = np.radians(3.0)  # half of how far a goniometer's highlight, or its way back, may lie from where it should
BESIDE = 8  # samples in order that are looked at first
SHOWN = 3


def examined(measured: ScatteredMeasurement, place: Callable[[int], str]) -> ScatteredMeasurement:
    """The same without outliers and empty channels, which are told.

    Args:
        place: where a sample stands in the file, in words.
    """
    outlying = hot(measured)
    values, notes = measured.values, list(measured.notes)
    if outlying.any():
        values = np.where(outlying, np.nan, values)
        notes.append(_remark(measured, outlying, place))
    kept, bands, emptied = filled(values, measured.bands)
    uncertainty = measured.uncertainty
    if emptied:
        values, uncertainty = values[kept], None if uncertainty is None else uncertainty[kept]
    return replace(measured, values=values, uncertainty=uncertainty, bands=bands, notes=(*notes, *emptied))


def hot(measured: ScatteredMeasurement) -> np.ndarray:
    """Which values (C, N) are far larger than all of their neighbours, none of which is a highlight's.

    A sample that no other is as near to the mirror's direction as, or to the light's, or that is nearer to these than
    `MISALIGNED`, may be a highlight. Where most values are zero, as counts of photons are, one is as good as zero.
    """
    angles = np.stack(half_difference(measured.theta_i, measured.theta_o, measured.phi))
    cosines = np.cos(measured.theta_i) * np.cos(measured.theta_o)
    outlying = np.zeros(measured.values.shape, bool)
    ranked = order(np.stack([np.sqrt(angles[0]), angles[1], angles[2]]))
    for plane, hot_ones in zip(measured.values, outlying, strict=True):
        there = np.isfinite(plane)
        own = (np.cumsum(there) - 1)[ranked[there[ranked]]]  # the same order, of those that are there
        hot_ones[there] = _hot(np.abs(plane[there] * cosines[there]), own, *angles[:, there])
    return outlying


def _hot(
    size: np.ndarray, ranked: np.ndarray, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> np.ndarray:
    outlying, least = np.zeros(size.shape, bool), float(np.median(size)) if size.size else 0.0
    if size.size <= NEIGHBOURS or least == 0:
        return outlying
    at = np.stack([np.sqrt(theta_h), theta_d, phi_d]) / (np.pi / 2)
    away_from_both = (theta_h > MISALIGNED) & (theta_d > MISALIGNED)
    for k in np.flatnonzero(away_from_both & _suspects(size, ranked)):
        away = np.sum((at - at[:, [k]]) ** 2, 0)
        away[k] = np.inf
        near = np.argpartition(away, NEIGHBOURS)[:NEIGHBOURS]
        inside = [np.sum(x[near] <= x[k] + 1e-6) >= INSIDE for x in (theta_h, theta_d)]
        outlying[k] = all(inside) and size[k] > HOT * max(size[near].max(), least)
    return outlying


def _suspects(size: np.ndarray, ranked: np.ndarray) -> np.ndarray:
    """What is far brighter than all that stand beside it in an order of neighbours, (N,)."""
    half, count = BESIDE // 2, len(size)
    padded = np.pad(size[ranked], half)
    beside = np.max([padded[half + k : half + k + count] for k in range(-half, half + 1) if k], axis=0)
    bright = np.empty(count, bool)
    bright[ranked] = size[ranked] > HOT * beside
    return bright


def _remark(measured: ScatteredMeasurement, outlying: np.ndarray, place: Callable[[int], str]) -> str:
    samples = np.flatnonzero(outlying.any(0))
    places = []
    for k in samples[:SHOWN]:
        channel = int(np.flatnonzero(outlying[:, k])[0])
        places.append(f"{place(int(k))} ({measured.bands.names[channel]} {measured.values[channel, k]:g})")
    more = f" and {len(samples) - SHOWN} more" if len(samples) > SHOWN else ""
    one = len(samples) == 1
    return (
        f"{', '.join(places)}{more}: {'an outlier' if one else 'outliers'}, over {HOT:g} times as large as all "
        f"samples beside {'it' if one else 'them'}, and left out"
    )
