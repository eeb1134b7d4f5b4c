"""Optical constants that suit given lobes best: variable projection for starting points.

What parameters per channel do to the BRDF is simple once the shared ones are given. With reflectances that depend on
theta_d alone (F instead of Q for the diffracted light) a channel is predicted as F(theta_d; n, k) T + B, with T the
lobes of a perfect mirror and B the body, and its cost is a quadratic form of F in sums over rows of one theta_d,

    S = sum_d [|q|^2 - 2 F q.RT + F^2 |RT|^2] - 2 q.RB + 2 sum_d F RT.RB + |RB|^2,

so that hundreds of (n, k), or of (eta, albedo), are tried for the price of one evaluation of the model. A dielectric's
eta is taken alike in all channels, as matter's nearly is: a channel that starts without a lobe (eta near 1) stays so.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial, reduce
from itertools import product
from operator import add

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..model import body as bodies
from ..model import two_scale
from ..model.effects import Effects
from ..model.fresnel import fresnel, schlick
from .problem import Part, Problem
from .residuals import _evaluate, _weigh, with_tables

METALS = np.array(list(product(np.geomspace(0.05, 6, 14), np.geomspace(0.05, 12, 14))))  # (n, k) that are tried
ETAS = 1 + np.geomspace(0.15, 1.55, 10)
ALBEDOS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.35, 0.55, 0.75, 0.92])
BATCH = 64  # candidates of one call
MIRROR = {"n": jnp.zeros(3), "k": jnp.ones(3)}  # reflects everything


def project(
    effects: Effects, shared: Mapping[str, np.ndarray], problem: Problem, over: Callable[..., Iterable] = map
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Costs, about, and values of all parameters with the best of the optical constants that are tried.

    Args:
        shared: values (N,) by name of the parameters that are not per channel, of N candidates.
        over: maps a function over batches of them.

    Returns:
        costs (N,); values by name, (N,) and (N, C).
    """
    count = len(next(iter(shared.values())))
    padded = {name: np.pad(x, (0, -count % BATCH), "edge") for name, x in shared.items()}
    batches = [{name: x[k : k + BATCH] for name, x in padded.items()} for k in range(0, count, BATCH)]
    done = list(over(partial(_project, effects, problem), batches))
    costs, found = (jax.tree.map(lambda *x: np.concatenate(x)[:count], *each) for each in zip(*done, strict=True))
    return costs, {**shared, **found}


def _project(
    effects: Effects, problem: Problem, shared: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Of one batch, and only what is per channel."""
    found = [jax.tree.map(np.asarray, _sums(effects, shared, part)) for part in problem.parts]
    squares, products, energy, *under = (reduce(add, each) for each in zip(*found, strict=True))
    cos_d = tuple(np.cos(np.asarray(problem.parts[0].directions.geometry.theta_d[0, 0, :, 0])).tolist())
    tried = METALS if effects.index == "complex" else np.stack([ETAS, np.zeros_like(ETAS)], 1)
    reflectance = _reflectances(effects, tuple(map(tuple, tried.tolist())), cos_d)  # (tried, D)
    lobes = energy[..., None] - 2 * products @ reflectance.T + squares @ (reflectance**2).T  # (N, C, tried)
    rest = float(np.sum(np.asarray(problem.rest)))
    costs = lobes[..., None]  # (N, C, tried, albedo)
    if under:
        crossed, alone = under
        if len(tried) != crossed.shape[2]:  # a body that does not know of the index
            crossed, alone = (np.repeat(x, len(tried), 2) for x in (crossed, alone))
        costs = costs + 2 * np.einsum("ed,ncead->ncea", reflectance, crossed, optimize=True) + alone
    each = costs.min(-1)  # (N, C, tried)
    best = np.argmin(each, -1) if effects.index == "complex" else np.argmin(each.sum(1), -1)[:, None].repeat(3, 1)
    chosen = np.take_along_axis(costs, best[..., None, None], 2)[:, :, 0]  # (N, C, albedo)
    albedo = {"albedo": ALBEDOS[np.argmin(chosen, -1)]} if under else {}
    index = {"n": METALS[best, 0], "k": METALS[best, 1]} if effects.index == "complex" else {"eta": ETAS[best]}
    return chosen.min(-1).sum(-1) + rest, index | albedo


@cache
def _reflectances(effects: Effects, tried: tuple[tuple[float, float], ...], cos_d: tuple[float, ...]) -> np.ndarray:
    """F of every index that is tried at every theta_d."""
    n, k = jnp.asarray(tried).T[:, :, None]
    return np.asarray((fresnel if effects.fresnel == "exact" else schlick)(jnp.asarray(cos_d), n, k))


@partial(jax.jit, static_argnums=0)
def _sums(effects: Effects, shared: Mapping[str, Array], part: Part) -> tuple[Array, ...]:
    """|RT|^2 and q.RT per channel and theta_d, |q|^2 per channel; and for a body RT.RB, (C, eta, albedo, D), and
    |RB|^2 - 2 q.RB, (C, eta, albedo), with one eta for all where it does not matter; leading axis N, candidates."""
    return jax.lax.map(lambda values: _sums_of_one(effects, values, part), shared)


def _sums_of_one(effects: Effects, shared: Mapping[str, Array], part: Part) -> tuple[Array, ...]:
    mirror = replace(effects, body="none", index="complex", colour="fresnel", split="printed")
    values = with_tables(mirror, {**shared, **MIRROR}, part.directions)
    body = {"plastic": bodies.plastic, "subsurface": bodies.subsurface}.get(effects.body)

    def block(b: Part) -> tuple[Array, ...]:
        s, at, _ = _evaluate(mirror, values, b.directions)
        lobes = _weigh(b.root, two_scale.assemble(at, s))
        sums = jnp.sum(lobes**2, (1, 3)), jnp.sum(lobes * b.target, (1, 3)), jnp.sum(b.target**2, (1, 2, 3))
        if effects.body == "none":
            return sums
        seen = jnp.where(s.above, 1.0, 0.0)

        def under(eta: Array, albedo: Array) -> tuple[Array, Array]:
            g = s.geometry
            brdf = body(g.cos_i, g.cos_o, eta, albedo) if body else bodies.lambert(albedo)
            weighed = _weigh(b.root, jnp.broadcast_to(brdf * seen, b.target.shape))
            alone = jnp.sum(weighed**2, (1, 2, 3)) - 2 * jnp.sum(weighed * b.target, (1, 2, 3))
            return jnp.sum(lobes * weighed, (1, 3)), alone

        over_albedos = jax.vmap(under, in_axes=(None, 0), out_axes=1)
        etas = jnp.asarray(ETAS if body else ETAS[:1])
        return *sums, *jax.vmap(over_albedos, in_axes=(0, None), out_axes=1)(etas, jnp.asarray(ALBEDOS))

    return jax.tree.map(lambda x: jnp.sum(x, 0), jax.lax.map(block, part))
