"""Lights: lamps far away, and an environment all around, in world coordinates with y up."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from .colour import LUMINANCE

SKY, GROUND = 0.6, 0.15
WINDOWS = (((-0.6, 0.5, 0.6), 60.0, 4.0), ((0.7, 0.6, 0.3), 200.0, 12.0), ((0.2, 0.9, -0.3), 30.0, 2.0))
"""Direction, concentration and radiance of the studio's windows."""
ROWS, COLUMNS = (128, 512), (256, 1024)  # at least and at most, of the map that directions are drawn from
TINY = 1e-30
FEWEST = 1e-3  # of the mean: a cell that is darker is drawn as if it were as bright


@jax.jit
def studio(direction: ArrayLike) -> Array:
    """Radiance of a studio from unit directions (..., 3): sky, ground and three windows; white light."""
    direction = jnp.asarray(direction)
    radiance = GROUND + (SKY - GROUND) / (1 + jnp.exp(-8 * direction[..., 1]))
    for towards, sharpness, strength in WINDOWS:
        axis = np.array(towards) / np.linalg.norm(towards)
        cosine = sum(direction[..., k] * float(axis[k]) for k in range(3))
        radiance = radiance + strength * jnp.exp(sharpness * (cosine - 1))
    return radiance


class Lamp(eqx.Module):
    """A round lamp far away.

    Attributes:
        axes: orthonormal rows, the last towards the lamp, (3, 3). irradiance: on a surface that faces it, (3,).
        radius: angular (rad).
    """

    axes: Array
    irradiance: Array
    radius: Array

    def draw(self, u: Array) -> Array:
        """Directions over its disc of even radiance, by the irradiance of a surface that faces it, (..., 3)."""
        sine, turn = jnp.sin(self.radius) * jnp.sqrt(u[..., :1]), 2 * jnp.pi * u[..., 1:2]
        across = jnp.cos(turn) * self.axes[0] + jnp.sin(turn) * self.axes[1]
        return jnp.sqrt(1 - sine * sine) * self.axes[2] + sine * across


def lamp(towards: ArrayLike, irradiance: ArrayLike, radius: float) -> Lamp:
    """A lamp in the direction ``towards``, of any length."""
    last = np.asarray(towards, float) / np.linalg.norm(np.asarray(towards, float))
    axes = np.stack([*frame(last), last])
    return Lamp(*(jnp.asarray(x, jnp.float32) for x in (axes, irradiance, radius)))


