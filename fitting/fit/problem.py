"""The data of HP17 Eq. 56 as a fit wants them: quadratic forms of all bins, in blocks on the device.

    E^2 = sum over bins and channels of w (measured - p(i,o) predicted)^2

w are those of `weights`. The sum over azimuths is a quadratic form of a few of them (``merl_io.azimuth``), so that
all bins count and few are evaluated. Scattered samples are rows of their own, of one azimuth.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...merl_io.azimuth import AZIMUTHS, gather
from ...merl_io.bands import MERL, Bands
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...model.acquisition import grazing_log_base
from ...model.geometry import Geometry
from ..support.choices import Precision
from ..support.threads import SHARES

T = TypeVar("T")
BLOCK = 8_000  # directions of a block: its 30-odd intermediates of 3 channels stay in a core's cache
LEAST_SHARE = 20_000  # directions that are worth a thread


class Directions(eqx.Module):
    """Directions of a grid in blocks of theta_h rows, leading axis the block.

    Attributes:
        geometry: theta_h (N, h, 1, 1), theta_d (N, 1, D, 1), cosines (N, h, D, K); of scattered directions all of them
            (N, h, D, 1).
        log_base: of the grazing loss, (N, h, D, K).
        bands: that are predicted in them; static. scattered: whether they share no theta_d; static.
    """

    geometry: Geometry
    log_base: Array
    bands: Bands = eqx.field(static=True)
    scattered: bool = eqx.field(static=True, default=False)


class Part(eqx.Module):
    """Blocks that one thread sums.

    Attributes:
        directions: the nodes. root: (N, C, h, D, K, K), target: (N, C, h, D, K): a row of bins costs
            |target - root predicted|^2, in a unit in which the measurement's energy is one.
    """

    directions: Directions
    root: Array
    target: Array


class Problem(eqx.Module):
    """Samples of one material, one shape for all files.

    Attributes:
        parts: of equal shape, to be summed side by side. rest: per channel what no smooth function of the azimuth
            explains, (C,). scatter: cost of folding. Both in the same unit, and rest is part of the cost.
    """

    parts: tuple[Part, ...]
    rest: Array
    scatter: Array


def energy(samples: Samples | ScatteredSamples) -> float:
    """The unit of cost: the measurement's weighted energy."""
    return float(np.sum(samples.weight * samples.value**2)) + samples.scatter


def make_problem(
    samples: Samples | ScatteredSamples, azimuths: int = AZIMUTHS, precision: Precision = "float64", columns: int = 1
) -> Problem:
    """Quadratic forms of samples on the device.

    Args:
        azimuths: nodes that a row of azimuths is gathered in (`merl_io.azimuth.gather`).
        precision: in which the model is evaluated at the nodes.
        columns: of scattered samples, each of about one theta_d.
    """
    unit = energy(samples)
    if isinstance(samples, ScatteredSamples):
        return _of_scattered(samples, unit, precision, columns)
    rows = gather(replace(samples, weight=samples.weight / unit), azimuths)
    where = directions(rows.theta_h, rows.theta_d, rows.cos_i, rows.cos_o, samples.bands, precision)
    blocks = len(where.log_base)

    def split(x: np.ndarray) -> np.ndarray:
        return np.moveaxis(x.reshape(len(x), blocks, -1, *x.shape[2:]), 1, 0).astype(precision)

    parts = shares(
        Part(where, jax.device_put(split(rows.root)), jax.device_put(split(rows.target))), where.log_base.size
    )
    return Problem(tuple(parts), jax.device_put(rows.rest), jax.device_put(samples.scatter / unit))


def _of_scattered(samples: ScatteredSamples, unit: float, precision: Precision, columns: int) -> Problem:
    if columns > 1:
        samples = samples.taken(np.argsort(samples.theta_d, kind="stable"))
    arranged = Arrangement.of(len(samples.theta_h), len(samples.bands), columns)
    where = _scattered_directions(samples, arranged, precision)
    root = np.sqrt(samples.weight / unit)

    def split(x: np.ndarray) -> Array:
        return jax.device_put(arranged.split(x, 0.0).swapaxes(0, 1).astype(precision))

    part = Part(where, split(root)[..., None], split(root * samples.value))
    nothing = jnp.zeros(len(samples.bands))
    return Problem(tuple(shares(part, arranged.threads_for)), nothing, jax.device_put(samples.scatter / unit))


