"""The objective of HP17 Eq. 56-58 as residuals over the file's own bins, and its normal equations, summed in blocks.

    E^2 = sum over bins and channels of w (measured - p(i,o) predicted)^2

w is the quadrature weight of the fitting measure times the compressive weight of the measured value. The model is
reciprocal and MERL's bins phi_d and pi - phi_d hold the same pair of directions with i and o exchanged: their two
measurements face one prediction, and are replaced without loss by their weighted mean (``merl_io.samples``).

Nothing of the size bins x parameters is ever held: blocks of theta_h rows add up the matrix (J|r)^T (J|r).
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..merl_io.binary import Measurement
from ..merl_io.grid import merl_grid
from ..merl_io.samples import Samples, fold
from ..model import two_scale
from ..model.acquisition import grazing_log_base
from ..model.effects import Effects
from ..model.geometry import Geometry
from ..model.parameters import WAVELENGTHS_UM
from ..model.two_scale import Factor, Setting, Values
from .transforms import layout_of

T = TypeVar("T")
BLOCK_BINS = 90_000  # bins (without channels) of a block: its 30-odd intermediates of 3 channels take 65 MB
BEND = 1.4  # exponent of the compressive weight, HP17 after Eq. 58


class Problem(eqx.Module):
    """Samples of one material as arrays in blocks of theta_h rows, leading axis the block; one shape for all files.

    Attributes:
        geometry: theta_h (N, h, 1, 1), theta_d (N, 1, D, 1), cosines (N, h, D, P).
        log_base: of the grazing loss, (N, h, D, P); 0 where invalid. value, weight: (N, C, h, D, P), weights summing
            with the squared values to one. scatter: cost of folding, relative to the same unit.
    """

    geometry: Geometry
    log_base: Array
    value: Array
    weight: Array
    scatter: Array


def compressive_weight(value: np.ndarray, median: np.ndarray) -> np.ndarray:
    """w_C of HP17 Eq. 57-58, dimensionless in (0, 1]: 1 for dark bins, falling as the power 1.4 of bright ones.

    Args:
        value: measured BRDF >= 0. median: the cos-weighted median to compare with (broadcasts).
    """
    x = np.maximum(value / median, 1e-12)
    return (-np.expm1(-np.log(2.0) * x) / (np.log(2.0) * x)) ** BEND


def cos_weighted_median(value: np.ndarray, cos_i: np.ndarray) -> float:
    """Median of a channel's values with weights cos_i (HP17 after Eq. 58)."""
    order = np.argsort(value)
    cumulated = np.cumsum(cos_i[order])
    return float(value[order][np.searchsorted(cumulated, cumulated[-1] / 2)])


def weighted_samples(measurement: Measurement) -> Samples:
    """Folded samples of a file with the weights of Eq. 56: quadrature weight of the bin times w_C of its value.

    Bins that the horizon cuts with their centre below it are left out: the model is 0 there. Each channel is compared
    with its own median, so that no channel is fitted at the expense of another.
    """
    grid = merl_grid()
    weight = np.zeros(measurement.values.shape)
    used = measurement.valid & grid.above & (grid.weight > 0)
    for plane, out in zip(measurement.values, weight, strict=True):
        if not used.any():
            break
        median = max(cos_weighted_median(plane[used], np.maximum(grid.cos_i[used], 0.0)), 1e-9)
        out[used] = grid.weight[used] * compressive_weight(plane[used], np.asarray(median))
    return fold(grid, measurement.values, weight)


