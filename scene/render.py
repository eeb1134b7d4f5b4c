"""Pictures: every pixel the mean of samples, each of which asks the material for light from lamps and environment.

Directions are drawn by the material's own sampler and by the environment's brightness, in shares that depend on how
uneven it is, and weighted by the density of both together. Numbers are a scrambled Sobol sequence, turned around in
every pixel by another amount (Cranley & Patterson 1976). Pictures with the same seed and the same samplers take the
same directions.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import qmc

from ..model.geometry import Geometry
from ..model.sampling import Sampler
from . import lights
from . import shapes as forms
from .description import Camera, Scene, SceneError
from .shapes import FAR, Shapes
from .surface import Drawn, Material

CHUNK = 1 << 16  # samples at a time
DIMENSIONS = 2, 1, 2, 2, 2  # of the place in a pixel, of the choice, of environment, material, and each lamp
LEAST = 1e-12  # density: below it the direction did not come from either
STREAM = 0x5CE7E  # of random numbers that turn the sequence
Report = Callable[[float], None]


class Stage(eqx.Module):
    """All of a scene but its materials, as arrays.

    Attributes:
        origin: of the camera, (3,). corner, right, down: directions to the picture's upper left corner, and along its
            edges. size: width and height. open: whether nothing can be in the way of light.
    """

    origin: Array
    corner: Array
    right: Array
    down: Array
    size: tuple[int, int] = eqx.field(static=True)
    shapes: Shapes
    lamps: tuple[lights.Lamp, ...]
    environment: lights.Environment | None
    open: bool = eqx.field(static=True)
    background: bool = eqx.field(static=True)

    def seen(self, pixel: Array, place: Array) -> tuple[Array, Array, Array]:
        """What places (P, S, 2) in pixels (P,), counted by rows, see: directions, distances and indices of shapes."""
        x, y = (
            (pixel[:, None] % self.size[0] + place[..., 0]) / self.size[0],
            (pixel[:, None] // self.size[0] + place[..., 1]) / self.size[1],
        )
        towards = self.corner + x[..., None] * self.right + y[..., None] * self.down
        towards = towards / jnp.linalg.norm(towards, axis=-1, keepdims=True)
        return towards, *self.shapes.nearest(jnp.broadcast_to(self.origin, towards.shape), towards)


class Rays(NamedTuple):
    """Light that a pixel's samples ask for, in the frame of the surface.

    Attributes:
        i, o: directions of light and viewer, (L, P, S, 3). weight: what a BRDF of 1/sr adds to the pixel, (L, P, S, 3).
    """

    i: Array
    o: Array
    weight: Array


def _camera(camera: Camera) -> tuple[Array, Array, Array, Array, tuple[int, int]]:
    """What a stage has of it."""
    position, ahead = np.array(camera.position), np.subtract(camera.look_at, camera.position)
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, camera.up)
    right = right / np.linalg.norm(right)
    height = 2 * np.tan(np.radians(camera.field_of_view_deg) / 2)
    right, down = right * height * camera.width / camera.height, -np.cross(right, ahead) * height
    origin, corner, right, down = (
        jnp.asarray(x, jnp.float32) for x in (position, ahead - right / 2 - down / 2, right, down)
    )
    return origin, corner, right, down, (camera.width, camera.height)


def stage(scene: Scene, radiance: np.ndarray | None = None) -> Stage:
    """A scene made ready.

    Args:
        radiance: of the environment's map (H, W, 3), where it has one.
    """
    names, around = list(scene.materials), None
    spheres = [(np.array(s.centre), s.radius, names.index(s.material)) for s in scene.sphere]
    walls = [(np.array(r.corner), np.array(r.across), np.array(r.up), names.index(r.material)) for r in scene.rectangle]
    if scene.environment is not None:
        if scene.environment.kind == "studio":
            radiance = np.asarray(lights.studio(lights.directions(256, 512)))[..., None]
        elif scene.environment.kind == "constant":
            radiance = np.ones((2, 4, 1))
        if radiance is None:
            raise SceneError("the environment's map was not read")
        around = lights.environment(radiance * np.array(scene.environment.strength))
    lamps = tuple(
        lights.lamp(np.array(x.towards), np.array(x.irradiance), np.radians(x.radius_deg)) for x in scene.lamp
    )
    return Stage(
        *_camera(scene.camera), forms.shapes(spheres, walls), lamps, around, forms.unobstructed(spheres, walls),
        scene.environment is not None and scene.environment.background,
    )  # fmt: skip


class Numbers(eqx.Module):
    """Uniform numbers of samples, (S, D), and a seed by which each pixel turns them."""

    sequence: Array
    key: Array

    def of(self, pixel: Array) -> Array:
        """(P, S, D) in [0, 1)."""
        turn = jax.vmap(lambda k: jax.random.uniform(jax.random.fold_in(self.key, k), self.sequence.shape[1:]))(pixel)
        moved = self.sequence + turn[:, None].astype(jnp.float32)
        return jnp.minimum(moved - jnp.floor(moved), np.float32(1 - 2**-24))


def numbers(scene: Scene, samples: int | None = None) -> Numbers:
    """Those of a scene's seed."""
    dimensions = sum(DIMENSIONS[:4]) + DIMENSIONS[4] * len(scene.lamp)
    count = samples or scene.samples
    sobol = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(scene.seed))
    drawn = sobol.random_base2(int(np.ceil(np.log2(count))))[:count] if count > 1 else sobol.random(1)
    return Numbers(jnp.asarray(drawn, jnp.float32), jax.random.fold_in(jax.random.key(scene.seed), STREAM))


