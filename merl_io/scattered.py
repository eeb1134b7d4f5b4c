"""Measurements and samples in directions of no grid: each sample has a direction of light and one of viewer.

Nothing that is fitted is resampled. The share of the fitting measure that a sample stands for cannot be known of
scattered directions; it is what the file says (a weight), or the same for every sample.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np

from .bands import MERL, Bands, ColourSpace

Format = Literal["table", "RGL", "Zemax", "FRED", "ALTA", "MBSDF", "ASTM"]
"""Of files of scattered directions (docs/formats.md)."""
Quantity = Literal["brdf", "brdf_cos", "reflectance_factor"]
"""What a file's numbers are: BRDF (1/sr), BRDF times cos theta_o (1/sr), or pi times the BRDF."""
Between = Callable[..., np.ndarray]
"""Values anywhere, of those of the samples (`adaptive.Nodes.between`)."""
SAME, DIGITS = 1e-5, 20  # rad: directions no further apart are one; binary digits of an angle in this unit
LEAF = 4  # samples that need no order among themselves


@dataclass(frozen=True)
class ScatteredMeasurement:
    """One measured material.

    Attributes:
        path: where it was read. format: of the file.
        theta_i, theta_o: of light and viewer (rad), (N,). phi: difference of their azimuths (rad), pi in the mirror's
            direction, (N,). values: BRDF (1/sr), (C, N), NaN where there is no datum.
        share: of the fitting measure, in any unit, (N,).
        bands: of the values. left_out: how many wavelengths of the file are not read. notes: what was left out of it
            besides, in words.
        solid_angle: that a sample stands for (sr), (N,); None where the format has none of its own.
        stated_tis: what a file says of the total integrated scatter: incidence (rad) and share of the light, in pairs.
        quantity: that the file holds, as the user declared it; values are BRDFs whatever it is.
        between: how a file of RGL's is drawn between its samples, in pictures alone.
        uncertainty: standard uncertainties of the values that the file states (1/sr), (C, N), NaN where it states none;
            None of a file without any.
        sha1, blob_sha1: as of `binary.Measurement`.
    """

    path: Path
    format: Format
    theta_i: np.ndarray
    theta_o: np.ndarray
    phi: np.ndarray
    values: np.ndarray
    share: np.ndarray
    bands: Bands
    sha1: str
    blob_sha1: str
    left_out: int = 0
    notes: tuple[str, ...] = ()
    solid_angle: np.ndarray | None = None
    stated_tis: tuple[tuple[float, float], ...] = ()
    quantity: Quantity = "brdf"
    between: Between | None = None
    uncertainty: np.ndarray | None = None
    dims: None = None
    genuine: None = None
    outliers: None = None

    @property
    def name(self) -> str:
        """Name of the material: that of the file without its ending."""
        return self.path.stem

    @cached_property
    def valid(self) -> np.ndarray:
        """Which values are data, (C, N)."""
        return np.isfinite(self.values)

    @property
    def fraction_uncertain(self) -> float | None:
        """The share of the data whose uncertainty the file states; None of a file that states none."""
        stated = self.uncertainty
        return None if stated is None else float(np.isfinite(stated[self.valid]).mean())

    @property
    def colour_space(self) -> ColourSpace:
        """Of the channels."""
        return "linear RGB, as stored" if self.bands.names == MERL.names else "none: a channel is a wavelength"


def cosine_shares(theta_i: np.ndarray) -> np.ndarray:
    """Integral of the cosine over what each of rising incidences (rad), (T,), stands for: half-way to those beside."""
    edges = np.concatenate([[0.0], (theta_i[1:] + theta_i[:-1]) / 2, [np.pi / 2]])
    return np.diff(np.sin(np.minimum(edges, np.pi / 2)))


def vectors_of(measurement: ScatteredMeasurement) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of light and viewer, (N, 3) each; the light's azimuth is 0."""
    m, still = measurement, np.zeros_like(measurement.phi)
    pairs = ((m.theta_i, still), (m.theta_o, m.phi))
    light, viewer = (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1) for theta, phi in pairs
    )
    return light, viewer


