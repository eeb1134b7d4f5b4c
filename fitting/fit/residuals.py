"""Predictions, the cost of HP17 Eq. 56 and its normal equations, summed in blocks and by all cores.

Nothing of the size bins x parameters is ever held: blocks of theta_h rows add up the matrix (J|r)^T (J|r). XLA runs a
loop over blocks on one core, so every core is given its share of them by a thread of its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...model import reflectance
from ...model.materialised import materialised, true_of
from ...model.parameters import WHICH_BODY
from ...model.reads import reads
from ...model.reflectance import Factor, Reflectance, Setting
from ..support.kept import Kept, kept
from ..support.threads import side_by_side
from .coordinates import Numbers, Structure
from .hints import General, general_of
from .problem import LEAST_SHARE, Directions, Part, Problem, directions_of, shares
from .transforms import Layout


def predict(model: Reflectance, values: Mapping[str, Array], where: Directions) -> np.ndarray:
    """What the apparatus would have measured, (C, H, D, K)."""
    size = where.log_base.size
    parts = shares(where, min(size, 2 * LEAST_SHARE) if where.scattered else size)
    general = general_of(model)
    given = general.values(values)
    found = side_by_side(lambda part: np.asarray(_predict(general.model, given, part)), parts)
    blocks = np.moveaxis(np.concatenate(found), 1, 0)
    return blocks.reshape(len(blocks), -1, *blocks.shape[3:])


def predict_samples(model: Reflectance, values: Mapping[str, Array], samples: Samples | ScatteredSamples) -> np.ndarray:
    """The same for samples, of the shape of their values."""
    found = predict(model, values, directions_of(samples))
    return found[:, : samples.value.shape[1], 0, 0] if isinstance(samples, ScatteredSamples) else found


@kept()
def _predict(model: Reflectance, values: Mapping[str, Array], part: Directions) -> Array:
    values = with_tables(model, values, part)

    def block(b: Directions) -> Array:
        return evaluate_block(model, values, b)

    return jax.lax.map(block, part)


@dataclass(frozen=True)
class Objective:
    """What a fit minimises: the cost of HP17 Eq. 56 of one model and the data of one material.

    Attributes:
        layout: the model, in its free coordinates z. problem: the data.
    """

    layout: Layout
    problem: Problem

    def costs(self, values: Mapping[str, Array]) -> Array:
        """Per channel (C,), without the folding scatter, relative to the measurement's energy, of physical values."""
        return self._sum(lambda part: _cost(self.layout.model, values, part))

    def costs_of_many(self, values: Mapping[str, Numbers]) -> Array:
        """The same of N candidates, (N, C); values with a leading axis."""
        return self._sum(lambda part: _costs_of_many(self.layout.model, values, part))

    def _sum(self, of_part: Callable[[Part], Array]) -> Array:
        return reduce(add, side_by_side(of_part, self.problem.parts), self.problem.rest)

    @property
    def target(self) -> np.ndarray:
        """Of the weighted measurement, (M,)."""
        return np.concatenate([np.asarray(part.target).ravel() for part in self.problem.parts])

    def weighed(self, points: np.ndarray) -> np.ndarray:
        """Weighted predictions (N, M) at points (N, F), in the precision of the problem."""

        def found(values: Mapping[str, Array], part: Part) -> np.ndarray:
            return np.asarray(_weighted(self.layout.model, values, part)).ravel()

        parts, each = self.problem.parts, [self.layout.values(z) for z in points]
        if len(parts) == 1:  # cores share the data of a point where it is much, and points where it is not
            return np.stack(side_by_side(lambda values: found(values, parts[0]), each))
        return np.stack(
            [np.concatenate(side_by_side(lambda part, values=values: found(values, part), parts)) for values in each]
        )

    def normal_equations(self, z: ArrayLike) -> np.ndarray:
        """(J|r)^T W (J|r) per channel, shape (C, F+1, F+1): J = d predicted/dz, r = measured - predicted.

        Its last diagonal entry is :meth:`costs`. Sums are taken of derivatives by physical values. A channel's rows and
        columns of other channels' parameters are zero, which is why one tangent a parameter, applied to all channels at
        once, gives the whole Jacobian. One program does for all variants (:func:`.hints.general_of`).
        """
        values, slopes = self.layout.values_and_slopes(z)
        return self._spread_out(compact_normal_equations, values, slopes)

    def normal_equations_of_many(self, points: ArrayLike) -> np.ndarray:
        """The same at many points (M, F) in one call, shape (M, C, F+1, F+1): for few bins, where calls cost most."""
        values, slopes = self.layout.values_and_slopes(points)
        return self._spread_out(compact_normal_equations_of_many, values, slopes)

    def _spread_out(self, compute: Callable[..., Array], values: Mapping[str, Array], slopes: Array) -> np.ndarray:
        general = general_of(self.layout.model)
        given = general.values(values)
        found = side_by_side(lambda part: np.asarray(compute(general.model, given, part)), self.problem.parts)
        rows = rows_of(general)
        compact = reduce(add, found)[..., rows[:, None], rows]
        return spread_out(self.layout, np.asarray(slopes), compact, np.asarray(self.problem.rest))


