"""Between the bounded parameters of a material and the free coordinates in which they are fitted and sampled.

Free coordinates z are those in which the prior is standard normal: every parameter given those before it. A log-normal
prior of median m and factor f, cut at the bounds, is

    log(value - offset) = log m + shift + log f Phi^-1(A + Phi(z) (B - A)),    A, B = Phi(bound's distance / log f),

a uniform one lower + Phi(z) (upper - lower); an albedo's odds, albedo / (1 - albedo), are log-normal. The shifts make
coordinates of what the data show: the half width of the lobe instead of beta, given p; the height that diffracts into
directions that exist instead of sigma_s, given b and c; and the ratio of what channels have alike (eta - 1) to that of
the middle channel in the others.

What a user fixes has no coordinate, and what is tied has that of the middle channel. All numbers are data of the
compiled programs (:class:`Table`): other bounds, priors and fixed values are not compiled anew.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import ndtr, ndtri
from jax.typing import ArrayLike

from ...merl_io.bands import MERL, Bands
from ...model.measured import material_of, with_material
from ...model.parameters import Parameter, Shift
from ...model.priors import PRIORS, Constraint, LogNormal, Priors
from ...model.reflectance import Reflectance
from ..support.kept import Kept, kept

INSIDE = 1e-6  # of a standard deviation, or of the way between bounds: so far inside them values are moved
LEAST = 1e-300
ODDS = "odds"  # quantity of what lies between 0 and 1 and may be a few thousandths
TINY_ODDS = 1e-6  # least albedo that a start may have
Kind = Literal["free", "fixed", "tied"]
Numbers = np.ndarray | Array
FARTHEST = 30.0  # standard deviations of a prior from its bounds: nothing of it is left there
ENDLESS = 1e4  # stands for the logarithm of odds at a bound of 0 or 1


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

    def named(self, flat: Array) -> dict[str, Array]:
        """Values by name: scalars, and (C,) for parameters per channel."""
        return {
            name: flat[self.slices[name]] if per_channel else flat[self.slices[name]][0]
            for name, per_channel, _, _ in self.declared
        }

    def shifts(self, flat: Array, offset: ArrayLike) -> Array:
        """By how much the medians of :attr:`moved` are moved, given the values of the others."""
        values, offset = self.named(flat), jnp.asarray(offset)
        found = [shift(values, self.middle_um)[None] for _, _, _, shift in self.declared if shift]
        for name in (name for name, _, alike, _ in self.declared if alike):
            middle = jnp.log(values[name][self.middle] - offset[self.slices[name].start])
            found.append(jnp.repeat(middle, self.channels - 1))
        return jnp.concatenate(found)


@dataclass(frozen=True)
class Layout:
    """Parameters of a model in the flat vector: shared ones first, then per-channel ones, channel by channel.

    Attributes:
        model: what is fitted. priors: of its parameters. bands: of the measurement.
        constraints: by parameter name, what a user says of them.
    """

    model: Reflectance
    priors: Priors = PRIORS
    bands: Bands = MERL
    constraints: tuple[tuple[str, Constraint], ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the bands."""
        return self.bands.names

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The declarations, shared before per-channel, with the bounds and priors that the user sets."""
        given = dict(self.constraints)
        return tuple(_constrained(q, given[q.name]) if q.name in given else q for q in self.model.parameters)

    def _width(self, parameter: Parameter) -> int:
        return len(self.bands) if parameter.per_channel else 1

    @property
    def material(self) -> Reflectance:
        """The model without the apparatus."""
        return material_of(self.model)

    def with_material(self, material: Reflectance) -> "Layout":
        """The same of another material, seen by the same apparatus."""
        return replace(self, model=with_material(self.model, material))

    @cached_property
    def unfixed(self) -> "Layout":
        """The same with every number free, within its bounds."""
        freed = ((name, replace(each, fixed=None, tied=False)) for name, each in self.constraints)
        return replace(self, constraints=tuple(freed))

    @cached_property
    def structure(self) -> Structure:
        """What programs are compiled for."""
        declared = tuple((q.name, q.per_channel, q.alike, q.shift) for q in self.parameters)
        return Structure(declared, len(self.bands), self.bands.middle, self.bands.middle_um)

    @property
    def slices(self) -> dict[str, slice]:
        """Slice of the physical values by parameter name."""
        return self.structure.slices

    @property
    def size(self) -> int:
        """Number F of free coordinates."""
        return len(self.leads)

    @cached_property
    def entries(self) -> tuple[Parameter, ...]:
        """Declaration of every one of the P physical values."""
        return tuple(q for q in self.parameters for _ in range(self._width(q)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of every entry, ``beta`` or ``n_R``."""
        return tuple(
            name
            for q in self.parameters
            for name in ([f"{q.name}_{ch}" for ch in self.channels] if q.per_channel else [q.name])
        )

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """The kind of every entry: whether it is free, fixed, or tied to the one in the middle channel."""
        given, found = dict(self.constraints), []
        for q in self.parameters:
            own = given.get(q.name, Constraint())
            if own.fixed is not None:
                found += ["fixed"] * self._width(q)
            else:
                tied = own.tied and q.per_channel
                found += ["tied" if tied and k != self.bands.middle else "free" for k in range(self._width(q))]
        return tuple(found)

    @cached_property
    def leads(self) -> np.ndarray:
        """Entry of every free coordinate, (F,)."""
        return np.flatnonzero(np.array(self.kinds) == "free")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name of every free coordinate: the quantity that its prior is of, if it is that of no other parameter."""
        used = Counter(q.quantity or q.name for q in self.parameters)
        named = [(self.names[k], self.entries[k]) for k in self.leads]
        return tuple(n.replace(q.name, q.quantity, 1) if q.quantity and used[q.quantity] == 1 else n for n, q in named)

    @cached_property
    def table(self) -> Table:
        """All of it as arrays."""
        rows, moved, given = [], self.structure.moved, dict(self.constraints)
        for k, q in enumerate(self.entries):
            prior = LogNormal(1.0, np.e)  # of no use to a uniform one
            if q.quantity == ODDS:
                prior, low, high = self.log_normal(q), _log_odds(q.lower), _log_odds(q.upper)
            elif q.scale == "log":
                prior = self.priors.dispersion if q.alike and k in moved else self.log_normal(q)
                low, high = np.log(q.lower - q.offset), np.log(q.upper - q.offset)
            else:
                low, high = -1.0, 1.0
            rows.append((np.log(prior.median), np.log(prior.factor), low, high, q.lower, q.upper, q.offset,
                         q.quantity == ODDS, q.scale == "log" and q.quantity != ODDS))  # fmt: skip
        leader, coordinate = np.arange(len(rows)), {int(lead): k for k, lead in enumerate(self.leads)}
        fixed, value = np.array(self.kinds) == "fixed", np.ones(len(rows))
        for q in self.parameters:
            where = self.slices[q.name]
            if fixed[where.start]:
                value[where] = given[q.name].fixed
            elif "tied" in self.kinds[where]:
                leader[where] = where.start + self.bands.middle
        source = np.array([coordinate.get(int(k), 0) for k in leader])
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        return Table(*columns, source, leader, fixed, value)  # pyright: ignore[reportCallIssue] - nine columns

    def values(self, z: ArrayLike) -> dict[str, Array]:
        """Physical values by name: scalars, and ``(C,)`` for parameters per channel."""
        return _values(self.structure, self.table, z)

    def values_of_many(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The same for many points (M, F), with a leading axis M."""
        return {name: np.asarray(x) for name, x in _values_of_many(self.structure, self.table, z).items()}

    def flat(self, z: ArrayLike) -> Array:
        """Physical values, shape (P,)."""
        return _flat_jitted(self.structure, self.table, z)

    def slopes(self, z: ArrayLike) -> Array:
        """d value_i / d z_j, (P, F)."""
        return self.values_and_slopes(z)[1]

    def values_and_slopes(self, z: ArrayLike) -> tuple[dict[str, Array], Array]:
        """Both in one call."""
        return _values_and_slopes(self.structure, self.table, z)

    def values_and_slopes_of_many(self, points: ArrayLike) -> tuple[dict[str, Array], Array]:
        """The same for many points (M, F), with a leading axis M."""
        return values_and_slopes_of_many(self.structure, self.table, points)

    def held(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Values by name, of one point or many, with those that are fixed as they are fixed."""
        fixed = {name: np.squeeze(each.fixed) for name, each in self.constraints if each.fixed is not None}
        return {name: np.broadcast_to(fixed[name], np.shape(x)) if name in fixed else x for name, x in values.items()}

    def free(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        """Free coordinates of physical values, (F,); values on or beyond a bound are moved just inside."""
        given = self.held({q.name: np.broadcast_to(np.asarray(values[q.name], float), self._shape(q))
                           for q in self.parameters})  # fmt: skip
        inside = [np.ravel(np.clip(given[q.name], q.lower, q.upper)) for q in self.parameters]
        return np.asarray(_free(self.structure, self.table, np.concatenate(inside)))[self.leads]

    def free_of_many(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The same for many points, (M, F); values with a leading axis M."""
        given = self.held({q.name: np.asarray(values[q.name], float) for q in self.parameters})
        inside = [np.clip(given[q.name], q.lower, q.upper) for q in self.parameters]
        flat = np.concatenate([x.reshape(len(x), -1) for x in inside], 1)
        return np.asarray(_free_of_many(self.structure, self.table, flat))[:, self.leads]

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
        own = dict(self.constraints).get(parameter.name, Constraint())
        if own.fixed is not None:
            return "none: fixed"
        tied = ", one value for all channels" if own.tied and parameter.per_channel else ""
        bounds = f"in [{parameter.lower:g}, {parameter.upper:g}]"
        if parameter.quantity == ODDS:
            odds, cut = (
                self.log_normal(parameter),
                "" if (parameter.lower, parameter.upper) == (0.0, 1.0) else f"; {bounds}",
            )
            said = f"{parameter.name}/(1 - {parameter.name}) log-normal, {odds.median:g} times or over {odds.factor:g}"
            return said + cut + tied
        if parameter.scale == "linear":
            return f"uniform {bounds}{tied}"
        given = self.log_normal(parameter)
        of = parameter.quantity or parameter.name
        said = f"{of} - {parameter.offset:g}" if parameter.offset else of
        said += f" log-normal, {given.median:g} times or over {given.factor:g}"
        if parameter.alike and not tied:
            said += f", in other channels that of the middle one times or over {self.priors.dispersion.factor:g}"
        return f"{said}; {parameter.name} {bounds}{tied}"


def _constrained(q: Parameter, given: Constraint) -> Parameter:
    """A declaration with the bounds and the prior that a user sets."""
    found = replace(
        q, lower=q.lower if given.lower is None else given.lower, upper=q.upper if given.upper is None else given.upper
    )
    return found if given.prior is None else replace(found, prior=given.prior, quantity=None, shift=None)


def _log_odds(share: float) -> float:
    return ENDLESS * (2 * share - 1) if share in (0.0, 1.0) else float(np.log(share) - np.log1p(-share))


def _log_normal(z: Array, t: Table, median: ArrayLike) -> Array:
    """Logarithms at free coordinates z of log-normal priors that are cut at the bounds."""
    low, high = (t.low - median) / t.deviation, (t.high - median) / t.deviation
    side = jnp.where(low > 0, -1.0, 1.0)  # of the median: all is computed below it, where probabilities are exact
    near, far = jnp.where(low > 0, -high, low), jnp.where(low > 0, -low, high)
    inside = ndtr(far) - ndtr(near)
    below, above = ndtr(near) + ndtr(side * z) * inside, ndtr(-far) + ndtr(-side * z) * inside
    left = below < above  # each from its own end, where it is exact
    normal = side * jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))
    endless = (t.low <= -ENDLESS) & (t.high >= ENDLESS)
    return jnp.asarray(median) + t.deviation * jnp.where(endless, z, jnp.clip(normal, low, high))


