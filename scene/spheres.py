"""What a material looks like: a sphere under a small lamp and under an environment, and how far two spheres differ.

A pixel's radiance is a weighted sum of BRDF values, so a picture is a sparse matrix of weights that is made once: to
render is to multiply, a millisecond. Under the lamp a pixel averages over the lamp's disc; under the
environment it is integrated over half vectors on the file's own rows of theta_h, which resolve every lobe that the file
does: domega_i = 4 cos_d domega_h. Bins without datum are left out of both pictures that are compared.

The difference is the mean distance in CIELAB (D65, CIE 1976), in which about 1 is just noticeable; white is what a
perfect white surface facing the lamp, or in the open under the environment, would send. That fits are to be judged by
pictures is the idea of Bieron & Peers 2020, "An adaptive BRDF fitting metric".
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Literal

import numpy as np
from scipy.sparse import csr_array, vstack

from ..merl_io.binary import DIMS, Dims
from ..merl_io.grid import merl_grid
from .colour import cielab
from .lights import frame, studio

Lighting = Literal["lamp", "environment"]
LAMP = np.array([0.45, 0.55, 0.7]) / np.linalg.norm([0.45, 0.55, 0.7])  # camera along z, up along y
LAMP_RADIUS_RAD = np.radians(1.5)
NODES = 3  # radii of its disc, with 6 azimuths each
AZIMUTHS = 24  # of half vectors, on each row of theta_h
GOLDEN = (np.sqrt(5) - 1) / 2
BLACK = 1.0  # L*: up to which a pixel is black
AT_ONCE = 512  # pixels whose weights are found together
PIXELS = {"lamp": 900, "environment": 220}  # of the comparison, spread evenly over the disc of the sphere


def disc(count: int) -> np.ndarray:
    """Points spread evenly over the unit disc, (count, 2): Vogel's spiral."""
    k = np.arange(count) + 0.5
    radius, turn = np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], -1)


@cache
def compared(lighting: Lighting, dims: Dims = DIMS) -> csr_array:
    """The pixels in which pictures are compared."""
    return sphere(lighting, disc(PIXELS[lighting]), dims)


def normals(positions: np.ndarray) -> np.ndarray:
    """Of a sphere that is seen from far along z, (N, 3), at positions in radii of it, (N, 2)."""
    return np.concatenate([positions, np.sqrt(np.maximum(1 - np.sum(positions**2, -1, keepdims=True), 0.0))], -1)