def _frame(normal: Array) -> tuple[Array, Array, Array]:
    """Two unit vectors across a normal (Duff et al. 2017), and that."""
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    across = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return across, jnp.stack([b, sign + y * y * a, -y], -1), normal


def _local(axes: tuple[Array, Array, Array], direction: Array) -> Array:
    return jnp.stack([jnp.sum(direction * axis, -1) for axis in axes], -1)


def lit(stage: Stage, sampler: Sampler, material: Array, pixel: Array, u: Array) -> Rays:
    """What samples ``u`` (P, S, D) of pixels (P,) ask of the material; weights are 0 where another shape is seen."""
    towards, distance, index = stage.seen(pixel, u[..., :2])
    seen = (distance < FAR) & (stage.shapes.material[index] == material)
    point = stage.origin + jnp.where(seen, distance, 1.0)[..., None] * towards
    up = jnp.array([0.0, 0.0, 1.0], point.dtype)
    axes = _frame(jnp.where(seen[..., None], stage.shapes.normals(index, point), up))
    viewer = _local(axes, -towards)
    seen = seen & (viewer[..., 2] > 0)
    viewer = jnp.where(seen[..., None], viewer, up)
    found, start = [], sum(DIMENSIONS[:2])  # of each light: directions in the world, in the frame, radiance by density
    if (around := stage.environment) is not None:
        by_light = around.draw(u[..., start : start + 2])
        by_material = sampler.draw(viewer, u[..., start + 2 : start + 4])
        chosen = (u[..., 2] < around.share)[..., None]
        direction = jnp.where(chosen, by_light, sum(by_material[..., k, None] * axis for k, axis in enumerate(axes)))
        light = jnp.where(chosen, _local(axes, by_light), by_material)
        by_both = around.density(direction), sampler.density(viewer, light)
        density = around.share * by_both[0] + (1 - around.share) * by_both[1]
        found.append((direction, light, around.look(direction) / jnp.maximum(density, LEAST)[..., None]))
    for k, lamp in enumerate(stage.lamps):
        first = sum(DIMENSIONS[:4]) + DIMENSIONS[4] * k
        direction = lamp.draw(u[..., first : first + 2])
        facing = jnp.sum(direction * lamp.axes[2], -1, keepdims=True)
        found.append((direction, _local(axes, direction), lamp.irradiance / facing))
    weights = []
    for direction, light, weight in found:
        reaches = seen & (light[..., 2] > 0)
        if not stage.open:
            reaches = reaches & ~stage.shapes.blocked(point, direction)
        weights.append(jnp.where(reaches[..., None], weight * light[..., 2:], 0.0) / u.shape[1])
    i = jnp.stack([light for _, light, _ in found])
    return Rays(i, jnp.broadcast_to(viewer, i.shape), jnp.stack(weights))