@dataclass(frozen=True)
class ScatteredSamples:
    """Samples with weights, in an order in which neighbours have like directions (`order`).

    Attributes:
        theta_h, theta_d: (rad), (S,). cos_i, cos_o: of light and viewer, (S,).
        value: BRDF (1/sr), (C, S), 0 where no datum is valid. weight: (C, S), 0 there. share: see above, (S,).
        bands: of the channels. scatter: of what was taken together (`together`). between: how the file draws what
            lies between the samples.
        uncertainty: standard uncertainties of the values (1/sr), (C, S); None where the file states none.
        model_error: standard deviation (1/sr) that the weights assume the model to err by where a weight is 1, beside
            these uncertainties; None without them.
        repeatability: of a value of weight 1 the variance (1/sr^2) as repeated directions show it; 0 without any.
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    bands: Bands
    scatter: float = 0.0
    between: Between | None = None
    uncertainty: np.ndarray | None = None
    model_error: float | None = None
    repeatability: float = 0.0

    @property
    def phi_d(self) -> np.ndarray:
        """Folded to [0, pi/2] (rad), (S,)."""
        return _folded(self.theta_h, self.theta_d, self.cos_i, self.cos_o)

    def taken(self, rows: np.ndarray) -> "ScatteredSamples":
        """Some of them, in another order."""
        return replace(
            self, theta_h=self.theta_h[rows], theta_d=self.theta_d[rows], cos_i=self.cos_i[rows],
            cos_o=self.cos_o[rows], value=self.value[:, rows], weight=self.weight[:, rows], share=self.share[rows],
            uncertainty=None if self.uncertainty is None else self.uncertainty[:, rows], between=None,
        )  # fmt: skip


def half_difference(
    theta_i: np.ndarray, theta_o: np.ndarray, phi: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rusinkiewicz' theta_h, theta_d and phi_d (rad), the last one folded to [0, pi/2], of pairs of directions."""
    i = np.stack([np.sin(theta_i), np.zeros_like(theta_i), np.cos(theta_i)], -1)
    o = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], -1)
    h = i + o
    theta_h = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    theta_d = np.arctan2(np.linalg.norm(i - o, axis=-1), np.linalg.norm(h, axis=-1))
    return theta_h, theta_d, _folded(theta_h, theta_d, i[..., 2], o[..., 2])