def _standard_normal(logarithm: Array, t: Table, median: Array) -> Array:
    """Inverse of :func:`_log_normal`."""
    low, high = (t.low - median) / t.deviation, (t.high - median) / t.deviation
    plain = (logarithm - median) / t.deviation
    side = jnp.where(low > 0, -1.0, 1.0)
    near, far = jnp.where(low > 0, -high, low), jnp.where(low > 0, -low, high)
    normal = side * jnp.clip(plain, low + INSIDE, high - INSIDE)
    inside = ndtr(far) - ndtr(near)
    beyond = jnp.where(far < 0, ndtr(far) - ndtr(normal), ndtr(-normal) - ndtr(-far))
    below, above = (ndtr(normal) - ndtr(near)) / inside, beyond / inside
    left = below < above
    found = side * jnp.where(left, 1.0, -1.0) * ndtri(jnp.maximum(jnp.where(left, below, above), LEAST))
    return jnp.where((t.low <= -ENDLESS) & (t.high >= ENDLESS), plain, found)


def _unmoved(z: Array, t: Table) -> Array:
    """Values whose priors do not move, (P,), from the coordinate of each."""
    logarithm = _log_normal(z, t, t.median)
    uniform = t.lower + (t.upper - t.lower) * ndtr(z)
    found = jnp.where(t.odds, jax.nn.sigmoid(jnp.where(t.odds, logarithm, 0.0)), uniform)
    return jnp.where(t.logarithmic, jnp.asarray(t.offset) + jnp.exp(jnp.where(t.logarithmic, logarithm, 0.0)), found)


