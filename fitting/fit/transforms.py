"""Between the bounded parameters of a material and the free coordinates in which they are fitted and sampled.

Free coordinates z are those in which the prior is standard normal: every parameter given those before it. A log-normal
prior of median m and factor f, cut at the bounds, is

    log(value - offset) = log m + shift + log f Phi^-1(A + Phi(z) (B - A)),    A, B = Phi(bound's distance / log f),

a uniform one lower + Phi(z) (upper - lower); an albedo's odds, albedo / (1 - albedo), are log-normal. The shifts make
coordinates of what the data show: the half width of the lobe instead of beta, given p; the height that diffracts into
directions that exist instead of sigma_s, given b and c; and the ratio of what channels have alike (eta - 1) to that of
the middle channel in the others.

What a user fixes has no coordinate, and what is tied has that of the middle channel.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal

import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from ...merl_io.bands import MERL, Bands
from ...model.measured import material_of, with_material
from ...model.parameters import Parameter
from ...model.priors import PRIORS, Constraint, LogNormal, Priors
from ...model.reflectance import Reflectance
from .coordinates import ENDLESS, Numbers, Structure, Table, coordinates, flat_and_slopes

ODDS = "odds"  # quantity of what lies between 0 and 1 and may be a few thousandths
Kind = Literal["free", "fixed", "tied"]
FARTHEST = 30.0  # standard deviations of a prior from its bounds: nothing of it is left there


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

    def values(self, z: ArrayLike) -> dict[str, Numbers]:
        """Physical values by name at z (..., F): (...), and (..., C) for parameters per channel."""
        return self.structure.named(self.flat(z))

    def flat(self, z: ArrayLike) -> Numbers:
        """Physical values, shape (..., P)."""
        return self._flat_and_slopes(z)[0]

    def slopes(self, z: ArrayLike) -> Numbers:
        """d value_i / d z_j, (..., P, F)."""
        return self._flat_and_slopes(z)[1]

    def values_and_slopes(self, z: ArrayLike) -> tuple[dict[str, Numbers], Numbers]:
        """Both in one call."""
        flat, slopes = self._flat_and_slopes(z)
        return self.structure.named(flat), slopes

    def _flat_and_slopes(self, z: ArrayLike) -> tuple[Numbers, Numbers]:
        with np.errstate(all="ignore"):
            return flat_and_slopes(self.structure, self.table, z if isinstance(z, Tracer) else np.asarray(z, float))

    def held(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Values by name, of one point or many, with those that are fixed as they are fixed."""
        fixed = {name: np.squeeze(each.fixed) for name, each in self.constraints if each.fixed is not None}
        return {name: np.broadcast_to(fixed[name], np.shape(x)) if name in fixed else x for name, x in values.items()}

    def free(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        """Free coordinates of physical values, (..., F); values on or beyond a bound are moved just inside.

        Args:
            values: by name, (...), and (..., C) for parameters per channel, where a single value does for all, too.
        """
        own = {q.name: np.asarray(values[q.name], float) for q in self.parameters}
        points = np.broadcast_shapes(*(own[q.name].shape[: -1 if q.per_channel else None] for q in self.parameters))
        given = self.held({q.name: np.broadcast_to(own[q.name], (*points, *self._shape(q))) for q in self.parameters})
        inside = [np.clip(given[q.name], q.lower, q.upper).reshape(*points, -1) for q in self.parameters]
        with np.errstate(all="ignore"):
            found = coordinates(self.structure, self.table, np.concatenate(inside, -1))
        return np.asarray(found)[..., self.leads]

    def _shape(self, parameter: Parameter) -> tuple[int, ...]:
        return (len(self.bands),) if parameter.per_channel else ()

    def position(self, z: ArrayLike) -> np.ndarray:
        """Position of every entry between its bounds, in [0, 1], in the parameter's own scale."""
        found = self.values(z)
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