@dataclass(frozen=True)
class Arrangement:
    """Scattered directions in blocks (N, h, D, 1), the last ones empty: sizes go in steps of a quarter of an octave.

    So a program that is compiled for one file serves others of about its size.
    """

    count: int
    blocks: int
    height: int
    columns: int

    @classmethod
    def of(cls, count: int, channels: int, columns: int = 1) -> "Arrangement":
        """For so many directions; blocks are as large as stays in a core's cache."""
        rows = _stepped(-(-count // columns))
        largest = 1 << max(4, (3 * BLOCK // (channels * columns)).bit_length() - 1)
        blocks = -(-rows // largest) if columns == 1 else 1
        return cls(count, blocks, -(-rows // blocks), columns)

    @property
    def threads_for(self) -> int:
        """Size that is worth two threads at the most: each computes the tables of scattered directions anew."""
        return min(self.blocks * self.height * self.columns, 2 * LEAST_SHARE)

    def split(self, x: np.ndarray, empty: float | None = None) -> np.ndarray:
        """(..., S) as (..., N, h, D, 1); what is empty is the last one, or ``empty``."""
        lacking = self.blocks * self.height * self.columns - self.count
        last = x[..., -1:] if empty is None else np.full_like(x[..., -1:], empty)
        padded = np.concatenate([x, np.repeat(last, lacking, -1)], -1)
        return padded.reshape(*x.shape[:-1], self.blocks, self.columns, self.height, 1).swapaxes(-3, -2)


def _stepped(count: int) -> int:
    """The next larger of the sizes that there are, four an octave."""
    step = max(1, 1 << max(0, count.bit_length() - 3))
    return -(-count // step) * step


def _scattered_directions(samples: ScatteredSamples, arranged: Arrangement, precision: Precision) -> Directions:
    angles = (samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
    geometry = Geometry(*(jax.device_put(arranged.split(x).astype(precision)) for x in angles))
    return Directions(geometry, jax.jit(grazing_log_base)(geometry), samples.bands, scattered=True)


def directions_of(samples: Samples | ScatteredSamples) -> Directions:
    """Directions of all samples, one by one."""
    if isinstance(samples, ScatteredSamples):
        arranged = Arrangement.of(len(samples.theta_h), len(samples.bands))
        return _scattered_directions(samples, arranged, "float64")
    return directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o, samples.bands)


def _threads(size: int) -> int:
    """How many threads so many directions are worth: the same on every machine, and so are the sums."""
    if jax.default_backend() != "cpu":
        return 1
    return min(SHARES, 1 << max(0, (size // LEAST_SHARE).bit_length() - 1))


def shares(blocks: T, size: int) -> list[T]:
    """Blocks of every thread, as many for each, on the device. ``size``: directions of all."""
    count = len(jax.tree.leaves(blocks)[0])
    parts = next(n for n in range(min(_threads(size), count), 0, -1) if count % n == 0)
    each = count // parts
    return [
        jax.tree.map(lambda x, k=k: jax.device_put(np.asarray(x)[k * each : (k + 1) * each]), blocks)
        for k in range(parts)
    ]


def directions(
    theta_h: np.ndarray,
    theta_d: np.ndarray,
    cos_i: np.ndarray,
    cos_o: np.ndarray,
    bands: Bands = MERL,
    precision: Precision = "float64",
) -> Directions:
    """Blocks of a product grid; cosines (H, D, K)."""
    rows, columns, azimuths = cos_i.shape
    largest, threads = max(1, BLOCK // (columns * azimuths)), _threads(cos_i.size)
    heights = [h for h in range(largest, 0, -1) if rows % h == 0]
    height = next((h for h in heights if rows // h % threads == 0), heights[0])
    blocks = rows // height

    def split(x: np.ndarray) -> Array:
        return jax.device_put(x.reshape((blocks, height, *x.shape[1:])).astype(precision))

    columns_ = np.broadcast_to(theta_d[None, None, :, None], (blocks, 1, columns, 1))
    geometry = Geometry(
        split(theta_h[:, None, None]), jax.device_put(columns_.astype(precision)), split(cos_i), split(cos_o)
    )
    return Directions(geometry, jax.jit(grazing_log_base)(geometry), bands)
