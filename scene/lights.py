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
ROWS, COLUMNS = 128, 256  # of the map that directions are drawn from
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
        alias, threshold: of Walker's method to draw cells (ROWS COLUMNS,). density_of_cell: of directions (1/sr).
        share: of the directions that are best drawn by the environment: none where it is even, up to a half.
    """

    radiance: Array
    alias: Array
    threshold: Array
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
        """Unit directions (..., 3) by three numbers, nearly in proportion to radiance."""
        position = u[..., 0] * (ROWS * COLUMNS)
        cell = jnp.minimum(position.astype(jnp.int32), ROWS * COLUMNS - 1)
        cell = jnp.where(position - cell < self.threshold[cell], cell, self.alias[cell])
        row, column = cell // COLUMNS, cell % COLUMNS
        # even in the cosine of the latitude: in solid angle
        upper, lower = (jnp.cos(jnp.pi / ROWS * (row + k)) for k in (0, 1))
        up = upper + (lower - upper) * u[..., 1]
        longitude = (2 * (column + u[..., 2]) / COLUMNS - 1) * jnp.pi
        across = jnp.sqrt(jnp.maximum(1 - up * up, 0.0))
        return jnp.stack([across * jnp.sin(longitude), up, -across * jnp.cos(longitude)], -1)

    def density(self, direction: Array) -> Array:
        """Density of the directions of :meth:`draw` (1/sr)."""
        row, column = _place(direction)
        i = jnp.clip((row * ROWS).astype(jnp.int32), 0, ROWS - 1)
        j = jnp.clip((column * COLUMNS).astype(jnp.int32), 0, COLUMNS - 1)
        return self.density_of_cell[i * COLUMNS + j]


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
    at = directions(ROWS, COLUMNS)
    rows, columns = radiance.shape[:2]
    # the mean of the map's cells that lie in each cell of ours, by a few points of each
    fine = directions(4 * ROWS, 4 * COLUMNS)
    i = np.clip((np.arccos(np.clip(fine[..., 1], -1, 1)) / np.pi * rows).astype(int), 0, rows - 1)
    j = np.clip(((np.arctan2(fine[..., 0], -fine[..., 2]) / np.pi + 1) / 2 * columns).astype(int), 0, columns - 1)
    luminance = (radiance @ LUMINANCE)[i, j].reshape(ROWS, 4, COLUMNS, 4).mean((1, 3))
    edges = np.cos(np.arange(ROWS + 1) / ROWS * np.pi)
    solid_angle = np.broadcast_to((edges[:-1] - edges[1:])[:, None] * 2 * np.pi / COLUMNS, at.shape[:2])
    mean = np.sum(luminance * solid_angle) / (4 * np.pi)
    variation = np.sqrt(np.sum((luminance - mean) ** 2 * solid_angle) / (4 * np.pi)) / mean if mean > 0 else 0.0
    share = np.maximum(luminance, FEWEST * mean if mean > 0 else 1.0) * solid_angle
    share = share / share.sum()
    alias, threshold = _aliases(share.ravel())
    density = (share / solid_angle).ravel()
    return Environment(
        jnp.asarray(radiance, jnp.float32), jnp.asarray(alias, jnp.int32), jnp.asarray(threshold, jnp.float32),
        jnp.asarray(density, jnp.float32), jnp.asarray(variation / (1 + 2 * variation), jnp.float32),
    )  # fmt: skip


def _aliases(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Walker's and Vose's tables: a cell keeps its own draw below the threshold, and gives it to its alias above."""
    scaled = share * len(share)
    alias, threshold = np.arange(len(share)), np.ones(len(share))
    small, large = [list(np.flatnonzero(x)) for x in (scaled < 1, scaled >= 1)]
    while small and large:
        less, more = small.pop(), large[-1]
        alias[less], threshold[less] = more, scaled[less]
        scaled[more] -= 1 - scaled[less]
        if scaled[more] < 1:
            small.append(large.pop())
    return alias, threshold
