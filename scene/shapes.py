"""Spheres and rectangles, and where rays meet them; all of a scene's shapes as arrays."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

FAR = 1e30
NEAR = 1e-3  # of the size of the scene: how far a ray leaves its own surface alone


class Shapes(eqx.Module):
    """All shapes, spheres first.

    Attributes:
        centre, radius: of spheres, (S, 3) and (S,). corner, facing: of rectangles, (R, 3), a corner and the unit normal
            of their front. across, up: their edges over the squares of their lengths, (R, 3). material: index of each
            shape's, (S + R,). near: least distance of a hit.
    """

    centre: Array
    radius: Array
    corner: Array
    facing: Array
    across: Array
    up: Array
    material: Array
    near: Array

    def nearest(self, origin: Array, direction: Array) -> tuple[Array, Array]:
        """Distance (...) to the nearest shape, :data:`FAR` for none, and its index."""
        distance, index = jnp.full(origin.shape[:-1], FAR, origin.dtype), jnp.zeros(origin.shape[:-1], jnp.int32)
        for k, found in enumerate(self._distances(origin, direction)):
            closer = found < distance
            distance, index = jnp.where(closer, found, distance), jnp.where(closer, k, index)
        return distance, index

    def blocked(self, origin: Array, direction: Array) -> Array:
        """Whether anything is in the way."""
        found = jnp.zeros(origin.shape[:-1], bool)
        for distance in self._distances(origin, direction):
            found = found | (distance < FAR)
        return found

    def normals(self, index: Array, point: Array) -> Array:
        """Unit normals (..., 3) at points on the shapes."""
        spheres = len(self.radius)
        found = jnp.zeros_like(point)
        for k in range(spheres):
            found = jnp.where((index == k)[..., None], (point - self.centre[k]) / self.radius[k], found)
        for k in range(len(self.corner)):
            found = jnp.where((index == spheres + k)[..., None], self.facing[k], found)
        return found

    def _distances(self, origin: Array, direction: Array) -> list[Array]:
        """To each shape's front, FAR where it is not met; a list, so that no array has an axis of shapes."""
        found = []
        for k in range(len(self.radius)):
            away = [origin[..., j] - self.centre[k, j] for j in range(3)]
            along = sum(away[j] * direction[..., j] for j in range(3))
            # distance of the centre from the ray, from the perpendicular, which float32 can do
            square = self.radius[k] ** 2 - sum((away[j] - along * direction[..., j]) ** 2 for j in range(3))
            distance = -along - jnp.sqrt(jnp.maximum(square, 0.0))
            found.append(jnp.where((square > 0) & (distance > self.near), distance, FAR))
        for k in range(len(self.corner)):
            towards = _dot(direction, self.facing[k])
            height = _dot(origin - self.corner[k], self.facing[k])
            distance = -height / jnp.where(towards == 0, 1.0, towards)
            point = origin + distance[..., None] * direction - self.corner[k]
            u, v = _dot(point, self.across[k]), _dot(point, self.up[k])
            inside = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1) & (distance > self.near) & (towards != 0)
            found.append(jnp.where(inside, distance, FAR))
        return found


def _dot(vector: Array, constant: Array) -> Array:
    """Componentwise, which XLA fuses and a sum over the last axis not."""
    return vector[..., 0] * constant[0] + vector[..., 1] * constant[1] + vector[..., 2] * constant[2]


SphereOf = tuple[np.ndarray, float, int]
WallOf = tuple[np.ndarray, np.ndarray, np.ndarray, int]


def unobstructed(spheres: Sequence[SphereOf], rectangles: Sequence[WallOf]) -> bool:
    """Whether no shape can be in the way of another's light: one alone, or walls none of which is before another."""
    if len(spheres) + len(rectangles) == 1:
        return True
    if spheres:
        return False
    for corner, across, up, _ in rectangles:
        facing = np.cross(across, up)
        for other, x, y, _ in rectangles:
            corners = np.array([other, other + x, other + y, other + x + y])
            if np.any((corners - corner) @ facing > 1e-9 * np.linalg.norm(facing)):
                return False
    return True


def shapes(spheres: Sequence[SphereOf], rectangles: Sequence[WallOf]) -> Shapes:
    """From (centre, radius, material) and (corner, across, up, material)."""
    sizes = [2 * radius for _, radius, _ in spheres] + [
        float(np.linalg.norm(x)) for _, across, up, _ in rectangles for x in (across, up)
    ]

    def vectors(rows: Sequence[np.ndarray]) -> Array:
        return jnp.asarray(np.reshape(rows, (-1, 3)), jnp.float32)

    facing = [np.cross(across, up) for _, across, up, _ in rectangles]
    return Shapes(
        vectors([centre for centre, *_ in spheres]), jnp.asarray([r for _, r, _ in spheres], jnp.float32),
        vectors([corner for corner, *_ in rectangles]), vectors([x / np.linalg.norm(x) for x in facing]),
        vectors([x / (x @ x) for _, x, _, _ in rectangles]), vectors([x / (x @ x) for _, _, x, _ in rectangles]),
        jnp.asarray([m for *_, m in (*spheres, *rectangles)], jnp.int32), jnp.asarray(NEAR * min(sizes), jnp.float32),
    )  # fmt: skip