def _moved(z: Array, t: Table, shifts: Array) -> Array:
    return jnp.asarray(t.offset) + jnp.exp(_log_normal(z, t, t.median + shifts))


def _flat(s: Structure, t: Table, z: Array) -> Array:
    """Physical values, (P,): all given the medians of others first, then those that move with others."""
    own, moved = z[t.source], s.moved
    found = jnp.where(t.fixed, t.value, _unmoved(own, t))
    if len(moved):
        few = t.of(moved)
        values = _moved(own[moved], few, s.shifts(found, t.offset))
        found = found.at[moved].set(jnp.where(few.fixed, few.value, values))
    return found[t.leader]


def _flat_and_slopes(s: Structure, t: Table, z: Array) -> tuple[Array, Array]:
    """:func:`_flat` and its derivatives (P, F): but for those that move, a value depends on its own z alone.

    Written out like this it compiles in a quarter of the time that ``jacfwd`` takes.
    """
    own, moved, free = z[t.source], s.moved, ~jnp.asarray(t.fixed)
    found, slope_of_own = jax.jvp(lambda z: _unmoved(z, t), (own,), (jnp.ones_like(own),))
    found, slope_of_own = jnp.where(free, found, t.value), jnp.where(free, slope_of_own, 0.0)
    slopes = jnp.diag(slope_of_own)
    if len(moved):
        few = t.of(moved)
        shifts = s.shifts(found, t.offset)
        by_values = jax.jacfwd(lambda flat: s.shifts(flat, t.offset))(found)
        values, slope = jax.linearize(lambda z, shifts: _moved(z, few, shifts), own[moved], shifts)
        still, one = jnp.zeros(len(moved)), jnp.ones(len(moved))
        rows = slope(still, one)[:, None] * by_values * slope_of_own
        rows = rows.at[jnp.arange(len(moved)), moved].set(slope(one, still))
        found = found.at[moved].set(jnp.where(few.fixed, few.value, values))
        slopes = slopes.at[moved].set(jnp.where(jnp.asarray(few.fixed)[:, None], 0.0, rows))
    slopes = jnp.zeros((len(own), len(z))).at[:, t.source].add(jnp.where(free, slopes[t.leader], 0.0))
    return found[t.leader], slopes


