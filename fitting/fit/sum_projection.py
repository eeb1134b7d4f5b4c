"""Constants per channel and shares that suit given lobes of a sum: non-negative least squares for starting points."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...model.measured import material_of, with_material
from ...model.reflectance import Reflectance, factor_values, shaped
from ...model.sum import THROUGH, Sum
from ..support.kept import kept
from .hints import LinearParameters, hints_of
from .problem import Part, Problem
from .projection import ALBEDOS, BATCH, reflectances
from .residuals import setting_of, weigh, with_tables
from .transforms import Layout


def project_sum(
    layout: Layout, shared: Mapping[str, np.ndarray], problem: Problem, over: Callable[..., Iterable] = map
) -> dict[str, np.ndarray]:
    """Values by name, (N,) and (N, C), of N candidates with the constants and shares that suit them.

    Lobes of facets that reflect everything, and the body, are columns; no weight is negative (Lawson & Hanson 1974,
    here by trying all sets of columns). A surface's share is that of its weight, and its constants are those whose
    reflectance at normal incidence is nearest to what is left; a body is as bright as one of albedo 1/2, twice.
    """
    material = material_of(layout.model)
    assert isinstance(material, Sum)
    surfaces = _parts(material)
    model = with_material(layout.model, _perfect(material))
    fixed = {f"{name}{each.suffix}": x for each in surfaces for name, x in each.linear.fixed}
    fixed |= {q.name: 0.5 for q in model.parameters if q.name.startswith("share_")}
    fixed = {q.name: fixed[q.name] for q in model.parameters if q.name in fixed}
    body = surfaces[0].linear.body
    count = len(next(iter(shared.values())))
    padded = {name: np.pad(x, (0, -count % BATCH), "edge") for name, x in shared.items() if name not in fixed}
    batches = [{name: x[k : k + BATCH] for name, x in padded.items()} for k in range(0, count, BATCH)]
    suffixes = tuple(each.suffix for each in surfaces)

    def of_batch(batch: Mapping[str, np.ndarray]) -> np.ndarray:
        return np.sum([_grams(model, tuple(fixed.items()), suffixes, body, batch, part) for part in problem.parts], 0)

    grams = np.concatenate([np.asarray(x) for x in over(of_batch, batches)])[:count]  # (N, C, K + 1, K + 1)
    weights = _non_negative(grams)
    last = len(surfaces) - 1
    shares = [0.5 ** min(last - k + 1, last) for k in range(last + 1)]  # of surfaces whose every share is 1/2
    weights = weights * np.array([*shares, *([] if body is None else [0.5])])
    found = {**shared, **_constants(surfaces, weights, shared, layout.bands.wavelengths_um)}
    if body is not None:
        found[surfaces[0].linear.albedo] = np.clip(weights[..., -1], ALBEDOS[0], ALBEDOS[-1])
    for q in (q for q in layout.parameters if q.name in found):
        found[q.name] = np.clip(found[q.name], q.lower, q.upper)
    return found


def _constants(
    surfaces: Sequence["SumPart"],
    weights: np.ndarray,
    shared: Mapping[str, np.ndarray],
    wavelengths_um: tuple[float, ...],
) -> dict[str, np.ndarray]:
    """Shares (N,) and constants (N, C) by name, from the weights (N, C, K) of surfaces of which the base is first."""
    found, left = {}, np.ones(len(weights))
    for k in range(len(surfaces) - 1, -1, -1):
        (linear, suffix), weight, share = surfaces[k], weights[..., k], np.ones(len(weights))
        if k:
            below = weights[..., : k + 1].sum(-1).mean(1)
            share = found[f"share{suffix}"] = np.clip(weight.mean(1) / np.maximum(below, 1e-9), 0.02, 0.98)
        reflectance = weight / np.maximum(left * share, 1e-9)[:, None]
        left = left * (1 - share)
        own = {name: shared[f"{name}{suffix}"] for name in linear.shared}
        tried = reflectances(linear, np.ones(1), own, wavelengths_um)[..., 0]
        if linear.alike:
            reflectance = np.broadcast_to(reflectance.mean(1, keepdims=True), reflectance.shape)
        nearest = np.argmin(abs(tried - reflectance[..., None]), -1)
        found |= {f"{name}{suffix}": x[nearest] for name, x in linear.constants.items()}
    return found


class SumPart(NamedTuple):
    """A part of a sum: how its channels are separated, and what its names end in."""

    linear: LinearParameters
    suffix: str


def _parts(model: Reflectance) -> list[SumPart]:
    """Parts of a sum, the base first; a coat has no constant of its own in a channel."""
    if not isinstance(model, Sum):
        linear = hints_of(model).linear
        assert linear is not None
        return [SumPart(linear, "")]
    linear = hints_of(model.top).linear
    assert linear is not None
    return _parts(model.base) + ([] if model.coated else [SumPart(linear, model.suffix)])


def _perfect(model: Reflectance) -> Reflectance:
    """The same with facets that reflect everything, but for those of a coat."""
    if not isinstance(model, Sum):
        linear = hints_of(model).linear
        assert linear is not None
        return linear.lobes
    return replace(model, base=_perfect(model.base), top=model.top if model.coated else _perfect(model.top))


@kept(4)
def _grams(
    model: Reflectance,
    fixed: tuple[tuple[str, float], ...],
    suffixes: tuple[str, ...],
    body: Callable[..., Array] | None,
    shared: Mapping[str, Array],
    part: Part,
) -> Array:
    """Products of columns and of what is left by a coat, (N, C, K + 1, K + 1), the lobes' columns first."""
    perfect = {name: jnp.full(1, x) if not name.startswith("share_") else jnp.asarray(x) for name, x in fixed}

    def of_one(shared: Mapping[str, Array]) -> Array:
        values = with_tables(model, {**shared, **perfect}, part.directions)

        def block(b: Part) -> Array:
            s = setting_of(b.directions)
            at = factor_values(model, shaped(model, values, s), s)
            lobes, shape = model.assemble(at, s), b.target.shape

            def column(brdf: Array) -> Array:
                return weigh(b.root, jnp.broadcast_to(jnp.where(s.above, brdf, 0.0), shape))

            named = dict.fromkeys(suffixes, jnp.zeros(()))
            coat = jnp.zeros(())
            for name, x in lobes.sharp.items():
                suffix = name.removeprefix(name.split("_")[0])
                x = x if lobes.common is None else lobes.common * x
                if suffix in named:
                    named[suffix] = named[suffix] + x
                else:
                    coat = coat + x
            columns = [column(x) for x in named.values()]
            if body is not None:
                half = jnp.full((shape[0], 1, 1, 1), 0.5)
                below = body(s.geometry.cos_i, s.geometry.cos_o, jnp.asarray(1.5), half)
                columns.append(column(below * at.get(THROUGH, 1.0)))
            rows = jnp.stack([*columns, b.target - column(coat)])
            return jnp.einsum("ichdk,jchdk->cij", rows, rows)

        return jnp.sum(jax.lax.map(block, part), 0)

    return jax.lax.map(of_one, shared)


def _non_negative(grams: np.ndarray) -> np.ndarray:
    """Least squares with weights of at least 0, from products of columns and target: weights (N, C, K)."""
    count = grams.shape[-1] - 1
    best, weights = grams[..., -1, -1].copy(), np.zeros((*grams.shape[:2], count))
    for size in range(1, count + 1):
        for chosen in map(list, combinations(range(count), size)):
            products, right = grams[..., chosen, :][..., chosen], grams[..., chosen, -1]
            ridge = 1e-9 * np.trace(products, axis1=-2, axis2=-1)[..., None, None] * np.eye(size) + 1e-300 * np.eye(
                size
            )
            found = np.linalg.solve(products + ridge, right[..., None])[..., 0]
            cost = grams[..., -1, -1] - np.sum(found * right, -1)
            better = np.all(found >= 0, -1) & (cost < best)
            best = np.where(better, cost, best)
            own = np.zeros_like(weights)
            own[..., chosen] = found
            weights = np.where(better[..., None], own, weights)
    return weights