def frame(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across every normal, (..., 3)."""
    helper = np.where(np.abs(normal[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    across = np.cross(normal, helper)
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    return across, np.cross(normal, across)


class Environment(eqx.Module):
    """Radiance from everywhere, a map with latitude down and longitude across.

    Attributes:
        radiance: at the centres of (H, W) cells, (H, W, 3); the first row is up (+y), longitude atan2(x, -z) from -pi.
        rows, columns: distribution functions by which cells are drawn, (R + 1,), and in each row (R, C + 1).
        density_of_cell: of directions (1/sr), (R, C).
        share: of the directions that are best drawn by the environment: none where it is even, up to a half.
    """

    radiance: Array
    rows: Array
    columns: Array
    density_of_cell: Array
    share: Array

    def look(self, direction: Array) -> Array:
        """Radiance (..., 3), linear between cells."""
        rows, columns = self.radiance.shape[:2]
        row, column = _place(direction)
        y = jnp.clip(row * rows - 0.5, 0.0, rows - 1.0)
        x = column * columns - 0.5
        top, left = jnp.clip(jnp.floor(y).astype(jnp.int32), 0, rows - 2), jnp.floor(x).astype(jnp.int32)
        down, across = y - top, x - left
        flat = self.radiance.reshape(-1, 3)
        found = jnp.zeros((), flat.dtype)
        for i, by_row in ((top, 1 - down), (top + 1, down)):
            for j, by_column in ((left, 1 - across), (left + 1, across)):
                found = found + (by_row * by_column)[..., None] * flat[i * columns + j % columns]
        return found

    def draw(self, u: Array) -> Array:
        """Unit directions (..., 3) by two numbers, nearly in proportion to radiance: as even as the numbers are."""
        rows, columns = self.density_of_cell.shape
        row, down = _within(self.rows, jnp.zeros(u.shape[:-1], jnp.int32), rows, u[..., 0])
        column, right = _within(self.columns.ravel(), row * (columns + 1), columns, u[..., 1])
        # even in the cosine of the latitude: in solid angle
        upper, lower = (jnp.cos(jnp.pi / rows * (row + k)) for k in (0, 1))
        up = upper + (lower - upper) * down
        longitude = (2 * (column + right) / columns - 1) * jnp.pi
        across = jnp.sqrt(jnp.maximum(1 - up * up, 0.0))
        return jnp.stack([across * jnp.sin(longitude), up, -across * jnp.cos(longitude)], -1)

    def density(self, direction: Array) -> Array:
        """Density of the directions of :meth:`draw` (1/sr)."""
        rows, columns = self.density_of_cell.shape
        row, column = _place(direction)
        i = jnp.clip((row * rows).astype(jnp.int32), 0, rows - 1)
        j = jnp.clip((column * columns).astype(jnp.int32), 0, columns - 1)
        return self.density_of_cell.ravel()[i * columns + j]


def _within(function: Array, first: Array, count: int, u: Array) -> tuple[Array, Array]:
    """In which of ``count`` intervals of distribution functions, that begin at ``first``, numbers lie, and how far."""
    low, high = jnp.zeros_like(first), jnp.full_like(first, count)
    for _ in range((count - 1).bit_length()):
        middle = (low + high) // 2
        beyond = function[first + middle] <= u
        low, high = jnp.where(beyond, middle, low), jnp.where(beyond, high, middle)
    begin, end = function[first + low], function[first + low + 1]
    return low, jnp.clip((u - begin) / jnp.maximum(end - begin, TINY), 0.0, 1.0)


def _place(direction: Array) -> tuple[Array, Array]:
    """Share of the way down and across the map."""
    up = jnp.clip(direction[..., 1], -1.0, 1.0)
    return jnp.arccos(up) / jnp.pi, (jnp.arctan2(direction[..., 0], -direction[..., 2]) / jnp.pi + 1) / 2


def directions(rows: int, columns: int) -> np.ndarray:
    """Unit directions of the centres of a map's cells, (rows, columns, 3)."""
    latitude = (np.arange(rows)[:, None] + 0.5) / rows * np.pi
    longitude = (2 * (np.arange(columns)[None] + 0.5) / columns - 1) * np.pi
    across = np.sin(latitude)
    return np.stack(
        [across * np.sin(longitude), np.broadcast_to(np.cos(latitude), (rows, columns)), -across * np.cos(longitude)],
        -1,
    )


def environment(radiance: np.ndarray) -> Environment:
    """From a map of any size (H, W, 3), linear RGB."""
    rows, columns = (int(np.clip(n, *ends)) for n, ends in zip(radiance.shape, (ROWS, COLUMNS), strict=False))
    # not a pixel of a small sun is missed, nor what `look`, linear between cells, gives those beside it
    luminance = _averaged(_averaged(_over_cells(radiance @ LUMINANCE), rows).T, columns).T
    edges = np.cos(np.arange(rows + 1) / rows * np.pi)
    solid_angle = np.broadcast_to((edges[:-1] - edges[1:])[:, None] * 2 * np.pi / columns, luminance.shape)
    mean = np.sum(luminance * solid_angle) / (4 * np.pi)
    variation = np.sqrt(np.sum((luminance - mean) ** 2 * solid_angle) / (4 * np.pi)) / mean if mean > 0 else 0.0
    share = np.maximum(luminance, FEWEST * mean if mean > 0 else 1.0) * solid_angle
    share = share / share.sum()
    of_rows = share.sum(1)
    return Environment(*(jnp.asarray(x, jnp.float32) for x in (
        radiance, _distribution(of_rows), _distribution(share / of_rows[:, None]), share / solid_angle,
        variation / (1 + 2 * variation),
    )))  # fmt: skip


def _over_cells(values: np.ndarray) -> np.ndarray:
    """Means over the cells of a map (H, W) that is linear between their centres."""
    across = 0.75 * values + 0.125 * (np.roll(values, 1, 1) + np.roll(values, -1, 1))
    edged = np.pad(across, ((1, 1), (0, 0)), mode="edge")
    return 0.75 * across + 0.125 * (edged[:-2] + edged[2:])


def _distribution(share: np.ndarray) -> np.ndarray:
    """Distribution functions of shares of the last axis, (..., N + 1)."""
    return np.concatenate([np.zeros((*share.shape[:-1], 1)), np.cumsum(share, -1)], -1)


def _averaged(x: np.ndarray, count: int) -> np.ndarray:
    """Means of the first axis over as many even intervals, (count, ...)."""
    whole = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, 0)])
    edges = np.linspace(0, len(x), count + 1)
    first = np.minimum(edges.astype(int), len(x) - 1)
    at_edges = whole[first] + (edges - first)[:, None] * x[first]
    return np.diff(at_edges, axis=0) * (count / len(x))