@kept()
def _values(s: Structure, t: Table, z: Array) -> dict[str, Array]:
    return s.named(_flat(s, t, z))


@kept()
def _values_of_many(s: Structure, t: Table, z: Array) -> dict[str, Array]:
    return jax.vmap(lambda z: s.named(_flat(s, t, z)))(z)


_flat_jitted = Kept(_flat)


@kept()
def _values_and_slopes(s: Structure, t: Table, z: Array) -> tuple[dict[str, Array], Array]:
    found, slopes = _flat_and_slopes(s, t, z)
    return s.named(found), slopes


@kept()
def values_and_slopes_of_many(s: Structure, t: Table, points: Array) -> tuple[dict[str, Array], Array]:
    """Physical values by name and their slopes at many points (M, F), with a leading axis M."""
    return jax.vmap(lambda z: _values_and_slopes(s, t, z))(points)


@kept()
def _free(s: Structure, t: Table, values: Array) -> Array:
    """The coordinate that every entry would have by itself, (P,); inverse of :func:`_flat`."""
    kept = jnp.clip(values, TINY_ODDS, 1 - INSIDE)
    logarithm = jnp.where(t.odds, jnp.log(kept) - jnp.log1p(-kept), jnp.log(jnp.maximum(values - t.offset, LEAST)))
    linear = ndtri(jnp.clip((values - t.lower) / (t.upper - t.lower), INSIDE, 1 - INSIDE))
    median = jnp.asarray(t.median)
    if len(s.moved):
        median = median.at[s.moved].add(s.shifts(values, t.offset))
    return jnp.where(t.odds | t.logarithmic, _standard_normal(logarithm, t, median), linear)


