"""Solves of many materials as one program: as many steps at once as keep a GPU busy, each of its own material and kind.

One material's directions are too few to fill a GPU; the problems of many, stacked, are not. Normal equations and steps
are those of `residuals` and `levenberg_marquardt`, so each solve goes the way it would go by itself (costs to 1e-6,
``tests/fitting/test_stacked.py``). Kinds of one general model (:func:`.hints.general_of`) share the program: their free
coordinates are padded to the longest with some on which nothing depends. A solve that has ended makes room for the next
one, so that a batch does not take as long as its slowest. On a CPU, files one by one are faster.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...model.reflectance import Reflectance
from ..support.choices import Device
from .coordinates import Structure, Table, flat_and_slopes
from .hints import General, general_of
from .levenberg_marquardt import OFFSET_TOLERANCE, Solution, Way, advance, begin, chosen
from .problem import Directions, Part, Problem
from .residuals import compact_equations, places, rows_of
from .transforms import Layout

AT_ONCE = 1 << 22  # directions of all solves in a step: 100 MB for each number that there is of every one of them
FEW = 8  # times fewer are enough for the last ones: two widths to compile


class Stack(eqx.Module):
    """Problems of materials that share their directions.

    Attributes:
        directions: of all, in one block. root, target: of `problem.Part`, with a leading axis of materials.
        rest: per channel what no smooth function of the azimuth explains, (M, C).
    """

    directions: Directions
    root: Array
    target: Array
    rest: Array

    @property
    def size(self) -> int:
        """Directions of one material."""
        return self.directions.log_base.size


class Joined(NamedTuple):
    """A problem in one block, in NumPy: directions, and the other arrays of `Stack` for one material."""

    directions: Directions
    root: np.ndarray
    target: np.ndarray
    rest: np.ndarray


def joined(problem: Problem) -> Joined:
    """A problem on a grid as one block, as a GPU wants it."""
    blocks = jax.tree.map(lambda *x: np.concatenate([np.asarray(each) for each in x]), *problem.parts)

    def rows(x: Any, axis: int) -> np.ndarray:  # noqa: ANN401 - of NumPy, in trees that declare JAX's
        """Blocks (N, ...) one after the other along their rows, as a single one."""
        moved = np.moveaxis(x, 0, axis - 1)
        shape = (*moved.shape[: axis - 1], -1, *moved.shape[axis + 1 :])
        return np.ascontiguousarray(moved.reshape(shape))[None]

    def rows_of_all(d: Directions) -> tuple[Array, ...]:
        return d.geometry.theta_h, d.geometry.cos_i, d.geometry.cos_o, d.log_base

    whole = blocks.directions
    directions = eqx.tree_at(rows_of_all, whole, tuple(rows(x, 1) for x in rows_of_all(whole)))
    directions = eqx.tree_at(lambda d: d.geometry.theta_d, directions, whole.geometry.theta_d[:1])  # alike in all
    return Joined(directions, rows(blocks.root, 2), rows(blocks.target, 2), np.asarray(problem.rest))


def stack(problems: Sequence[Joined], device: Device) -> Stack:
    """Problems of materials on a device.

    Raises:
        ValueError: their directions differ.
    """
    first = problems[0]
    for other in problems[1:]:
        if not eqx.tree_equal(first.directions, other.directions):
            raise ValueError("materials of a batch must share their directions: grid, azimuths and precision")
    directions, *held = (
        jax.device_put(x, device) for x in (first.directions, *map(np.stack, [*zip(*problems, strict=True)][1:]))
    )
    return Stack(directions, *held)


class Start(NamedTuple):
    """Where a solve begins.

    Attributes:
        kind: number of its layout. material: of its problem. z: free coordinates of that layout.
    """

    kind: int
    material: int
    z: np.ndarray


class _Kind(NamedTuple):
    """What is compiled of a layout: its model, what its transform depends on, and the number of free coordinates."""

    model: Reflectance
    structure: Structure
    size: int

    @property
    def general(self) -> General:
        return general_of(self.model)


def solve_stacked(
    layouts: Sequence[Layout],
    problems: Stack,
    starts: Sequence[Start],
    max_steps: int = 100,
    rtol: float = 1e-5,
    offset: float = OFFSET_TOLERANCE,
    at_once: int = AT_ONCE,
) -> list[Solution]:
    """`levenberg_marquardt.solve` of many starts at once, on the device of the problems.

    Args:
        layouts: of kinds of one general model. max_steps, rtol, offset: of each solve.
        at_once: directions that a step may take.
    """
    kinds, tables, size = _compiled_of(layouts)
    widest, few = _widths(problems, at_once)
    slots = np.full(widest if len(starts) > few else few, -1)  # which start each has
    ways, nothing = _idle(problems, len(slots), size)
    begun, found = 0, {}
    while True:
        busy = np.flatnonzero(slots >= 0)
        width = len(slots) if len(busy) + len(starts) - begun > few else few
        fresh = np.arange(begun, min(len(starts), begun + width - len(busy)))
        begun += len(fresh)
        rows = np.concatenate([busy, np.zeros(width - len(busy), int)])
        slots = np.concatenate([slots[busy], fresh, np.full(width - len(busy) - len(fresh), -1)])
        if not (slots >= 0).any():
            return [found[k] for k in range(len(starts))]
        z, kind, material = np.zeros((width, size)), np.zeros(width, np.int32), np.zeros(width, np.int32)
        for slot, k in enumerate(slots[slots >= 0].tolist()):  # those that are empty come last
            kind[slot], material[slot], own = starts[k]
            z[slot, : len(own)] = own
        ways = _renewed(ways, rows, np.arange(width) >= len(busy), slots >= 0, z, nothing)
        active = slots >= 0
        going = occupied = int(active.sum())
        enough = occupied - max(1, occupied // FEW) if begun < len(starts) else few if width > few else 0
        while going > enough:
            ways = _stepped(kinds, rtol, tables, problems, ways, kind, material, offset, max_steps)
            active = np.asarray(ways.active)
            going = int(active.sum())
        ended = np.flatnonzero((slots >= 0) & ~active)
        solved = _solutions(ways, ended, [layouts[k].size for k in kind[ended]])
        found |= dict(zip(slots[ended].tolist(), solved, strict=True))
        slots[ended] = -1


def compile_ahead(
    layouts: Sequence[Layout], problems: Stack, count: int, rtol: float = 1e-5, at_once: int = AT_ONCE
) -> None:
    """Compile the steps of so many starts: `solve_stacked` would do it one width after the other, threads do not."""
    kinds, tables, size = _compiled_of(layouts)
    widest, few = _widths(problems, at_once)
    for width in (few, widest)[: 1 + (count > few)]:
        ways, _ = _idle(problems, width, size)
        number = np.zeros(width, np.int32)
        _stepped.lower(kinds, rtol, tables, problems, ways, number, number, OFFSET_TOLERANCE, 1).compile()


def _compiled_of(layouts: Sequence[Layout]) -> tuple[tuple[_Kind, ...], tuple[Table, ...], int]:
    """Kinds of layouts, their tables, and the number of coordinates of the longest."""
    kinds = tuple(_Kind(each.model, each.structure, each.size) for each in layouts)
    if len({each.general.model for each in kinds}) > 1:
        raise ValueError(f"kinds must have one general model: {', '.join(str(each.model) for each in kinds)}")
    return kinds, tuple(each.table for each in layouts), max(each.size for each in kinds)


def _widths(problems: Stack, at_once: int) -> tuple[int, int]:
    """How many solves at once: of many, and of the last ones."""
    widest = 1 << (max(1, at_once // problems.size).bit_length() - 1)
    return widest, max(1, widest // FEW)


def _idle(problems: Stack, width: int, size: int) -> tuple[Way, np.ndarray]:
    """Solves of nothing, on the device of the problems, and their normal equations."""
    nothing = np.zeros((problems.rest.shape[1], size + 1, size + 1))
    begun = begin(np.zeros((width, size)), np.broadcast_to(nothing, (width, *nothing.shape)))
    return jax.device_put(begun, problems.root.sharding), nothing


@jax.jit
def _renewed(ways: Way, rows: Array, fresh: Array, used: Array, z: Array, nothing: Array) -> Way:
    """Some solves on their way, and others at their start in the places of the rest."""
    begun = begin(z, jnp.broadcast_to(nothing, (len(z), *nothing.shape)))
    going = jax.tree.map(lambda one, other: chosen(fresh, one, other[rows]), begun, ways)
    return going._replace(active=going.active & used)


@partial(jax.jit, static_argnums=(0, 1))
def _stepped(
    kinds: tuple[_Kind, ...],
    rtol: float,
    tables: tuple[Table, ...],
    problems: Stack,
    ways: Way,
    kind: Array,
    material: Array,
    offset: Array,
    max_steps: Array,
) -> Way:
    """A step of all solves."""
    ways = advance(offset, rtol, ways, _equations(kinds, tables, problems, ways.trial, kind, material))
    return ways._replace(active=ways.active & (ways.steps < max_steps))


def _equations(
    kinds: tuple[_Kind, ...], tables: tuple[Table, ...], problems: Stack, z: Array, kind: Array, material: Array
) -> Array:
    """Normal equations by free coordinates, (W, C, F+1, F+1)."""
    values, chain = {}, jnp.zeros(())
    for k, (each, table) in enumerate(zip(kinds, tables, strict=True)):
        flat, slopes = flat_and_slopes(each.structure, table, z[:, : each.size])
        named = each.structure.named(flat)
        given = {
            name: jnp.broadcast_to(x, (len(z), *np.shape(x)[1:])) for name, x in each.general.values(named).items()
        }
        own = _chain(each, slopes, z.shape[1])
        if k == 0:
            values, chain = given, own
        theirs = partial(chosen, kind == k)
        values, chain = {name: theirs(x, values[name]) for name, x in given.items()}, theirs(own, chain)
    whole = kinds[0].general.model
    parts = Part(problems.directions, problems.root[material], problems.target[material])
    mapped = jax.vmap(
        partial(compact_equations, whole),
        (0, Part(None, 0, 0)),  # pyright: ignore[reportArgumentType] - axes
    )
    last = np.eye(z.shape[1] + 1)[-1]
    rest = problems.rest[material][..., None, None] * (last[:, None] * last)
    return chain.swapaxes(-1, -2) @ mapped(values, parts) @ chain + rest


def _chain(kind: _Kind, slopes: Array, size: int) -> Array:
    """How the general model's parameters, and the residual, change with the coordinates, (W, C, G+1, F+1)."""
    place, rows = places(kind.structure), rows_of(kind.general)
    general = np.zeros((len(place), len(kind.general.model.parameters) + 1, place.shape[2]))
    general[:, rows] = place
    widened = slopes @ np.eye(kind.size, size + 1)
    return general[..., :-1] @ widened[..., None, :, :] + general[..., -1:] * np.eye(size + 1)[-1]


def _solutions(ways: Way, rows: np.ndarray, sizes: Sequence[int]) -> list[Solution]:
    """Those in some of the rows, of so many coordinates."""
    y, kept, count, offset, converged = (
        np.asarray(x)[rows] for x in (ways.y, ways.kept, ways.steps, ways.offset, ways.converged)
    )
    costs = np.where(np.isfinite(kept).all((1, 2, 3)), kept[:, :, -1, -1].sum(1), np.nan)
    found = []
    for k, size in enumerate(sizes):
        own = np.r_[:size, -1]
        normal = kept[k][:, own[:, None], own]
        found.append(
            Solution(y[k, :size], float(costs[k]), normal, int(count[k]), float(offset[k]), bool(converged[k]))
        )
    return found
