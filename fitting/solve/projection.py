"""Optical constants that suit given lobes best: variable projection for starting points.

What parameters per channel do to the BRDF is simple once the shared ones are given. With reflectances that depend on
theta_d alone (F instead of Q for the diffracted light) a channel is predicted as F(theta_d; n, k) T + B, with T the
lobes of a perfect mirror and B the body, and its cost is a quadratic form of F in sums over rows of one theta_d,

    S = sum_d [|q|^2 - 2 F q.RT + F^2 |RT|^2] - 2 q.RB + 2 sum_d F RT.RB + |RB|^2,

so that hundreds of (n, k), or of (eta, albedo), are tried for the price of one evaluation of the model. A dielectric's
eta is taken alike in all channels, as matter's nearly is: a channel that starts without a lobe (eta near 1) stays so.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...model import body as bodies
from ...model.fresnel import fresnel, schlick
from ...model.measured import material_of, with_material
from ...model.reflectance import Reflectance
from ...model.two_scale import TwoScale
from ..objective.problem import Part, Problem
from ..objective.residuals import _evaluate, _weigh, with_tables

METALS = np.array(list(product(np.geomspace(0.05, 6, 14), np.geomspace(0.05, 12, 14))))  # (n, k) that are tried
ETAS = 1 + np.geomspace(0.15, 1.55, 10)
ALBEDOS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.35, 0.55, 0.75, 0.92])
BATCH = 64  # candidates of one call
MIRROR: dict[str, Any] = {"n": np.zeros(3), "k": np.ones(3)}  # reflects everything
T = TypeVar("T")
Formula = Callable[..., Array]


class Sums(NamedTuple):
    """What costs are quadratic forms of, for N candidates, C channels and D angles theta_d.

    Attributes:
        squares, products: |RT|^2 and q.RT, (N, C, D). energy: |q|^2, (C,).
        crossed, alone: by body RT.RB, (N, C, eta, albedo, D), and |RB|^2 - 2 q.RB, (C, eta, albedo), with one eta for
            all where it does not matter.
    """

    squares: np.ndarray
    products: np.ndarray
    energy: np.ndarray
    crossed: dict[str, np.ndarray]
    alone: dict[str, np.ndarray]


def project(
    models: Sequence[Reflectance],
    shared: Mapping[str, np.ndarray],
    problem: Problem,
    over: Callable[..., Iterable] = map,
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Costs, about, and values of all parameters with the best of the optical constants that are tried.

    Args:
        models: two-scale ones that differ in interface and body alone; the lobes are evaluated once for all.
        shared: values (N,) by name of the parameters that are not per channel, of N candidates.
        over: maps a function over batches of them.

    Returns:
        for every model costs (N,), and values by name, (N,) and (N, C).
    """
    kinds = [material for model in models if isinstance(material := material_of(model), TwoScale)]
    count = len(next(iter(shared.values())))
    padded = {name: np.pad(x, (0, -count % BATCH), "edge") for name, x in shared.items()}
    batches = [{name: x[k : k + BATCH] for name, x in padded.items()} for k in range(0, count, BATCH)]
    mirror = with_material(
        models[0], replace(kinds[0], body="none", index="complex", colour="fresnel", split="printed")
    )
    under = tuple(sorted({effects.body for effects in kinds} - {"none"}))
    below = [_under(under, part) for part in problem.parts]
    energy = np.sum([np.sum(np.asarray(part.target) ** 2, (0, 2, 3, 4)) for part in problem.parts], 0)
    alone = _added([x[1] for x in below])

    def of_batch(shared: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
        pairs = zip(problem.parts, below, strict=True)
        squares, products, crossed = _added([_sums(mirror, shared, part, x[0]) for part, x in pairs])
        return [_project(effects, problem, Sums(squares, products, energy, crossed, alone)) for effects in kinds]

    done = list(over(of_batch, batches))
    joined = [jax.tree.map(lambda *x: np.concatenate(x)[:count], *each) for each in zip(*done, strict=True)]
    return [(costs, {**shared, **found}) for costs, found in joined]


def _added(parts: Sequence[T]) -> T:
    """Trees of arrays, added up in NumPy."""
    return jax.tree.map(lambda *x: np.sum(x, 0), *parts)


def _project(effects: TwoScale, problem: Problem, sums: Sums) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Of one kind and batch, and only what is per channel."""
    squares, products, energy = sums[:3]
    cos_d = tuple(np.cos(np.asarray(problem.parts[0].directions.geometry.theta_d[0, 0, :, 0])).tolist())
    tried = METALS if effects.index == "complex" else np.stack([ETAS, np.zeros_like(ETAS)], 1)
    reflectance = _reflectances(effects, tuple(map(tuple, tried.tolist())), cos_d)  # (tried, D)
    lobes = energy[:, None] - 2 * products @ reflectance.T + squares @ (reflectance**2).T  # (N, C, tried)
    rest = float(np.sum(np.asarray(problem.rest)))
    costs = lobes[..., None]  # (N, C, tried, albedo)
    if effects.body != "none":
        crossed, alone = sums.crossed[effects.body], sums.alone[effects.body][None]
        if len(tried) != crossed.shape[2]:  # a body that does not know of the index
            crossed, alone = (np.repeat(x, len(tried), 2) for x in (crossed, alone))
        costs = costs + 2 * np.einsum("ed,ncead->ncea", reflectance, crossed, optimize=True) + alone
    each = costs.min(-1)  # (N, C, tried)
    best = np.argmin(each, -1) if effects.index == "complex" else np.argmin(each.sum(1), -1)[:, None].repeat(3, 1)
    chosen = np.take_along_axis(costs, best[..., None, None], 2)[:, :, 0]  # (N, C, albedo)
    albedo = {} if effects.body == "none" else {"albedo": ALBEDOS[np.argmin(chosen, -1)]}
    index = {"n": METALS[best, 0], "k": METALS[best, 1]} if effects.index == "complex" else {"eta": ETAS[best]}
    return chosen.min(-1).sum(-1) + rest, index | albedo


@cache
def _reflectances(effects: TwoScale, tried: tuple[tuple[float, float], ...], cos_d: tuple[float, ...]) -> np.ndarray:
    """F of every index that is tried at every theta_d."""
    n, k = np.array(tried).T[:, :, None]
    return np.asarray(jax.jit(fresnel if effects.fresnel == "exact" else schlick)(np.array(cos_d), n, k))


Bodies = dict[str, Array]


@partial(jax.jit, static_argnums=0)
def _under(names: tuple[str, ...], part: Part) -> tuple[Bodies, Bodies]:
    """RB of bodies, (N, C, h, D, K, eta, albedo) by blocks, and |RB|^2 - 2 q.RB, (C, eta, albedo)."""

    def block(b: Part) -> tuple[Bodies, Bodies]:
        g = b.directions.geometry
        above = (g.cos_i > 0) & (g.cos_o > 0)
        cos_i, cos_o = (jnp.where(above, cos, 1.0) for cos in (g.cos_i, g.cos_o))
        weighed, alone = {}, {}
        for name in names:
            formula = {"plastic": bodies.plastic, "subsurface": bodies.subsurface}.get(name)

            def of(eta: Array, albedo: Array, formula: Formula | None = formula) -> Array:
                brdf = formula(cos_i, cos_o, eta, albedo) if formula else bodies.lambert(albedo)
                return _weigh(b.root, jnp.broadcast_to(jnp.where(above, brdf, 0.0), b.target.shape))

            over_albedos = jax.vmap(of, (None, 0), -1)
            etas = jnp.asarray(ETAS if formula else ETAS[:1])
            weighed[name] = jax.vmap(over_albedos, (0, None), -2)(etas, jnp.asarray(ALBEDOS))
            alone[name] = jnp.sum(weighed[name] * (weighed[name] - 2 * b.target[..., None, None]), (1, 2, 3))
        return weighed, alone

    weighed, alone = jax.lax.map(block, part)
    return weighed, {name: jnp.sum(x, 0) for name, x in alone.items()}


@partial(jax.jit, static_argnums=0)
def _sums(mirror: Reflectance, shared: Mapping[str, Array], part: Part, under: Bodies) -> tuple[Array, Array, Bodies]:
    """|RT|^2, q.RT and RT.RB of one part, for all candidates."""

    def of_one(shared: Mapping[str, Array]) -> tuple[Array, Array, Bodies]:
        values = with_tables(mirror, {**shared, **MIRROR}, part.directions)

        def block(given: tuple[Part, Bodies]) -> tuple[Array, Array, Bodies]:
            b, below = given
            lobes = _weigh(b.root, _evaluate(mirror, values, b.directions))  # (C, h, D, K)
            crossed = {name: jnp.einsum("chdk,chdkea->cead", lobes, x) for name, x in below.items()}
            return jnp.sum(lobes**2, (1, 3)), jnp.sum(lobes * b.target, (1, 3)), crossed

        return jax.tree.map(lambda x: jnp.sum(x, 0), jax.lax.map(block, (part, under)))

    return jax.lax.map(of_one, shared)
