"""Constants per channel that suit given lobes best: variable projection for starting points.

What parameters per channel do to the BRDF is simple once the shared ones are given
(:class:`.hints.LinearParameters`). With R the weights of a row of azimuths, T the lobes of facets that
reflect everything, F(theta_d) the reflectance of the facets and B the body, a channel's cost is a quadratic form of F
in sums over rows of one theta_d,

    S = sum_d [|q|^2 - 2 F q.RT + F^2 |RT|^2] - 2 q.RB + 2 sum_d F RT.RB + |RB|^2,

so that hundreds of constants and albedos are tried for the price of one evaluation of the model. What is alike in all
channels, as a dielectric's index nearly is, is taken alike: a channel that starts without a lobe (eta near 1) stays so.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...model.reflectance import Reflectance
from ..support.kept import kept
from .hints import LinearParameters, hints_of
from .problem import Part, Problem
from .residuals import evaluate_block, weigh, with_tables
from .transforms import Layout

ALBEDOS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.35, 0.55, 0.75, 0.92])
BATCH = 64  # candidates of one call
T = TypeVar("T")
BodyTried = tuple[Callable[..., Array], tuple[float, ...]]
"""A body, and the constants that it is tried with: one, of no meaning, where it does not depend on any."""


class Sums(NamedTuple):
    """What costs are quadratic forms of, for N candidates, C channels and D angles theta_d.

    Attributes:
        squares, products: |RT|^2 and q.RT, (N, C, D). energy: |q|^2, (C,).
        crossed, alone: by body RT.RB, (N, C, K, A, D), and |RB|^2 - 2 q.RB, (C, K, A), for K constants that the body
            is tried with and A albedos.
    """

    squares: np.ndarray
    products: np.ndarray
    energy: np.ndarray
    crossed: dict[BodyTried, np.ndarray]
    alone: dict[BodyTried, np.ndarray]


def project(
    layouts: Sequence[Layout],
    shared: Mapping[str, np.ndarray],
    problem: Problem,
    over: Callable[..., Iterable] = map,
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Costs, about, and values of all parameters with the best of the constants that are tried.

    Args:
        layouts: of models with the same lobes, which are evaluated once for all.
        shared: values (N,) by name of the parameters that are not per channel, of N candidates.
        over: maps a function over batches of them.

    Returns:
        for every layout costs (N,), and values by name, (N,) and (N, C).
    """
    parted = [_linear(layout) for layout in layouts]
    lobes, fixed = parted[0].lobes, parted[0].fixed
    count = len(next(iter(shared.values())))
    padded = {name: np.pad(x, (0, -count % BATCH), "edge") for name, x in shared.items()}
    batches = [{name: x[k : k + BATCH] for name, x in padded.items()} for k in range(0, count, BATCH)]
    tried = tuple(dict.fromkeys(of for of in map(_body_of, parted) if of is not None))
    bodies = [_bodies(tried, part) for part in problem.parts]
    energy = sum(np.sum(np.asarray(part.target, float) ** 2, (0, 2, 3, 4)) for part in problem.parts)
    alone = _added([sums for _, sums in bodies])

    def of_batch(batch: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
        parts = [_sums(lobes, fixed, batch, part, own) for part, (own, _) in zip(problem.parts, bodies, strict=True)]
        squares, products, crossed = _added(parts)
        sums = Sums(
            squares,
            products,
            np.asarray(energy),
            dict(zip(tried, crossed, strict=True)),
            dict(zip(tried, alone, strict=True)),
        )
        return [_project(each, problem, sums, batch, layouts[0].bands.wavelengths_um) for each in parted]

    done = list(over(of_batch, batches))
    joined = [jax.tree.map(lambda *x: np.concatenate(x)[:count], *each) for each in zip(*done, strict=True)]
    return [(costs, {**shared, **found}) for costs, found in joined]


def _linear(layout: Layout) -> LinearParameters:
    """What separates the channels; of constants those are tried that are neither fixed elsewhere nor out of bounds."""
    found = hints_of(layout.model).linear
    if found is None:
        raise ValueError(f"the channels of {layout.model} are not separated")
    constants = {name: np.array(x) for name, x in found.constants.items()}
    declared = {q.name: q for q in layout.parameters}
    for name, each in layout.constraints:
        if name in constants:
            constants[name] = np.clip(constants[name], declared[name].lower, declared[name].upper)
            if each.fixed is not None and len(each.fixed) == 1:
                constants[name] = np.full(len(constants[name]), each.fixed[0])
    kept = np.unique(np.array(list(constants.values())), axis=1)
    same = kept.shape[1] == len(next(iter(constants.values())))
    return found if same else found._replace(constants=dict(zip(constants, kept, strict=True)))


def _body_of(parted: LinearParameters) -> BodyTried | None:
    if parted.body is None:
        return None
    return parted.body, tuple(parted.constants[parted.body_constant].tolist()) if parted.body_constant else (1.0,)


def _added(parts: Sequence[T]) -> T:
    """Trees of arrays, added up in NumPy."""
    return jax.tree.map(lambda *x: np.sum(x, 0), *parts)


def _project(
    parted: LinearParameters,
    problem: Problem,
    sums: Sums,
    shared: Mapping[str, np.ndarray],
    wavelengths_um: tuple[float, ...],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The projection of one model and batch, and only what is per channel."""
    squares, products, energy = sums[:3]
    reflectance = reflectances(parted, _columns(problem), shared, wavelengths_um)
    by_angle = np.swapaxes(reflectance, -1, -2)
    lobes = -2 * products[..., None, :] @ by_angle + squares[..., None, :] @ by_angle**2
    lobes = energy[:, None] + lobes[..., 0, :]  # (N, C, tried)
    rest = float(np.sum(np.asarray(problem.rest)))
    costs = lobes[..., None]  # (N, C, tried, albedo)
    if (body := _body_of(parted)) is not None:
        crossed, alone = sums.crossed[body], sums.alone[body][None]
        if crossed.shape[2] == 1:  # a body that does not know of the constants: one product of matrices for all
            both = np.swapaxes(crossed[:, :, 0] @ by_angle, -1, -2)
        else:
            both = (crossed @ reflectance[..., None])[..., 0]
        costs = costs + 2 * both + alone
    each = costs.min(-1)  # (N, C, tried)
    together = np.argmin(each.sum(1), -1)[:, None].repeat(each.shape[1], 1)
    best = together if parted.alike else np.argmin(each, -1)
    chosen = np.take_along_axis(costs, best[..., None, None], 2)[:, :, 0]  # (N, C, albedo)
    found = {name: x[best] for name, x in parted.constants.items()}
    if body is not None:
        found[parted.albedo] = ALBEDOS[np.argmin(chosen, -1)]
    return chosen.min(-1).sum(-1) + rest, found


def _columns(problem: Problem) -> np.ndarray:
    """cos(theta_d) of every column, (D,): of scattered directions, which it is alike for, the mean."""
    cosines = np.cos(np.asarray(problem.parts[0].directions.geometry.theta_d)[0, :, :, 0])
    return cosines[0] if len(cosines) == 1 else cosines.mean(0)


def reflectances(
    parted: LinearParameters, cos_d: np.ndarray, shared: Mapping[str, np.ndarray], wavelengths_um: tuple[float, ...]
) -> np.ndarray:
    """F of all constants that are tried at every theta_d: (1, 1, K, D), or (N, C, K, D) of films.

    Args:
        shared: values (N,) of N candidates.
    """
    constants = {name: x[:, None] for name, x in parted.constants.items()}
    if parted.shared:
        own = {name: shared[name] for name in parted.shared}
        return np.asarray(_of_candidates(parted.reflectance, cos_d, constants, own, np.array(wavelengths_um)))
    return np.asarray(_of_constants(parted.reflectance, cos_d, constants))[None, None]


@kept()
def _of_constants(reflectance: Callable[..., Array], cos_d: Array, constants: Mapping[str, Array]) -> Array:
    return reflectance(cos_d, **constants)


@kept()
def _of_candidates(
    reflectance: Callable[..., Array],
    cos_d: Array,
    constants: Mapping[str, Array],
    shared: Mapping[str, Array],
    wavelengths_um: Array,
) -> Array:
    return jax.lax.map(
        lambda own: reflectance(cos_d, **constants, **own, wavelengths_um=wavelengths_um), dict(shared), batch_size=8
    )


@kept()
def _bodies(tried: tuple[BodyTried, ...], part: Part) -> tuple[list[Array], list[Array]]:
    """RB of bodies, (N, C, h, D, K, constants, albedos) by blocks, and |RB|^2 - 2 q.RB, (C, constants, albedos)."""

    def block(b: Part) -> tuple[list[Array], list[Array]]:
        g = b.directions.geometry
        above = (g.cos_i > 0) & (g.cos_o > 0)
        cos_i, cos_o = (jnp.where(above, cos, 1.0) for cos in (g.cos_i, g.cos_o))
        weighed, alone = [], []
        for formula, constants in tried:

            def of(constant: Array, albedo: Array, formula: Callable[..., Array] = formula) -> Array:
                brdf = jnp.where(above, formula(cos_i, cos_o, constant, albedo), 0.0)
                return weigh(b.root, jnp.broadcast_to(brdf, b.target.shape))

            over_albedos = jax.vmap(of, (None, 0), -1)
            weighed.append(jax.vmap(over_albedos, (0, None), -2)(jnp.asarray(constants), jnp.asarray(ALBEDOS)))
            alone.append(jnp.sum(weighed[-1] * (weighed[-1] - 2 * b.target[..., None, None]), (1, 2, 3)))
        return weighed, alone

    weighed, alone = jax.lax.map(block, part)
    return weighed, [jnp.sum(x, 0) for x in alone]


@kept(2)
def _sums(
    model: Reflectance,
    fixed: tuple[tuple[str, float], ...],
    shared: Mapping[str, Array],
    part: Part,
    bodies: list[Array],
) -> tuple[Array, Array, list[Array]]:
    """|RT|^2, q.RT and RT.RB of one part, for all candidates."""
    perfect = {name: jnp.full(1, x) for name, x in fixed}

    def of_one(shared: Mapping[str, Array]) -> tuple[Array, Array, list[Array]]:
        values = with_tables(model, {**shared, **perfect}, part.directions)

        def block(given: tuple[Part, list[Array]]) -> tuple[Array, Array, list[Array]]:
            b, below = given
            lobes = weigh(b.root, evaluate_block(model, values, b.directions))  # (C, h, D, K)
            crossed = [jnp.einsum("chdk,chdkea->cead", lobes, x) for x in below]
            return jnp.sum(lobes**2, (1, 3)), jnp.sum(lobes * b.target, (1, 3)), crossed

        return jax.tree.map(lambda x: jnp.sum(x, 0), jax.lax.map(block, (part, bodies)))

    return jax.lax.map(of_one, shared)
