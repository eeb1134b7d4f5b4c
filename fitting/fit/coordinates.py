"""Between physical values and the free coordinates in which their prior is standard normal: the arithmetic.

By NumPy, for one point or many; where JAX traces it, by JAX (:func:`.numerics.namespace_of`). All numbers are data
of what is traced (:class:`Table`): other bounds, priors and fixed values are not compiled anew.
"""

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any, NamedTuple

import jax.scipy.special
import numpy as np
import scipy.special

from ...model.numerics import namespace_of
from ...model.parameters import Shift

INSIDE = 1e-6  # of a standard deviation, or of the way between bounds: so far inside them values are moved
LEAST = 1e-300
TINY_ODDS = 1e-6  # least albedo that a start may have
ENDLESS = 1e4  # stands for the logarithm of odds at a bound of 0 or 1
Numbers = Any  # arrays of NumPy, or of JAX where it traces them: pyright knows no operation that both have


class Table(NamedTuple):
    """The parameters of a fit as arrays, an entry for each number that the model has, (P,) each.

    Attributes:
        median, deviation: logarithms of the prior's median and factor. low, high: bounds of the logarithm.
        lower, upper, offset: of the value. odds, logarithmic: which have a log-normal prior, of their odds or
            themselves; others are uniform. source: which free coordinate the entry has. leader: the entry whose value
            it takes, itself if it is not tied. fixed: whether it has ``value`` instead.
    """

    median: Numbers
    deviation: Numbers
    low: Numbers
    high: Numbers
    lower: Numbers
    upper: Numbers
    offset: Numbers
    odds: Numbers
    logarithmic: Numbers
    source: Numbers
    leader: Numbers
    fixed: Numbers
    value: Numbers

    def of(self, rows: np.ndarray) -> "Table":
        """Some of its entries."""
        return Table(*(x[rows] for x in self))


@dataclass(frozen=True)
class Structure:
    """What programs that are compiled for a layout depend on, beside the length of its arrays.

    Attributes:
        declared: name, whether per channel, whether alike in all channels, and shift of every parameter.
        channels: their number. middle: that in the middle, and its wavelength (um).
    """

    declared: tuple[tuple[str, bool, bool, Shift | None], ...]
    channels: int
    middle: int
    middle_um: float

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Slice of the physical values by parameter name."""
        widths = [self.channels if per_channel else 1 for _, per_channel, _, _ in self.declared]
        ends = np.cumsum(widths).tolist()
        return {each[0]: slice(end - n, end) for each, n, end in zip(self.declared, widths, ends, strict=True)}

    @cached_property
    def moved(self) -> np.ndarray:
        """Entries whose priors move with others: those with a shift, and what is alike, but in the middle channel."""
        places = [self.slices[name].start for name, _, _, shift in self.declared if shift]
        outer = np.delete(np.arange(self.channels), self.middle)
        alike = [self.slices[name].start + k for name, _, alike, _ in self.declared if alike for k in outer]
        return np.array([*places, *alike], int)

    @cached_property
    def still(self) -> np.ndarray:
        """The other entries."""
        return np.setdiff1d(np.arange(self.size), self.moved)

    @cached_property
    def order(self) -> np.ndarray:
        """Where each entry is among those that stay and, after them, those that move."""
        return np.argsort(np.concatenate([self.still, self.moved]))

    @cached_property
    def size(self) -> int:
        """Number P of physical values."""
        return max(s.stop for s in self.slices.values())

    def named(self, flat: Numbers) -> dict[str, Numbers]:
        """Values (..., P) by name: (...), and (..., C) for parameters per channel."""
        return {
            name: flat[..., self.slices[name]] if per_channel else flat[..., self.slices[name].start]
            for name, per_channel, _, _ in self.declared
        }

    def shifts(self, flat: Numbers, offset: Numbers) -> tuple[Numbers, Numbers]:
        """By how much the medians of :attr:`moved` are moved, (..., M), and its rates by all values, (..., M, P)."""
        xp = namespace_of(flat)
        values, units = self.named(flat), np.eye(self.size)
        found, rates = [], []
        for shift in (shift for _, _, _, shift in self.declared if shift):
            by, *slopes = shift.moved(self.middle_um, *(values[name] for name in shift.of))
            found.append(by)
            places = (self.slices[name].start for name in shift.of)
            rates.append(sum(xp.asarray(slope)[..., None] * units[k] for slope, k in zip(slopes, places, strict=True)))
        for name in (name for name, _, alike, _ in self.declared if alike):
            place = self.slices[name].start + self.middle
            above = flat[..., place] - offset[place]
            found += [xp.log(above)] * (self.channels - 1)
            rates += [1 / above[..., None] * units[place]] * (self.channels - 1)
        return xp.stack(found, -1), xp.stack(rates, -2)


def _arithmetic_for(x: Numbers) -> tuple[ModuleType, ModuleType]:
    """Arrays and special functions."""
    xp = namespace_of(x)
    return xp, jax.scipy.special if xp is not np else scipy.special


class _Cut(NamedTuple):
    """Log-normal priors that are cut at the bounds.

    Attributes:
        low, high: bounds, in standard deviations from the median. side: 1, or -1 where the median is below both: all
            is computed on the side where probabilities are exact. near, far: the bounds seen from there. inside:
            probability between them. endless: which have none.
    """

    low: Numbers
    high: Numbers
    side: Numbers
    near: Numbers
    far: Numbers
    inside: Numbers
    endless: Numbers


def _cut(t: Table, median: Numbers) -> _Cut:
    xp, special = _arithmetic_for(median)
    low, high = (t.low - median) / t.deviation, (t.high - median) / t.deviation
    near, far = xp.where(low > 0, -high, low), xp.where(low > 0, -low, high)
    endless = (t.low <= -ENDLESS) & (t.high >= ENDLESS)
    return _Cut(low, high, xp.where(low > 0, -1.0, 1.0), near, far, special.ndtr(far) - special.ndtr(near), endless)


def _log_normal(z: Numbers, t: Table, median: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Logarithms at free coordinates z of log-normal priors, and their rates by z and by the median.

    With n = Phi^-1(Phi(low) + Phi(z) inside) and phi the density of Phi, dn/dz is inside phi(z)/phi(n), and a median
    that moves takes the bounds with it: dn/dlow = phi(low) Phi(-z)/phi(n), dn/dhigh = phi(high) Phi(z)/phi(n).
    """
    xp, special = _arithmetic_for(z)
    c = _cut(t, median)
    below = special.ndtr(c.near) + special.ndtr(c.side * z) * c.inside
    above = special.ndtr(-c.far) + special.ndtr(-c.side * z) * c.inside
    left = below < above  # each from its own end, where it is exact
    tail = special.ndtri(xp.maximum(xp.where(left, below, above), LEAST))
    n = xp.where(c.endless, z, xp.clip(c.side * xp.where(left, 1.0, -1.0) * tail, c.low, c.high))
    by_z = xp.where(c.endless, 1.0, c.inside * xp.exp((n**2 - z**2) / 2))
    by_low = xp.exp((n**2 - c.low**2) / 2 + special.log_ndtr(-z))
    by_high = xp.exp((n**2 - c.high**2) / 2 + special.log_ndtr(z))
    by_median = xp.where(c.endless, 1.0, 1 - by_low - by_high)
    return median + t.deviation * n, t.deviation * by_z, by_median


