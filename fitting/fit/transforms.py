"""Between the bounded parameters of a material and the free coordinates in which they are fitted and sampled.

Free coordinates z are those in which the prior is standard normal: every parameter given those before it. A log-normal
prior of median m and factor f, cut at the bounds, is

    log(value - offset) = log m + shift + log f Phi^-1(A + Phi(z) (B - A)),    A, B = Phi(bound's distance / log f),

a uniform one lower + Phi(z) (upper - lower); an albedo's odds, albedo / (1 - albedo), are log-normal. The shifts make
coordinates of what the data show: the half width of the lobe instead of beta, given p; the height that diffracts into
directions that exist instead of sigma_s, given b and c; and the ratio of what channels have alike (eta - 1) to that of
the middle channel in the others.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import expit, ndtr, ndtri
from jax.typing import ArrayLike

from ...merl_io.bands import MERL, Bands
from ...model.measured import material_of, with_material
from ...model.parameters import Parameter
from ...model.priors import PRIORS, LogNormal, Priors
from ...model.reflectance import Reflectance

INSIDE = 1e-6  # of a standard deviation, or of the way between bounds: so far inside them values are moved
LEAST = 1e-300
ODDS = "odds"  # quantity of what lies between 0 and 1 and may be a few thousandths
TINY_ODDS = 1e-6  # least albedo that a start may have


@dataclass(frozen=True)
class Layout:
    """Where each parameter sits in the flat vector: shared ones first, then per-channel ones, channel by channel.

    Attributes:
        model: what is fitted. priors: of its parameters. bands: of the measurement.
    """

    model: Reflectance
    priors: Priors = PRIORS
    bands: Bands = MERL

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the bands."""
        return self.bands.names

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The declarations, shared before per-channel."""
        return self.model.parameters

    def _width(self, parameter: Parameter) -> int:
        return len(self.bands) if parameter.per_channel else 1

    @property
    def material(self) -> Reflectance:
        """The model without the apparatus."""
        return material_of(self.model)

    def with_material(self, material: Reflectance) -> "Layout":
        """The same of another material, seen by the same apparatus."""
        return replace(self, model=with_material(self.model, material))

    @property
    def slices(self) -> dict[str, slice]:
        """Slice of the flat vector by parameter name."""
        ends = np.cumsum([self._width(q) for q in self.parameters])
        return {q.name: slice(int(e) - self._width(q), int(e)) for q, e in zip(self.parameters, ends, strict=True)}

    @property
    def size(self) -> int:
        """Length of the flat vector."""
        return sum(self._width(q) for q in self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every entry, ``beta`` or ``n_R``."""
        return tuple(
            name
            for q in self.parameters
            for name in ([f"{q.name}_{ch}" for ch in self.channels] if q.per_channel else [q.name])
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name of every free coordinate: the quantity that its prior is of, if it is that of no other parameter."""
        used = Counter(q.quantity or q.name for q in self.parameters)
        return tuple(
            n.replace(q.name, q.quantity, 1) if q.quantity and used[q.quantity] == 1 else n
            for n, q in zip(self.names, self.entries, strict=True)
        )

    @property
    def entries(self) -> tuple[Parameter, ...]:
        """Declaration of every entry."""
        return tuple(q for q in self.parameters for _ in range(self._width(q)))

    @cached_property
    def chart(self) -> "Layout":
        """The same for all models with the same parameters: programs are compiled for this."""
        return replace(self, model=self.model.chart)

    def values(self, z: Array) -> dict[str, Array]:
        """Physical values by name: scalars, and ``(C,)`` for parameters per channel."""
        return _values(self.chart, z)

    def values_of_many(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The same for many points (M, P), with a leading axis M."""
        return {name: np.asarray(x) for name, x in _values_of_many(self.chart, z).items()}

    def flat(self, z: Array) -> Array:
        """Physical values, shape (P,)."""
        return _flat(self.chart, z)

    def slopes(self, z: ArrayLike) -> Array:
        """d value_i / d z_j, (P, P)."""
        return self.values_and_slopes(z)[1]

    def values_and_slopes(self, z: ArrayLike) -> tuple[dict[str, Array], Array]:
        """Both in one call."""
        return _values_and_slopes(self.chart, jnp.asarray(z))

    def values_and_slopes_of_many(self, points: ArrayLike) -> tuple[dict[str, Array], Array]:
        """The same for many points (M, P), with a leading axis M."""
        return _values_and_slopes_of_many(self.chart, jnp.asarray(points))

    def _values(self, z: Array) -> Array:
        """Physical values, (P,): all given the medians of others first, then those that move with others."""
        found, moved = self._unmoved(z), self._moved
        return found.at[moved].set(self._log_normal_moved(z[moved], self._shifts(found))) if len(moved) else found

    def _unmoved(self, z: Array) -> Array:
        e = self._scales
        found = jnp.where(e.odds, expit(e.median + e.deviation * z), e.lower + (e.upper - e.lower) * ndtr(z))
        return jnp.where(e.logarithmic, _log_normal(z, e, e.median), found)

    def _log_normal_moved(self, z: Array, shifts: Array) -> Array:
        e = Scales(*(x[self._moved] for x in self._scales))
        return _log_normal(z, e, e.median + shifts)

    def _values_and_slopes(self, z: Array) -> tuple[Array, Array]:
        """:meth:`_values` and their derivatives (P, P): but for those that move, a value depends on its own z alone.

        Written out like this it compiles in a quarter of the time that ``jacfwd`` takes.
        """
        moved = self._moved
        found, own = jax.jvp(self._unmoved, (z,), (jnp.ones_like(z),))
        slopes = jnp.diag(own)
        if not len(moved):
            return found, slopes
        shifts, by_values = self._shifts(found), jax.jacfwd(self._shifts)(found)
        values, slope = jax.linearize(self._log_normal_moved, z[moved], shifts)
        still, one = jnp.zeros(len(moved)), jnp.ones(len(moved))
        rows = slope(still, one)[:, None] * by_values * own
        rows = rows.at[jnp.arange(len(moved)), moved].set(slope(one, still))
        return found.at[moved].set(values), slopes.at[moved].set(rows)

    def _flat_free(self, values: Array) -> Array:
        """Free coordinates of physical values, (P,) each; inverse of :meth:`_values`."""
        e = self._scales
        kept = jnp.clip(values, TINY_ODDS, 1 - INSIDE)
        odds = (jnp.log(kept) - jnp.log1p(-kept) - e.median) / e.deviation
        linear = ndtri(jnp.clip((values - e.lower) / (e.upper - e.lower), INSIDE, 1 - INSIDE))
        median = jnp.asarray(e.median)
        if len(self._moved):
            median = median.at[self._moved].add(self._shifts(values))
        found = jnp.where(e.odds, odds, linear)
        return jnp.where(e.logarithmic, _standard_normal(values, e, median), found)

    def _named(self, flat: Array) -> dict[str, Array]:
        return {q.name: flat[s] if q.per_channel else flat[s][0] for q, s in zip(
            self.parameters, self.slices.values(), strict=True)}  # fmt: skip

    def _shifts(self, flat: Array) -> Array:
        """By how much the medians of :attr:`_moved` are moved, given the values of the others."""
        values, shifts = self._named(flat), self._own_shifts
        found = [shifts[name](values)[None] for name in self.slices if name in shifts]
        for q in self._alike:
            middle = jnp.log(values[q.name][self.bands.middle] - q.offset)
            found.append(jnp.repeat(middle, len(self.bands) - 1))
        return jnp.concatenate(found)

    @property
    def _own_shifts(self) -> Mapping[str, Callable[[Mapping[str, Array]], Array]]:
        """Those that the model has."""
        return self.model.shifts(self.bands.middle_um)

    @property
    def _alike(self) -> list[Parameter]:
        return [q for q in self.parameters if q.alike]

    @cached_property
    def _moved(self) -> np.ndarray:
        """Entries whose priors move with others: `Reflectance.shifts`, and what is alike, but in the middle channel."""
        places = [self.slices[q.name].start for q in self.parameters if q.name in self._own_shifts]
        outer = np.delete(np.arange(len(self.bands)), self.bands.middle)
        return np.array([*places, *(self.slices[q.name].start + k for q in self._alike for k in outer)], int)

    @cached_property
    def _scales(self) -> "Scales":
        """Of every entry."""
        rows = []
        for k, q in enumerate(self.entries):
            given = LogNormal(1.0, np.e)  # of no use to a linear one
            if q.quantity == ODDS:
                given = self.priors.odds
            elif q.scale == "log":
                given = self.priors.dispersion if q.alike and k in self._moved else self.log_normal(q)
            rows.append((np.log(given.median), np.log(given.factor), q.lower, q.upper, q.offset,
                         q.quantity == ODDS, q.scale == "log" and q.quantity != ODDS))  # fmt: skip
        return Scales(*map(np.array, zip(*rows, strict=True)))

    def free(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        """Free coordinates of physical values; values on or beyond a bound are moved just inside."""
        inside = {q.name: np.clip(np.asarray(values[q.name], float), q.lower, q.upper) for q in self.parameters}
        given = [np.broadcast_to(inside[q.name], self._shape(q)).ravel() for q in self.parameters]
        return np.asarray(_free(self.chart, np.concatenate(given)))

    def _shape(self, parameter: Parameter) -> tuple[int, ...]:
        return (len(self.bands),) if parameter.per_channel else ()

    def position(self, z: ArrayLike) -> np.ndarray:
        """Position of every entry between its bounds, in [0, 1], in the parameter's own scale."""
        found = self.values(jnp.asarray(z))
        return np.concatenate([np.ravel(q.position(found[q.name])) for q in self.parameters])

    def log_normal(self, parameter: Parameter) -> LogNormal:
        """Its log-normal prior, before the shift."""
        return parameter.prior or getattr(self.priors, parameter.quantity or parameter.name)

    def prior(self, parameter: Parameter) -> str:
        """The prior in words."""
        bounds = f"in [{parameter.lower:g}, {parameter.upper:g}]"
        if parameter.quantity == ODDS:
            odds = self.priors.odds
            return f"{parameter.name}/(1 - {parameter.name}) log-normal, {odds.median:g} times or over {odds.factor:g}"
        if parameter.scale == "linear":
            return f"uniform {bounds}"
        given = self.log_normal(parameter)
        of = parameter.quantity or parameter.name
        said = f"{of} - {parameter.offset:g}" if parameter.offset else of
        said += f" log-normal, {given.median:g} times or over {given.factor:g}"
        if parameter.alike:
            said += f", in other channels that of the middle one times or over {self.priors.dispersion.factor:g}"
        return f"{said}; {parameter.name} {bounds}"


class Scales(NamedTuple):
    """What the transform of every entry is, (P,) each: logarithm of the prior's median and factor, bounds, offset."""

    median: np.ndarray
    deviation: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    offset: np.ndarray
    odds: np.ndarray
    logarithmic: np.ndarray

    def ends(self, median: ArrayLike) -> tuple[Array, Array]:
        """Bounds in standard deviations from the median."""
        used = self.logarithmic
        low, high = (np.log(np.where(used, x - self.offset, 1.0)) for x in (self.lower, self.upper))
        return jnp.where(used, (low - median) / self.deviation, -1.0), jnp.where(
            used, (high - median) / self.deviation, 1.0
        )


def _log_normal(z: Array, e: Scales, median: ArrayLike) -> Array:
    """Values at free coordinates z of log-normal priors that are cut at the bounds."""
    low, high = e.ends(median)
    inside = ndtr(high) - ndtr(low)
    below, above = ndtr(low) + ndtr(z) * inside, ndtr(-high) + ndtr(-z) * inside
    left = below < above  # each from its own end, where it is exact
    normal = jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))
    return jnp.asarray(e.offset) + jnp.exp(median + e.deviation * jnp.clip(normal, low, high))


