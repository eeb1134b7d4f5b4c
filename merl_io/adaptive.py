"""The adaptive parameterization of Dupuy & Jakob 2018: directions and values of the nodes of a file of RGL's.

For each incidence theta_i a file holds values S at the nodes s of the unit square. A node is warped to u by the density
of visible normals of the file (`warp`); u = (sqrt(2 theta_m / pi), (phi_m - phi_i + pi) / 2 pi) is a facet's normal m,
and what comes from i and is mirrored by it leaves along o. With D and sigma, the file's distribution of normals and
their projected area, bilinear between the nodes of their tables over u(m) and u(i),

    f(i, o) cos theta_o = S(s) D(m) / (4 sigma(i)),

as Mitsuba's plugin `measured` has it, which returns the left side (pbrt-v4's `MeasuredBxDF` divides by the cosine).
These find s by the inverse warp and interpolate S; here every node goes forwards.

A node stands for its part of HP17 Eq. 56, d omega_o cos theta_i d theta_i: the solid angle of the cell around it, times
the integral of the cosine half-way to the incidences beside its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .warp import warped


@dataclass(frozen=True)
class Slice:
    """Samples of one incidence.

    Attributes:
        azimuth, incidence: which of the file's. node: which nodes are samples, (n, n). theta_i, theta_o, phi: of
            them, as of `scattered.ScatteredMeasurement`, (k,).
        factor: BRDF (1/sr) over S, (k,). share: of Eq. 56, (k,).
    """

    azimuth: int
    incidence: int
    node: np.ndarray
    theta_i: np.ndarray
    theta_o: np.ndarray
    phi: np.ndarray
    factor: np.ndarray
    share: np.ndarray


def slices(parts: Mapping[str, np.ndarray]) -> Iterator[Slice]:
    """Samples of every azimuth and incidence that light comes from: at 90 degrees none does.

    Args:
        parts: theta_i (T,), phi_i (P,) (rad), ndf and sigma (h, w), vndf (P, T, H, W), luminance (P, T, n, n), jacobian
            (1,): 0 if S holds f cos theta_o itself.
    """
    theta = parts["theta_i"].astype(float)
    edges = np.concatenate([[0.0], (theta[1:] + theta[:-1]) / 2, [np.pi / 2]])
    cosine = np.diff(np.sin(np.minimum(edges, np.pi / 2)))  # its integral
    for azimuth, phi in enumerate(parts["phi_i"].astype(float)):
        for incidence in np.flatnonzero(theta < np.pi / 2):
            yield _slice(parts, azimuth, int(incidence), phi, float(theta[incidence]), float(cosine[incidence]))


def _slice(
    parts: Mapping[str, np.ndarray], azimuth: int, incidence: int, phi_i: float, theta_i: float, cosine: float
) -> Slice:
    density = parts["vndf"][azimuth, incidence].astype(float)
    luminance = parts["luminance"][azimuth, incidence]
    steps = np.linspace(0, 1, len(luminance))
    u = warped(density, steps, steps)
    o, reaches = mirrored(u, theta_i)
    d = _bilinear(parts["ndf"], u[0], u[1][:, None])
    sigma = _bilinear(
        parts["sigma"], np.asarray(np.sqrt(2 * theta_i / np.pi)), np.asarray((phi_i + np.pi) / (2 * np.pi))
    )
    used = reaches & (o[..., 2] > 0) & (luminance > 0) & (d > 0) & (sigma > 0)
    o, d = o[used], d[used]
    shape = d / (4 * sigma) if parts["jacobian"][0] else np.ones(len(o))
    between = np.concatenate([[0.0], (steps[1:] + steps[:-1]) / 2, [1.0]])
    corners, _ = mirrored(warped(density, between, between), theta_i)
    theta_o, phi = np.arctan2(np.hypot(o[:, 0], o[:, 1]), o[:, 2]), np.arctan2(o[:, 1], o[:, 0])
    share = cosine * solid_angles(corners)[used] / len(parts["phi_i"])
    return Slice(azimuth, incidence, used, np.full(len(o), theta_i), theta_o, phi, shape / o[:, 2], share)


def mirrored(u: tuple[np.ndarray, np.ndarray], theta_i: float) -> tuple[np.ndarray, np.ndarray]:
    """Where light goes that facets at u, (m, n) and (m,), mirror: unit vectors (m, n, 3); and whether it reaches them.

    The azimuth of the light is 0.
    """
    theta, phi = u[0] ** 2 * np.pi / 2, (2 * u[1][:, None] - 1) * np.pi
    m = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    i = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
    cosine = m @ i
    return 2 * cosine[..., None] * m - i, cosine > 0


def solid_angles(corners: np.ndarray) -> np.ndarray:
    """Of cells (sr), (m, n), by unit vectors to their corners (m + 1, n + 1, 3): what is above the horizon of them.

    Two triangles each (Van Oosterom & Strackee 1983, doi:10.1109/TBME.1983.325207); a corner below the horizon is moved
    straight up to it.
    """
    up = corners.copy()
    up[..., 2] = np.maximum(up[..., 2], 0.0)
    up /= np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-300)
    a, b, c, d = up[:-1, :-1], up[1:, :-1], up[1:, 1:], up[:-1, 1:]
    return _triangle(a, b, c) + _triangle(a, c, d)


def _triangle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    ab, bc, ca = (np.sum(x * y, -1) for x, y in ((a, b), (b, c), (c, a)))
    return 2 * np.arctan2(np.abs(np.sum(a * np.cross(b, c), -1)), 1 + ab + bc + ca)


def _bilinear(table: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A table (H, W) over the unit square, x along its columns."""
    x, y = (np.clip(v, 0.0, 1.0) * (n - 1) for v, n in ((x, table.shape[1]), (y, table.shape[0])))
    column, row = (np.minimum(v.astype(int), n - 2) for v, n in ((x, table.shape[1]), (y, table.shape[0])))
    right, down = x - column, y - row
    upper = table[row, column] * (1 - right) + table[row, column + 1] * right
    lower = table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right
    return np.asarray(upper * (1 - down) + lower * down)
