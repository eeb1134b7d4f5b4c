"""Between the bounded parameters of a material and the free coordinates in which they are fitted and sampled.

Free coordinates z are those in which the prior is standard normal: every parameter given those before it. A log-normal
prior of median m and factor f, cut at the bounds, is

    log(value - offset) = log m + shift + log f Phi^-1(A + Phi(z) (B - A)),    A, B = Phi(bound's distance / log f),

a uniform one lower + Phi(z) (upper - lower); an albedo's odds, albedo / (1 - albedo), are log-normal. The shifts make
coordinates of what the data show: the half width of the lobe instead of beta, given p; the height that diffracts into
directions that exist instead of sigma_s, given b and c; and the ratio of eta - 1 to that of the middle channel in the
others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import expit, ndtr, ndtri
from jax.typing import ArrayLike

from ..model.parameters import CHANNELS, PRIORS, WAVELENGTHS_UM, LogNormal, Parameter, Priors
from ..model.reflectance import Reflectance
from ..model.two_scale import TwoScale

INSIDE = 1e-6  # of a standard deviation, or of the way between bounds: so far inside them values are moved
MIDDLE_UM = WAVELENGTHS_UM[len(WAVELENGTHS_UM) // 2]
MIDDLE = "eta of the middle channel"  # given which the others are
LEAST = 1e-300
ODDS = "odds"  # quantity of what lies between 0 and 1 and may be a few thousandths
TINY_ODDS = 1e-6  # least albedo that a start may have


@dataclass(frozen=True)
class Layout:
    """Where each parameter sits in the flat vector: shared ones first, then per-channel ones, channel by channel.

    Attributes:
        model: what is fitted. priors: of its parameters. channels: names of the colour channels.
    """

    model: Reflectance
    priors: Priors = PRIORS
    channels: tuple[str, ...] = CHANNELS

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The declarations, shared before per-channel."""
        return self.model.parameters

    def _width(self, parameter: Parameter) -> int:
        return len(self.channels) if parameter.per_channel else 1

    @property
    def effects(self) -> TwoScale:
        """The model, where only a two-scale one will do.

        Raises:
            TypeError: it is another.
        """
        if not isinstance(self.model, TwoScale):
            raise TypeError(f"{self.model.name} is not the two-scale model")
        return self.model

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
        """Name of every free coordinate: the quantity that its prior is of."""
        return tuple(n.replace(q.name, q.quantity or q.name, 1) for n, q in zip(self.names, self.entries, strict=True))

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

    def _values(self, z: Array) -> dict[str, Array]:
        where, found = self.slices, {}
        for q in sorted(self.parameters, key=lambda q: q.name in self.model.conditional):
            place = z[where[q.name]] if q.per_channel else z[where[q.name]][0]
            if q.name == "eta":
                found[MIDDLE] = self._value(q, place[len(self.channels) // 2], found)
            found[q.name] = self._value(q, place, found)
        return {name: value for name, value in found.items() if name != MIDDLE}

    def free(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        """Free coordinates of physical values; values on or beyond a bound are moved just inside."""
        inside = {q.name: np.clip(np.asarray(values[q.name], float), q.lower, q.upper) for q in self.parameters}
        given = {q.name: np.broadcast_to(inside[q.name], self._shape(q)) for q in self.parameters}
        return np.asarray(_free(self.chart, given))

    def _flat_free(self, values: Mapping[str, Array]) -> Array:
        given = {**values, MIDDLE: values["eta"][len(self.channels) // 2]} if "eta" in values else values
        return jnp.concatenate([jnp.ravel(self._free(q, values[q.name], given)) for q in self.parameters])

    def _shape(self, parameter: Parameter) -> tuple[int, ...]:
        return (len(self.channels),) if parameter.per_channel else ()

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
        if parameter.name == "eta":
            said += f", in other channels that of the middle one times or over {self.priors.dispersion.factor:g}"
        return f"{said}; {parameter.name} {bounds}"

    def _expected(self, q: Parameter, values: Mapping[str, Array]) -> tuple[ArrayLike, ArrayLike]:
        """Median and standard deviation of log(value - offset), given other values."""
        given = self.log_normal(q)
        median, deviation = np.log(given.median), np.log(given.factor)
        if q.name in self.model.conditional:
            return median + self.model.shift(q.name, values), deviation
        if MIDDLE in values and q.name == "eta":
            outer, ratio = np.arange(len(self.channels)) != len(self.channels) // 2, self.priors.dispersion
            around = jnp.log(values[MIDDLE] - q.offset) + np.log(ratio.median)
            return jnp.where(outer, around, median), np.where(outer, np.log(ratio.factor), deviation)
        return median, deviation

    def _ends(self, q: Parameter, values: Mapping[str, Array]) -> tuple[ArrayLike, ArrayLike, Array, Array]:
        """Median and standard deviation of log(value - offset), and the bounds in units of that from the median."""
        median, deviation = self._expected(q, values)
        low, high = np.log(np.array([q.lower, q.upper]) - q.offset)
        return median, deviation, jnp.asarray((low - median) / deviation), jnp.asarray((high - median) / deviation)

    def _value(self, q: Parameter, z: Array, values: Mapping[str, Array]) -> Array:
        """Physical value at free coordinate z."""
        if q.quantity == ODDS:
            return expit(np.log(self.priors.odds.median) + np.log(self.priors.odds.factor) * z)
        if q.scale == "linear":
            return q.lower + (q.upper - q.lower) * ndtr(z)
        median, deviation, low, high = self._ends(q, values)
        inside = ndtr(high) - ndtr(low)
        below, above = ndtr(low) + ndtr(z) * inside, ndtr(-high) + ndtr(-z) * inside
        left = below < above  # each from its own end, where it is exact
        normal = jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))
        return q.offset + jnp.exp(median + deviation * jnp.clip(normal, low, high))

    def _free(self, q: Parameter, value: Array, values: Mapping[str, Array]) -> Array:
        """Free coordinate of a physical value."""
        if q.quantity == ODDS:
            odds = jnp.log(jnp.clip(value, TINY_ODDS, 1 - INSIDE)) - jnp.log1p(-jnp.clip(value, TINY_ODDS, 1 - INSIDE))
            return (odds - np.log(self.priors.odds.median)) / np.log(self.priors.odds.factor)
        if q.scale == "linear":
            return ndtri(jnp.clip((value - q.lower) / (q.upper - q.lower), INSIDE, 1 - INSIDE))
        median, deviation, low, high = self._ends(q, values)
        logarithm = jnp.log(jnp.maximum(value - q.offset, LEAST))
        normal = jnp.clip((logarithm - median) / deviation, low + INSIDE, high - INSIDE)
        inside = ndtr(high) - ndtr(low)
        below, above = (ndtr(normal) - ndtr(low)) / inside, (ndtr(-normal) - ndtr(-high)) / inside
        left = below < above
        return jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))


@partial(jax.jit, static_argnums=0)
def _values(chart: Layout, z: Array) -> dict[str, Array]:
    return chart._values(z)


@partial(jax.jit, static_argnums=0)
def _values_of_many(chart: Layout, z: Array) -> dict[str, Array]:
    return jax.vmap(chart._values)(z)


@partial(jax.jit, static_argnums=0)
def _flat(chart: Layout, z: Array) -> Array:
    named = chart._values(z)
    return jnp.concatenate([jnp.ravel(named[q.name]) for q in chart.parameters])


@partial(jax.jit, static_argnums=0)
def _values_and_slopes(chart: Layout, z: Array) -> tuple[dict[str, Array], Array]:
    return chart._values(z), jax.jacfwd(partial(_flat, chart))(z)


@partial(jax.jit, static_argnums=0)
def _free(chart: Layout, values: Mapping[str, Array]) -> Array:
    return chart._flat_free(values)


@cache
def layout_of(model: Reflectance, priors: Priors = PRIORS) -> Layout:
    """The flat vector of everything that this model leaves to be fitted."""
    return Layout(model, priors)
