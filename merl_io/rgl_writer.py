"""RGL's ``.bsdf`` files of any isotropic BRDF, as stock Mitsuba (``measured``) and pbrt-v4 draw them.

The format and its reader are `rgl`, `adaptive` and `tensor`. D is the distribution of facets that explains how much
light goes back to where it came from, f(i, i) = D(i) / (4 cos_i sigma(i)), by power iteration (Dupuy & Jakob 2018,
Section 4.2; Dupuy et al. 2015), with a small even part, so that no direction is without facets. The format leaves free
where the nodes are: half of them are drawn as those facets are seen from i, as RGL's are, half as light is reflected by
the BRDF itself. By the first alone, nodes are rare where a highlight at grazing light falls off, since facets are many
there that send light back along the normal: a plastic's was 5 times too bright at 4 degrees beside it.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from .adaptive import Nodes, bilinear, mirrored, slices
from .atomic import write_bytes
from .scattered import Between
from .tensor import packed
from .warp import warped

Brdf = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Of unit vectors of light and viewer (N, 3): values (C, N), 1/sr."""
THETA_I = np.radians([
    *range(0, 51, 5), 54, 58, 62, 65, 68, 71, 74, 76, 78, 80, 82, 83.5, 85, 86, 87, 88, 89, 90
])  # fmt: skip
"""Incidences, closer where Fresnel's factor rises and shadows fall."""
NODES, NORMALS, FACETS = 96, 128, 512  # of S, of the density of normals along each side, and of D
EVEN = 0.02  # of the facets that is even over all normals
GRAZING, LOWEST = np.radians(89.5), 1e-3  # where the BRDF is asked for light beyond, and for viewers below (cosine)
TURNS, STEPS = 128, 50  # azimuths of a projected area, and power iterations
HALF = 0.5  # of the nodes are drawn as facets are seen


def fields(brdf: Brdf) -> dict[str, np.ndarray]:
    """The arrays of a file but colours and description, and ``S`` of the channels of the BRDF, (1, T, C, n, n).

    Args:
        brdf: reciprocal, not negative.
    """
    theta, D, area = _facets(brdf)
    sigma = area @ D
    ndf, projected = (np.array([x, x], np.float32) for x in (D, sigma))
    u, v = np.linspace(0, 1, NORMALS), np.linspace(0, 1, NORMALS)
    spread = 2 * np.pi**2 * u * np.sin(u**2 * np.pi / 2)
    steps, vndf, found = np.linspace(0, 1, NODES), [], []
    for incidence in THETA_I:
        o, reaches = mirrored((np.tile(u, (NORMALS, 1)), v), incidence)
        cosine = np.sqrt(np.maximum((1 + o @ _towards(incidence, 0.0)) / 2, 0.0)) * reaches  # of i to the normal
        seen = spread * cosine * np.interp(u**2 * np.pi / 2, theta, D)
        lit = spread * cosine * _reflected(brdf, incidence, o, reaches).mean(0)
        vndf.append((HALF * seen / seen.mean() + (1 - HALF) * lit / max(lit.mean(), 1e-30)).astype(np.float32))
        at = warped(vndf[-1].astype(float), steps, steps)
        scale = bilinear(ndf, at[0], at[1][:, None]) / (4 * np.interp(incidence, theta, sigma))
        found.append(_reflected(brdf, incidence, *mirrored(at, incidence)) / scale)
    S = np.array(found, np.float32)[None]
    return {
        "theta_i": np.array(THETA_I, np.float32), "phi_i": np.zeros(1, np.float32), "ndf": ndf, "sigma": projected,
        "vndf": np.stack(vndf)[None], "luminance": S.mean(2), "jacobian": np.ones(1, np.uint8), "S": S,
    }  # fmt: skip


def coloured(parts: Mapping[str, np.ndarray], weights: np.ndarray) -> np.ndarray:
    """S of colours, (1, T, K, n, n), of what `fields` found.

    Args:
        weights: what each channel adds to each colour, (K, C); sums below 0 are cut off.
    """
    return np.maximum(np.einsum("kc,ptcij->ptkij", weights.astype(np.float32), parts["S"]), 0)


def write(
    path: Path, parts: Mapping[str, np.ndarray], colours: np.ndarray, description: str, nm: np.ndarray | None = None
) -> None:
    """Write what `fields` found, in colours.

    Args:
        colours: as of `coloured`. nm: their wavelengths, rising, for renderers that are spectral; None for R, G and B.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    own = {"rgb": colours} if nm is None else {"spectra": colours, "wavelengths": np.float32(nm)}
    rest = {name: x for name, x in parts.items() if name != "S"}
    write_bytes(path, packed({"description": np.frombuffer(description.encode(), np.uint8), **rest, **own}))


def samples(parts: Mapping[str, np.ndarray], colours: np.ndarray) -> tuple[Between, np.ndarray]:
    """How renderers draw such a file between its samples, and the values of these, (K, N), 1/sr."""
    found = tuple(slices(parts))
    values = [[part.values(plane) for plane in colours[part.azimuth, part.incidence]] for part in found]
    return Nodes(parts, found).between, np.concatenate(values, -1)


def _towards(theta: np.ndarray | float, phi: np.ndarray | float) -> np.ndarray:
    return np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)


def _reflected(brdf: Brdf, incidence: float, o: np.ndarray, reaches: np.ndarray) -> np.ndarray:
    """f cos theta_o towards o (m, n, 3), (C, m, n): 0 below the horizon."""
    raised = np.concatenate([o[..., :2], np.maximum(o[..., 2:], LOWEST)], -1)
    raised = (raised / np.linalg.norm(raised, axis=-1, keepdims=True)).reshape(-1, 3)
    i = np.broadcast_to(_towards(min(incidence, GRAZING), 0.0), raised.shape)
    return brdf(i, raised).reshape(-1, *reaches.shape) * (np.maximum(o[..., 2], 0.0) * reaches)


def _facets(brdf: Brdf) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles of normals, D (1/sr) there, and the matrix (FACETS, FACETS) by which D gives areas that are seen."""
    theta = np.linspace(0, 1, FACETS) ** 2 * np.pi / 2
    around = _towards(np.minimum(theta, GRAZING), 0.0)
    back = np.maximum(brdf(around, around).mean(0), 0.0) * np.cos(theta)
    step = np.diff(theta, prepend=0.0) / 2 + np.diff(theta, append=np.pi / 2) / 2
    solid = 2 * np.pi * np.sin(theta) * step
    level, across = np.outer(np.cos(theta), np.cos(theta)), np.outer(np.sin(theta), np.sin(theta))
    turns = np.cos((np.arange(TURNS) + 0.5) / TURNS * np.pi)
    area = np.mean([np.maximum(level + across * turn, 0.0) for turn in turns], 0) * solid

    def whole(D: np.ndarray) -> np.ndarray:
        return D / max(np.sum(D * np.cos(theta) * solid), 1e-30)

    D = whole(back)
    for _ in range(STEPS):
        D = whole(back * (area @ D))
    return theta, whole((1 - EVEN) * D + EVEN / np.pi), area