@kept()
def _costs_of_many(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    return jax.lax.map(lambda v: _cost(model, v, part), values)


@kept()
def _cost(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    values = with_tables(model, values, part.directions)

    def step(total: Array, b: Part) -> tuple[Array, None]:
        residual = b.target - weigh(b.root, evaluate_block(model, values, b.directions))
        return total + jnp.sum(residual**2, (1, 2, 3), dtype=jnp.float64), None

    return jax.lax.scan(step, jnp.zeros(part.target.shape[1]), part)[0]


@kept()
def _weighted(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    values = with_tables(model, values, part.directions)
    return jax.lax.map(lambda b: weigh(b.root, evaluate_block(model, values, b.directions)), part)


def weighted_prediction(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    """What is compared with the target of ``part``, of its shape: for few bins, all blocks at once."""
    values = with_tables(model, values, part.directions)

    def block(b: Part) -> Array:
        return weigh(b.root, evaluate_block(model, values, b.directions))

    return jax.vmap(block)(part)


def weigh(root: Array, nodes: Array) -> Array:
    """Root times the values at the nodes of every row."""
    return jnp.sum(root * nodes[..., None, :], -1)


@cache
def rows_of(general: General) -> np.ndarray:
    """Which rows of the general model's normal equations are those of the special one: parameters, and the residual."""
    rows = [q.name for q in general.model.parameters]
    return np.array([*map(rows.index, general.names), len(rows)])


def products(columns: Sequence[Array]) -> Array:
    """Products of all columns (C, n) with each other, (C, G+1, G+1)."""
    matrix = jnp.stack(columns, -2).astype(jnp.float64)
    return matrix @ matrix.swapaxes(-1, -2)


def compact_equations(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    """Normal equations by physical values: one row and column a parameter, whether it is per channel or not."""
    moving = _rates(model, values, part.directions)

    def step(total: Array, b: Part) -> tuple[Array, None]:
        return total + products(_block_columns(model, *moving, b)), None

    groups, channels = len(model.parameters) + 1, part.target.shape[1]
    return jax.lax.scan(step, jnp.zeros((channels, groups, groups)), part)[0]


def _compact_of_many(model: Reflectance, values: Mapping[str, Array], part: Part) -> Array:
    """The same of M points, one after the other; values with a leading axis, but for the number of the body."""
    fixed = {name: values[name] for name in (WHICH_BODY,) if name in values}
    moving = {name: x for name, x in values.items() if name not in fixed}
    return jax.lax.map(lambda v: compact_equations(model, {**v, **fixed}, part), moving)


compact_normal_equations = Kept(compact_equations)
compact_normal_equations_of_many = Kept(_compact_of_many)


def spread_out(layout: Layout, slopes: Numbers, compact: Numbers, rest: Numbers) -> Any:  # noqa: ANN401 - as they come
    """Normal equations by free coordinates, from those with a row a parameter: arrays of NumPy or JAX.

    Args:
        slopes: of physical values by free coordinates, (..., P, F). compact: a row and column a parameter,
            (..., C, G+1, G+1). rest: what is added to each channel's cost, (C,).
    """
    place, last = places(layout.structure), np.eye(layout.size + 1)[-1]
    widened = slopes @ np.eye(layout.size, layout.size + 1)
    chain = place[..., :-1] @ widened[..., None, :, :] + place[..., -1:] * last
    return chain.swapaxes(-1, -2) @ compact @ chain + rest[:, None, None] * (last[:, None] * last)


@cache
def places(structure: Structure) -> np.ndarray:
    """Which physical value each channel's parameters are, and the residual after them, (C, G+1, P+1) of 0 and 1."""
    channels, slices, size = structure.channels, structure.slices.values(), structure.size
    where = [list(range(s.start, s.stop)) * (channels if s.stop - s.start == 1 else 1) for s in slices]
    return np.eye(size + 1)[np.array([*where, [size] * channels]).T]


def evaluate_block(model: Reflectance, values: Mapping[str, Array], b: Directions) -> Array:
    """BRDF of one block (1/sr), with tables if given."""
    s = setting_of(b)
    return reflectance.lobes_of(model, values, s).brdf(s)


def setting_of(b: Directions) -> Setting:
    """The setting of one block."""
    return reflectance.setting(b.geometry, b.bands.wavelengths_um, b.log_base)


def with_tables(model: Reflectance, values: Mapping[str, Array], where: Directions) -> dict[str, Array]:
    """Values and what all blocks look up."""
    s = setting_of(jax.tree.map(lambda x: x[0], where))
    return {**values, **{name: table(values, s) for name, table in _tables(model, where).items()}}


def _tables(model: Reflectance, where: Directions) -> Mapping[str, Factor]:
    return model.tables(where.scattered)


def _rates(
    model: Reflectance, values: Mapping[str, Array], where: Directions
) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    """Values with tables, and by parameter the rates at which they change when it moves, in all channels at once."""
    s = setting_of(jax.tree.map(lambda x: x[0], where))
    rates = {q.name: {q.name: jnp.ones_like(values[q.name])} for q in model.parameters}
    found = {}
    for name, table in _tables(model, where).items():
        own = reads(model, where.scattered).parameters[name]
        still = {q: jnp.zeros_like(values[q]) for q in own}
        tangents = [{**still, q: rates[q][q]} for q in own]

        def moved(tangent: dict[str, Array], own: Sequence[str] = own, table: Factor = table) -> tuple[Array, Array]:
            return jax.jvp(lambda own: table({**values, **own}, s), ({q: values[q] for q in own},), (tangent,))

        # not linearised: of a table that is made by a loop everything would be stored in between
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *tangents)
        found[name], slopes = jax.vmap(moved, out_axes=(None, 0))(stacked)
        for q in rates:
            rates[q][name] = slopes[own.index(q)] if q in own else jnp.zeros_like(found[name])
    return {**values, **found}, rates


def _block_columns(
    model: Reflectance, values: Mapping[str, Array], rates: Mapping[str, Mapping[str, Array]], b: Part
) -> list[Array]:
    """Of one block: a column (C, n) of the Jacobian for each parameter, and the residual."""

    def factor_derivatives(values: Mapping[str, Array], b: Directions) -> tuple[dict[str, Array], dict[str, Array]]:
        s, read = setting_of(b), reads(model, b.scattered)
        shaped = reflectance.shaped(model, values, s)
        at, slopes = {}, {}
        for name, factor in model.factors().items():
            names, tables = read.parameters[name], read.tables[name]
            own = {q: shaped[q] for q in (*names, *tables)}
            at[name], slope = jax.linearize(lambda own, factor=factor: factor({**shaped, **own}, s), own)
            still = jax.tree.map(jnp.zeros_like, own)
            for q in names:
                moved = {k: rates[q][k].reshape(own[k].shape).astype(own[k].dtype) for k in (q, *tables)}
                slopes[f"{name}/{q}"] = slope({**still, **moved})
        return at, slopes

    def columns(at: dict[str, Array], slopes: dict[str, Array], b: Part) -> list[Array]:
        s = setting_of(b.directions)
        result = []
        for q in model.parameters:
            moving = {name: slopes[f"{name}/{q.name}"] for name in at if f"{name}/{q.name}" in slopes}
            change = lambda part: model.assemble({**at, **part}, s).brdf(s)  # noqa: E731
            result.append(weigh(b.root, jax.jvp(change, ({name: at[name] for name in moving},), (moving,))[1]))
        return [*result, b.target - weigh(b.root, model.assemble(at, s).brdf(s))]

    always = true_of(b.target[0, 0, 0, 0])
    at, slopes = materialised(factor_derivatives, always, values, b.directions)
    return [x.reshape(x.shape[0], -1) for x in materialised(columns, always, at, slopes, b)]