def radiance(material: Material, rays: Rays) -> Array:
    """Radiance of pixels, (P, 3)."""
    found = material.brdf(Geometry.from_vectors(rays.i, rays.o))
    each = [jnp.where(rays.weight[..., k] > 0, rays.weight[..., k] * found[k], 0.0) for k in range(3)]
    return jnp.stack([jnp.sum(x, (0, 2)) for x in each], -1)


@eqx.filter_jit
def _shaded(
    stage: Stage, sampler: Sampler, materials: tuple[Material, ...], index: Array, pixel: Array, numbers: Numbers
) -> list[Array]:
    rays = lit(stage, sampler, index, pixel, numbers.of(pixel))
    return [radiance(material, rays) for material in materials]


@eqx.filter_jit
def _first(stage: Stage, pixel: Array, numbers: Numbers, materials: int) -> tuple[Array, Array]:
    """Which materials pixels see (P, M), and what of the background, (P, 3)."""
    towards, distance, index = stage.seen(pixel, numbers.of(pixel)[..., :2])
    hit = distance < FAR
    seen = [jnp.any(hit & (stage.shapes.material[index] == k), 1) for k in range(materials)]
    behind = jnp.zeros((*pixel.shape, 3), jnp.float32)
    if stage.background and stage.environment is not None:
        behind = jnp.mean(jnp.where(hit[..., None], 0.0, stage.environment.look(towards)), 1)
    return jnp.stack(seen, -1), behind


class Film:
    """Which pixels see what, for one scene and its numbers."""

    def __init__(self, scene: Scene, stage: Stage, samples: int | None = None) -> None:
        self.scene, self.stage, self.numbers = scene, stage, numbers(scene, samples)
        self.size = scene.camera.width, scene.camera.height
        self.step = max(CHUNK // self.numbers.sequence.shape[0], 1)

    @cached_property
    def _first(self) -> tuple[np.ndarray, np.ndarray]:
        every = np.arange(self.size[0] * self.size[1])
        found = [_first(self.stage, p, self.numbers, len(self.scene.materials)) for p, _ in self.chunks(every)]
        seen, behind = (np.concatenate([np.asarray(each[k]) for each in found])[: len(every)] for k in range(2))
        return seen, behind

    def pixels(self, material: int) -> np.ndarray:
        """Those that see a material in any sample, counted by rows."""
        return np.flatnonzero(self._first[0][:, material])

    @property
    def background(self) -> np.ndarray:
        """Radiance of what is behind the shapes, (pixels, 3)."""
        return self._first[1]

    def chunks(self, pixels: np.ndarray) -> Iterator[tuple[Array, int]]:
        """Pixels at a time, as many in each, the last filled up by its last; and how many of them count."""
        for start in range(0, len(pixels), self.step):
            part = pixels[start : start + self.step]
            yield jnp.asarray(np.pad(part, (0, self.step - len(part)), "edge"), jnp.int32), len(part)

    def shade(
        self, whole: Drawn, others: Sequence[Material], material: int, pixels: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Radiance chunk by chunk, (1 + others, pixels of the chunk, 3): the others by the first one's directions."""
        first, sampler = whole
        for pixel, count in self.chunks(pixels):
            found = _shaded(self.stage, sampler, (first, *others), jnp.asarray(material), pixel, self.numbers)
            yield np.stack([np.asarray(each)[:count] for each in found])


def pictures(
    film: Film, materials: Sequence[Drawn], others: Sequence[Sequence[Material]] = (), report: Report = lambda _: None
) -> np.ndarray:
    """Radiance over white, (1 + K, height, width, 3), K the number of ``others`` of each material.

    Args:
        materials: in the order of the scene. others: of each material as many more, by the same directions.
        report: told the share that is done.
    """
    more = len(others[0]) if others else 0
    found = np.repeat(film.background[None], 1 + more, 0)
    todo = [film.pixels(k) for k in range(len(materials))]
    whole, done = sum(map(len, todo)), 0
    for k, pixels in enumerate(todo):
        begin = 0
        for part in film.shade(materials[k], others[k] if others else (), k, pixels):
            end = begin + part.shape[1]
            found[:, pixels[begin:end]] += part
            begin, done = end, done + part.shape[1]
            report(done / whole)
    return found.reshape(1 + more, film.size[1], film.size[0], 3) / film.scene.white