def _folded(theta_h: np.ndarray, theta_d: np.ndarray, cos_i: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
    cos_phi = np.abs(cos_o - cos_i) / np.maximum(2 * np.sin(theta_h) * np.sin(theta_d), 1e-12)
    return np.arccos(np.clip(cos_phi, 0, 1))


def scattered(
    measured: ScatteredMeasurement,
    values: np.ndarray,
    weight: np.ndarray,
    used: np.ndarray,
    uncertainty: np.ndarray | None = None,
    model_error: float | None = None,
) -> ScatteredSamples:
    """Samples in order, without those that have no weight in any channel.

    Args:
        values, weight: (C, N), anything where not used. used: which of them count, (C, N).
        uncertainty: of the values, (C, N). model_error: that the weights assume.
    """
    some = used.any(0)
    angles = [x[some] for x in (measured.theta_i, measured.theta_o, measured.phi)]
    theta_h, theta_d, phi_d = half_difference(*angles)
    found = ScatteredSamples(
        theta_h, theta_d, np.cos(angles[0]), np.cos(angles[1]), np.where(used, values, 0.0)[:, some],
        np.where(used, weight, 0.0)[:, some], measured.share[some], measured.bands,
        uncertainty=None if uncertainty is None else np.where(used, uncertainty, 0.0)[:, some], model_error=model_error,
    )  # fmt: skip
    pair = alike(*angles)
    found, (theta_h, theta_d, phi_d) = together(found, pair, np.stack([theta_h, theta_d, phi_d]))
    rows = order(np.stack([np.sqrt(theta_h), theta_d, phi_d]) / (np.pi / 2))
    whole = np.full(some.shape, len(rows))
    whole[some] = np.argsort(rows)[pair]
    between = measured.between and partial(_of_samples, measured.between, whole)
    return replace(found.taken(rows), between=between)


def _of_samples(between: Between, rows: np.ndarray, values: np.ndarray, *where: np.ndarray) -> np.ndarray:
    """`between` of values (C, S) of samples; ``rows`` says which of them each sample of the file is, S if none."""
    padded = np.concatenate([values, np.full((len(values), 1), np.nan)], 1)
    return between(padded[:, rows], *where)


def alike(theta_i: np.ndarray, theta_o: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """The number of the pair of directions that each sample has, (S,), from 0 on, rising with these angles (rad).

    Pairs that an isotropic material cannot tell apart have one number: mirror images at the plane of incidence, and all
    azimuths of light or viewer at the normal.
    """
    turned = np.abs((phi + np.pi) % (2 * np.pi) - np.pi) * np.sin(np.minimum(theta_i, theta_o))
    i, o, across = (np.round(x / SAME).astype(np.int64) for x in (theta_i, theta_o, turned))
    return np.unique((i << DIGITS | o) << DIGITS | across, return_inverse=True)[1]


def together(samples: ScatteredSamples, pair: np.ndarray, angles: np.ndarray) -> tuple[ScatteredSamples, np.ndarray]:
    """Samples of one pair of directions as one, their weighted mean.

    The sum of squares splits exactly, as in `samples.fold`; what is inside the pairs is what repeated measurements
    differ by. RGL's isotropic files hold every value twice, on either side of the plane of incidence.

    Args:
        pair: of each sample (`alike`). angles: (A, S), given back of those kept.
    """
    first = np.unique(pair, return_index=True)[1]

    def summed(x: np.ndarray) -> np.ndarray:
        return np.bincount(pair, x, len(first))

    weight = np.stack([summed(w) for w in samples.weight])
    light = np.stack([summed(w * v) for w, v in zip(samples.weight, samples.value, strict=True)])
    value = light / np.where(weight > 0, weight, 1.0)
    scatter = float(np.sum(samples.weight * (samples.value - value[:, pair]) ** 2))
    repeats = np.count_nonzero(samples.weight) - np.count_nonzero(weight)
    kept = replace(
        samples.taken(first), value=value, weight=weight, share=summed(samples.share), scatter=scatter,
        repeatability=scatter / repeats if repeats else 0.0,
    )  # fmt: skip
    if samples.uncertainty is not None:  # of weighted means
        squares = np.stack([summed(x) for x in (samples.weight * samples.uncertainty) ** 2])
        kept = replace(kept, uncertainty=np.sqrt(squares) / np.where(weight > 0, weight, 1.0))
    return kept, angles[:, first]


def order(points: np.ndarray) -> np.ndarray:
    """A permutation of points (3, N) in which any dyadic run is a box: halves by the widest extent, again and again."""
    found, waiting = [], [np.arange(points.shape[1])]
    while waiting:
        rows = waiting.pop()
        if len(rows) <= LEAF:
            found.append(rows)
            continue
        inside = points[:, rows]
        widest = int(np.argmax(np.ptp(inside, axis=1)))
        ranked = rows[np.argsort(inside[widest], kind="stable")]
        waiting += [ranked[len(rows) // 2 :], ranked[: len(rows) // 2]]
    return np.concatenate(found) if found else np.arange(0)


def thin(samples: ScatteredSamples, count: int) -> ScatteredSamples:
    """So many samples at the most, each standing for as many neighbours (`keep_middles`)."""
    size = len(samples.theta_h)
    if size <= count:
        return samples
    return keep_middles(samples, np.round(np.linspace(0, size, count + 1)).astype(int))


def keep_middles(samples: ScatteredSamples, edges: np.ndarray) -> ScatteredSamples:
    """Of every run of neighbours one, which stands for the share of all; values are not averaged.

    It is the one nearest the middle of those with the mean share or more. The middle one itself may have a millionth of
    its neighbours' share, and a peak's value: beside the mirror direction of chm_mint one of 1536 had 95 % of the
    energy then, 35 times that of the file.

    Args:
        edges: where runs begin, from 0 on, and the number of samples; rising.
    """
    counts, whole = np.diff(edges), np.add.reduceat(samples.share, edges[:-1])
    run = np.repeat(np.arange(len(counts)), counts)
    small = samples.share < (1 - 1e-9) * (whole / counts)[run]
    away = np.abs(np.arange(len(run)) - (edges[:-1] + counts // 2)[run])
    kept = samples.taken(np.lexsort((away, small, run))[edges[:-1]])
    factor = np.where(kept.share > 0, whole / np.where(kept.share > 0, kept.share, 1.0), 0.0)
    return replace(kept, weight=kept.weight * factor, share=whole, uncertainty=None, repeatability=0.0)