def make_problem(samples: Samples) -> Problem:
    """Blocks of samples on the device, the unit of cost being the weighted energy of the measurement."""
    rows, columns, azimuths = samples.cos_i.shape
    height = next(h for h in range(max(1, BLOCK_BINS // (columns * azimuths)), 0, -1) if rows % h == 0)
    blocks = rows // height

    def split(x: np.ndarray) -> np.ndarray:
        return x.reshape((blocks, height, *x.shape[1:]))

    unit = float(np.sum(samples.weight * samples.value**2)) + samples.scatter
    geometry = Geometry(
        jnp.asarray(split(samples.theta_h[:, None, None])),
        jnp.asarray(np.broadcast_to(samples.theta_d[None, None, :, None], (blocks, 1, columns, 1))),
        jnp.asarray(split(samples.cos_i)),
        jnp.asarray(split(samples.cos_o)),
    )
    value, weight = (np.moveaxis(np.stack([split(c) for c in x]), 0, 1) for x in (samples.value, samples.weight / unit))
    used = jnp.asarray(split(samples.weight.max(0) > 0))
    log_base = jnp.where(used, grazing_log_base(geometry), 0.0)
    scatter = jnp.asarray(samples.scatter / unit)
    return Problem(geometry, log_base, jnp.asarray(value), jnp.asarray(weight), scatter)


@partial(jax.jit, static_argnums=0)
def predict(effects: Effects, values: Mapping[str, Array], problem: Problem) -> Array:
    """What the apparatus would have measured, shape (N, C, h, D, P)."""
    values = with_tables(effects, values)

    def block(b: Problem) -> Array:
        s, at, _ = _evaluate(effects, values, b)
        return two_scale.assemble(at, s)

    return jax.lax.map(block, problem_blocks(problem))


@partial(jax.jit, static_argnums=0)
def cost(effects: Effects, z: Array, problem: Problem) -> Array:
    """Cost of Eq. 56 per channel, shape (C,), without the folding scatter, relative to the measurement's energy."""
    values = with_tables(effects, layout_of(effects).values(z))

    def step(total: Array, b: Problem) -> tuple[Array, None]:
        s, at, _ = _evaluate(effects, values, b)
        return total + jnp.sum(b.weight * (b.value - two_scale.assemble(at, s)) ** 2, (1, 2, 3)), None

    channels = problem.value.shape[1]
    return jax.lax.scan(step, jnp.zeros(channels), problem_blocks(problem))[0]


# XLA's older CPU emitters compile this program in half the time and run it as fast (CONTRIBUTING.md, compile times).
@partial(jax.jit, static_argnums=0, compiler_options={"xla_cpu_use_fusion_emitters": False})
def normal_equations(effects: Effects, z: Array, problem: Problem) -> Array:
    """(J|r)^T W (J|r) per channel, shape (C, P+1, P+1): J = d predicted/dz, r = measured - predicted.

    Its last diagonal entry is :func:`cost`. A channel's rows and columns of other channels' parameters are zero, which
    is why one tangent a parameter, applied to all channels at once, gives the whole Jacobian.
    """
    layout = layout_of(effects)
    moving = _rates(effects, z)

    def step(total: Array, b: Problem) -> tuple[Array, None]:
        return total + _block_gram(effects, *moving, b), None

    groups, channels = len(layout.parameters) + 1, problem.value.shape[1]
    compact = jax.lax.scan(step, jnp.zeros((channels, groups, groups)), problem_blocks(problem))[0]
    where = [list(range(s.start, s.stop)) * (channels if s.stop - s.start == 1 else 1) for s in layout.slices.values()]
    index = np.array([*where, [layout.size] * channels]).T  # (C, groups): row of the full matrix
    full = jnp.zeros((channels, layout.size + 1, layout.size + 1))
    return full.at[np.arange(channels)[:, None, None], index[:, :, None], index[:, None, :]].set(compact)


def problem_blocks(problem: Problem) -> Problem:
    """The problem with a leading axis on every leaf, to scan over."""
    blocks = problem.value.shape[0]
    return eqx.tree_at(lambda q: q.scatter, problem, jnp.broadcast_to(problem.scatter, (blocks,)))


def _evaluate(
    effects: Effects, values: Mapping[str, Array], b: Problem
) -> tuple[Setting, dict[str, Array], dict[str, Factor]]:
    """Setting, factor values and factors of one block."""
    s, shaped, table = _parts(effects, values, b)
    return s, {name: f.evaluate(shaped, s) for name, f in table.items()}, table


def _parts(effects: Effects, values: Mapping[str, Array], b: Problem) -> tuple[Setting, Values, dict[str, Factor]]:
    s = two_scale.setting(b.geometry, effects, WAVELENGTHS_UM, b.log_base)
    return s, two_scale.shaped(values, s), two_scale.factors(effects)


def _materialised(compute: Callable[..., T], always: Array, *args: object) -> T:
    """``compute(*args)``, its results written to memory instead of being computed again by each of their users.

    XLA's CPU compiler fuses producers into every consumer and drops optimisation barriers; a conditional it must keep.
    Measured on full resolution: normal equations 0.34 s with it, 1.2 s without.
    """
    shapes = jax.eval_shape(compute, *args)
    return jax.lax.cond(always, compute, lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes), *args)


def with_tables(effects: Effects, values: Mapping[str, Array]) -> dict[str, Array]:
    """Values and what is computed from them alone, once for all blocks."""
    if "toll" not in two_scale.factors(effects):
        return {**values}
    return {**values, two_scale.TABLE: two_scale.surface_albedo(values, effects, jnp.asarray(WAVELENGTHS_UM))}


def _rates(effects: Effects, z: Array) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    """Values with tables, and by parameter the rates at which they change when all of its entries of z move."""
    layout = layout_of(effects)
    groups = np.zeros((len(layout.parameters), layout.size))
    for group, where in zip(groups, layout.slices.values(), strict=True):
        group[where] = 1.0

    def values(z: Array) -> dict[str, Array]:
        return with_tables(effects, layout.values(z))

    def along(tangent: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        return jax.jvp(values, (z,), (tangent,))

    at, moved = jax.vmap(along, out_axes=(None, 0))(jnp.asarray(groups))
    by_name = {}
    for k, q in enumerate(layout.parameters):
        own = {name: moved[name][k] for name in (q.name, two_scale.TABLE) if name in moved}
        by_name[q.name] = own
    return at, by_name


def _block_gram(
    effects: Effects, values: Mapping[str, Array], rates: Mapping[str, Mapping[str, Array]], b: Problem
) -> Array:
    """Normal equations of one block, one row and column a parameter group and one for the residual."""
    layout = layout_of(effects)

    def factor_derivatives(values: Mapping[str, Array], b: Problem) -> tuple[dict[str, Array], dict[str, Array]]:
        s, shaped, table = _parts(effects, values, b)
        at, slopes = {}, {}
        for name, factor in table.items():
            tables = (two_scale.TABLE,) if name == "toll" else ()
            own = {q: shaped[q] for q in (*factor.names, *tables)}
            at[name], slope = jax.linearize(lambda own, factor=factor: factor.evaluate({**shaped, **own}, s), own)
            still = jax.tree.map(jnp.zeros_like, own)
            for q in factor.names:
                moved = {k: rates[q][k].reshape(own[k].shape) for k in (q, *tables)}
                slopes[f"{name}/{q}"] = slope({**still, **moved})
        return at, slopes

    def columns(at: dict[str, Array], slopes: dict[str, Array], b: Problem) -> list[Array]:
        s = two_scale.setting(b.geometry, effects, WAVELENGTHS_UM, b.log_base)
        root = jnp.sqrt(b.weight)
        result = []
        for q in layout.parameters:
            moving = {name: slopes[f"{name}/{q.name}"] for name in at if f"{name}/{q.name}" in slopes}
            change = lambda part: two_scale.assemble({**at, **part}, s)  # noqa: E731
            result.append(root * jax.jvp(change, ({name: at[name] for name in moving},), (moving,))[1])
        return [*result, root * (b.value - two_scale.assemble(at, s))]

    always = jnp.isfinite(b.weight[0, 0, 0, 0])
    at, slopes = _materialised(factor_derivatives, always, values, b)
    columns_ = [x.reshape(x.shape[0], -1) for x in _materialised(columns, always, at, slopes, b)]
    upper = {(i, j): jnp.sum(columns_[i] * columns_[j], -1) for i in range(len(columns_)) for j in range(i + 1)}
    count = range(len(columns_))
    return jnp.stack([jnp.stack([upper[max(i, j), min(i, j)] for j in count], -1) for i in count], -1)