def _standard_normal(values: Array, e: Scales, median: Array) -> Array:
    """Inverse of :func:`_log_normal`."""
    low, high = e.ends(median)
    logarithm = jnp.log(jnp.maximum(values - e.offset, LEAST))
    normal = jnp.clip((logarithm - median) / e.deviation, low + INSIDE, high - INSIDE)
    inside = ndtr(high) - ndtr(low)
    below, above = (ndtr(normal) - ndtr(low)) / inside, (ndtr(-normal) - ndtr(-high)) / inside
    left = below < above
    return jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))


@partial(jax.jit, static_argnums=0)
def _values(chart: Layout, z: Array) -> dict[str, Array]:
    return chart._named(chart._values(z))


@partial(jax.jit, static_argnums=0)
def _values_of_many(chart: Layout, z: Array) -> dict[str, Array]:
    return jax.vmap(lambda z: chart._named(chart._values(z)))(z)


@partial(jax.jit, static_argnums=0)
def _flat(chart: Layout, z: Array) -> Array:
    return chart._values(z)


@partial(jax.jit, static_argnums=0)
def _values_and_slopes(chart: Layout, z: Array) -> tuple[dict[str, Array], Array]:
    found, slopes = chart._values_and_slopes(z)
    return chart._named(found), slopes


@partial(jax.jit, static_argnums=0)
def _values_and_slopes_of_many(chart: Layout, points: Array) -> tuple[dict[str, Array], Array]:
    return jax.vmap(lambda z: _values_and_slopes(chart, z))(points)


@partial(jax.jit, static_argnums=0)
def _free(chart: Layout, values: Array) -> Array:
    return chart._flat_free(values)


@cache
def layout_of(model: Reflectance, priors: Priors = PRIORS, bands: Bands = MERL) -> Layout:
    """The flat vector of everything that this model leaves to be fitted.

    Raises:
        ValueError: a parameter is declared so that it has no prior, or a prior that its bounds contradict.
    """
    for q in model.parameters:
        if q.scale == "log" and q.prior is None and not hasattr(priors, q.quantity or q.name):
            raise ValueError(f"{model}: {q.name} has a logarithmic scale, but no prior: declare one")
        if q.quantity == ODDS and (q.lower, q.upper) != (0.0, 1.0):
            raise ValueError(f"{model}: {q.name} has odds: its bounds should be 0 and 1")
        if q.alike and not (q.per_channel and q.scale == "log"):
            raise ValueError(f"{model}: {q.name} is alike in all channels: it should be per channel, of a log scale")
    return Layout(model, priors, bands)