def sphere(
    lighting: Lighting, positions: np.ndarray, dims: Dims = DIMS, over: Callable[..., Iterable[csr_array]] = map
) -> csr_array:
    """Pixels of a sphere that is seen from far along z, as sums over folded bins: radiance over BRDF, (N, H D P/2).

    Args:
        positions: of the pixels, (N, 2), in radii of the sphere and inside it. dims: of the bins. over: maps a function
            over parts of them.
    """
    lit = _by_lamp if lighting == "lamp" else _by_environment

    def part(normal: np.ndarray) -> csr_array:
        bins, weights = lit(normal, dims)
        starts = np.arange(0, bins.size + 1, bins.shape[1], dtype=np.int32)  # as bins are: half the memory
        found = csr_array((weights.ravel(), bins.ravel(), starts), (len(bins), np.prod(dims) // 2))
        found.eliminate_zeros()
        found.sum_duplicates()
        return found

    normal = normals(positions)
    return csr_array(vstack([*over(part, [normal[k : k + AT_ONCE] for k in range(0, len(normal), AT_ONCE)])], "csr"))


def render(pixels: csr_array, brdf: np.ndarray) -> np.ndarray:
    """Radiance over that of a white surface, (pixels, C), of folded values (C, H, D, P/2)."""
    return np.stack([pixels @ plane.ravel() for plane in brdf], -1)


def lamp_nodes() -> np.ndarray:
    """Unit vectors to points of the lamp's disc, of equal weight, (points, 3)."""
    radius, turn = np.sqrt((np.arange(NODES) + 0.5) / NODES), np.arange(6) * np.pi / 3
    across, up = frame(LAMP)
    radius, turn = (x.reshape(-1, 1) for x in np.meshgrid(np.tan(LAMP_RADIUS_RAD) * radius, turn, indexing="ij"))
    light = LAMP + radius * (np.cos(turn) * across + np.sin(turn) * up)
    return light / np.linalg.norm(light, axis=-1, keepdims=True)


def _by_lamp(normal: np.ndarray, dims: Dims) -> tuple[np.ndarray, np.ndarray]:
    """Bins and weights of pixels, (pixels, samples)."""
    light = lamp_nodes()
    i = np.broadcast_to(light, (len(normal), *light.shape))
    cos_i = np.maximum(np.einsum("pk,lk->pl", normal, light), 0.0)
    return _bins(i, np.broadcast_to([0.0, 0.0, 1.0], i.shape), normal[:, None], dims), np.pi * cos_i / len(light)


def _by_environment(normal: np.ndarray, dims: Dims) -> tuple[np.ndarray, np.ndarray]:
    """The viewer is along z: theta_h, cos_o and the light i = 2 cos_d h - o need no more than the half vector."""
    grid = merl_grid(dims)
    rows = np.arange(len(grid.theta_h))
    # every row of theta_h is turned against the one before it, so that the environment is sampled evenly
    turn = 2 * np.pi * ((np.arange(AZIMUTHS) + GOLDEN * rows[:, None]) % AZIMUTHS) / AZIMUTHS
    theta, phi = np.repeat(grid.theta_h, AZIMUTHS), turn.reshape(-1)
    solid_angle = np.repeat(-np.diff(np.cos(grid.edges[0])), AZIMUTHS) * 2 * np.pi / AZIMUTHS
    local = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    h = np.stack([*frame(normal), normal], -1) @ local  # (pixels, 3, samples)
    cos_d, cos_o = h[:, 2], normal[:, 2:]
    cos_i = 2 * cos_d * local[2] - cos_o
    i = np.moveaxis(2 * cos_d[:, None] * h, 1, -1)
    i[..., 2] -= 1
    weight = np.asarray(studio(i)) * cos_i * 4 * cos_d * solid_angle / (_irradiance() / np.pi)
    cos_d = np.clip(cos_d, 0, 1)
    across = 2 * np.sin(theta) * np.sqrt((1 - cos_d) * (1 + cos_d))
    phi_d = np.arccos(np.minimum(np.abs(cos_o - cos_i) / np.maximum(across, 1e-12), 1))
    bins = _index(np.repeat(rows, AZIMUTHS), np.arccos(cos_d), phi_d, dims)
    return bins, np.where((cos_i > 0) & (h[:, 2] > 0), weight, 0.0)


@cache
def _irradiance() -> float:
    """Of a surface that faces the camera."""
    points = disc(20_000)  # even in the projected disc: the mean is the irradiance over pi
    z = np.sqrt(np.maximum(1 - np.sum(points**2, -1), 0.0))
    return float(np.pi * np.asarray(studio(np.concatenate([points, z[:, None]], -1))).mean())


def _bins(i: np.ndarray, o: np.ndarray, normal: np.ndarray, dims: Dims = DIMS) -> np.ndarray:
    """Flat index of the folded bin that holds each pair of directions."""
    h = i + o
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    cos_h, cos_d = np.sum(h * normal, -1), np.sum(h * o, -1)
    theta_h, theta_d = (np.arccos(np.clip(x, -1, 1)) for x in (cos_h, cos_d))
    apart = np.sum((o - i) * normal, -1)  # cos_o - cos_i = 2 sin_h sin_d cos(phi_d)
    cos_phi = apart / np.maximum(2 * np.sin(theta_h) * np.sin(theta_d), 1e-12)
    phi_d = np.arccos(np.clip(np.abs(cos_phi), 0, 1))
    row = np.clip((np.sqrt(np.clip(theta_h / (np.pi / 2), 0, 1)) * dims[0]).astype(np.int32), 0, dims[0] - 1)
    return _index(row, theta_d, phi_d, dims)


def _index(row: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray, dims: Dims) -> np.ndarray:
    """Flat index of a folded bin of a row of theta_h."""
    folded = dims[1], dims[2] // 2
    d, p = (
        np.clip((x / (np.pi / 2) * n).astype(np.int32), 0, n - 1) for x, n in zip((theta_d, phi_d), folded, strict=True)
    )
    return (row.astype(np.int32) * folded[0] + d) * folded[1] + p


def shown(used: np.ndarray, possible: np.ndarray) -> float:
    """How much of a picture the bins ``used`` make, of what all ``possible`` ones do: the less of both lightings.

    Args:
        used, possible: folded bins, (H, D, P/2).
    """
    dims, shares = (used.shape[0], used.shape[1], 2 * used.shape[2]), []
    for lighting in PIXELS:
        weight = np.asarray(compared(lighting, dims).sum(0)).ravel()
        shares.append(float(weight @ (used & possible).ravel() / max(weight @ possible.ravel(), 1e-300)))
    return min(shares)


def distances(measured: np.ndarray, predicted: np.ndarray, used: np.ndarray) -> tuple[float, float, float]:
    """How far a material's spheres are from another's, highlights brighter than white as they are.

    Args:
        measured, predicted: folded (3, H, D, P/2), 1/sr. used: bins that both are seen in, (H, D, P/2).

    Returns:
        mean CIELAB distance over all pixels, black ones too, and over lamp and environment alike; and over the pixels
        under the lamp, and under the environment, that are lit: lighter than `BLACK` in either sphere.
    """
    planes = [np.where(used, x, 0.0) for x in (measured, predicted)]
    dims = used.shape[0], used.shape[1], 2 * used.shape[2]
    whole, lit = [], []
    for lighting in PIXELS:
        ours, theirs = (cielab(render(compared(lighting, dims), x)) for x in planes)
        apart, seen = np.linalg.norm(ours - theirs, axis=-1), np.maximum(ours[:, 0], theirs[:, 0]) > BLACK
        whole.append(apart.mean())
        lit.append(float(apart[seen].mean()) if seen.any() else 0.0)
    return float(np.mean(whole)), lit[0], lit[1]