@kept()
def _free_of_many(s: Structure, t: Table, values: Array) -> Array:
    return jax.vmap(lambda flat: _free(s, t, flat))(values)


@cache
def layout_of(
    model: Reflectance,
    priors: Priors = PRIORS,
    bands: Bands = MERL,
    constraints: tuple[tuple[str, Constraint], ...] = (),
) -> Layout:
    """The flat vector of everything that this model leaves to be fitted.

    Raises:
        ValueError: a parameter is declared so that it has no prior, or a prior that its bounds contradict; a constraint
            that contradicts its declaration, or leaves nothing to fit.
    """
    for q in model.parameters:
        if q.scale == "log" and q.prior is None and not hasattr(priors, q.quantity or q.name):
            raise ValueError(f"{model}: {q.name} has a logarithmic scale, but no prior: declare one")
        if q.quantity == ODDS and (q.lower, q.upper) != (0.0, 1.0):
            raise ValueError(f"{model}: {q.name} has odds: its bounds should be 0 and 1")
        if q.alike and not (q.per_channel and q.scale == "log"):
            raise ValueError(f"{model}: {q.name} is alike in all channels: it should be per channel, of a log scale")
    declared = {q.name: q for q in model.parameters}
    for name, given in constraints:
        if name not in declared:
            raise ValueError(f"{model} has no parameter {name}: it has {', '.join(declared)}")
        refuse_contradictions(declared[name], given)
        wanted = (1, len(bands)) if declared[name].per_channel else (1,)
        if given.fixed is not None and len(given.fixed) not in wanted:
            needed = f"one value, or one for each of the {wanted[-1]} channels" if len(wanted) > 1 else "one value"
            raise ValueError(f"{name} should be fixed at {needed}, not at {len(given.fixed)}")
    found = Layout(model, priors, bands, constraints)
    if not found.size:
        raise ValueError(f"{model}: all of its parameters are fixed, and nothing is left to fit")
    t = found.table
    away = np.maximum(t.low - t.median, t.median - t.high) / t.deviation
    for k in np.flatnonzero((away > FARTHEST) & (t.odds | t.logarithmic) & ~t.fixed):
        q = found.entries[k]
        prior = f"{np.exp(t.median[k]):g} times or over {np.exp(t.deviation[k]):g}"
        raise ValueError(
            f"{q.name} has a prior of {prior}, of which nothing is between its bounds, {q.lower:g} and {q.upper:g}: "
            "set others, or another prior"
        )
    return found


def refuse_contradictions(q: Parameter, given: Constraint) -> None:
    """Raises ValueError where a constraint cannot be kept, whatever the channels."""
    lower, upper = (own if asked is None else asked for own, asked in ((q.lower, given.lower), (q.upper, given.upper)))
    if not q.lower <= lower < upper <= q.upper:
        raise ValueError(
            f"{q.name} cannot be bounded by {lower:g} and {upper:g}: the lower bound comes first, and both lie within "
            f"those of the model, {q.lower:g} and {q.upper:g}"
        )
    for what, values in (("fixed", given.fixed or ()), ("started", () if given.start is None else (given.start,))):
        if outside := [x for x in values if not lower <= x <= upper]:
            raise ValueError(f"{q.name} cannot be {what} at {outside[0]:g}: its bounds are {lower:g} and {upper:g}")
    if given.prior is not None and q.scale != "log":
        instead = "set priors.odds" if q.quantity == ODDS else "set its bounds"
        raise ValueError(f"{q.name} has no log-normal prior that could be set: {instead}")
    if given.tied and not q.per_channel:
        raise ValueError(f"{q.name} is the same in all channels already: leave tied out")