def _standard_normal(logarithm: np.ndarray, t: Table, median: np.ndarray) -> np.ndarray:
    """Inverse of :func:`_log_normal`."""
    c, plain, ndtr = _cut(t, median), (logarithm - median) / t.deviation, scipy.special.ndtr
    normal = c.side * np.clip(plain, c.low + INSIDE, c.high - INSIDE)
    beyond = np.where(c.far < 0, ndtr(c.far) - ndtr(normal), ndtr(-normal) - ndtr(-c.far))
    below, above = (ndtr(normal) - ndtr(c.near)) / c.inside, beyond / c.inside
    left = below < above
    tail = scipy.special.ndtri(np.maximum(np.where(left, below, above), LEAST))
    return np.where(np.asarray(c.endless), plain, c.side * np.where(left, 1.0, -1.0) * tail)


def _given(z: Numbers, t: Table, shift: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Values of entries, given by how much their medians move, and their rates by z and by that."""
    xp, special = _arithmetic_for(z)
    logarithm, by_z, by_median = _log_normal(z, t, t.median + shift)
    odds = special.expit(xp.where(t.odds, logarithm, 0.0))
    above = xp.exp(xp.where(t.logarithmic, logarithm, 0.0))
    uniform = t.lower + (t.upper - t.lower) * special.ndtr(z)
    density = (t.upper - t.lower) * xp.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    value = xp.where(t.logarithmic, t.offset + above, xp.where(t.odds, odds, uniform))
    rate = xp.where(t.logarithmic, above, xp.where(t.odds, odds * (1 - odds), 0.0))
    by_own = xp.where(t.logarithmic | t.odds, rate * by_z, density)
    free = ~t.fixed
    return xp.where(free, value, t.value), xp.where(free, by_own, 0.0), xp.where(free, rate * by_median, 0.0)


def flat_and_slopes(s: Structure, t: Table, z: Numbers) -> tuple[Numbers, Numbers]:
    """Physical values (..., P) at free coordinates z (..., F), and their slopes (..., P, F).

    The medians of others come first, then those that move with them.
    """
    xp = namespace_of(z)
    own = z[..., t.source]
    found, by_own, _ = _given(own[..., s.still], t.of(s.still), np.zeros(len(s.still)))
    chain = np.eye(s.size)
    if len(s.moved):
        before = xp.concatenate([found, xp.ones((*own.shape[:-1], len(s.moved)))], -1)[..., s.order]
        shifts, by_values = s.shifts(before, t.offset)
        later, by_later, by_shift = _given(own[..., s.moved], t.of(s.moved), shifts)
        found = xp.concatenate([found, later], -1)[..., s.order]
        by_own = xp.concatenate([by_own, by_later], -1)[..., s.order]
        chain = chain + np.eye(s.size)[:, s.moved] @ (by_shift[..., None] * by_values)
    slopes = (chain * by_own[..., None, :])[..., t.leader, :]
    taken = (t.source[:, None] == np.arange(z.shape[-1])) & ~t.fixed[:, None]
    return found[..., t.leader], slopes @ taken.astype(float)


def coordinates(s: Structure, t: Table, values: np.ndarray) -> np.ndarray:
    """The coordinate that every entry would have by itself, (..., P); inverse of :func:`flat_and_slopes`."""
    kept = np.clip(values, TINY_ODDS, 1 - INSIDE)
    odds = np.log(kept) - np.log1p(-kept)
    logarithm = np.where(t.odds, odds, np.log(np.maximum(values - t.offset, LEAST)))
    linear = scipy.special.ndtri(np.clip((values - t.lower) / (t.upper - t.lower), INSIDE, 1 - INSIDE))
    median = t.median + np.zeros_like(values)
    if len(s.moved):
        median[..., s.moved] += s.shifts(values, t.offset)[0]
    return np.where(np.asarray(t.odds | t.logarithmic), _standard_normal(logarithm, t, median), linear)
