"""The adaptive parameterization of Dupuy & Jakob 2018: directions and values of the nodes of a file of RGL's.

For each incidence theta_i a file holds values S at the nodes s of the unit square. A node is warped to u by the density
of visible normals of the file (`warp`); u = (sqrt(2 theta_m / pi), (phi_m - phi_i + pi) / 2 pi) is a facet's normal m,
and what comes from i and is mirrored by it leaves along o. With D and sigma, the file's distribution of normals and
their projected area, bilinear between the nodes of their tables over u(m) and u(i),

    f(i, o) cos theta_o = S(s) D(m) / (4 sigma(i)),

as Mitsuba's plugin `measured` has it, which returns the left side (pbrt-v4's `MeasuredBxDF` divides by the cosine).
These find s by the inverse warp and interpolate S, between incidences the densities, too (`Nodes.between`, for
pictures alone); for a fit every node goes forwards.

S is bilinear between the nodes, so that the light that a file reflects from i is a sum over them,

    int f cos theta_o d omega_o = sum_k W_k S(s_k),    W_k = int h_k(s) D / (4 sigma) |d omega_o / ds| ds,

with h_k the bilinear hat of node k: Gauss points in every cell of the square, and the warp's own Jacobian. A node's
part of HP17 Eq. 56, d omega_o cos theta_i d theta_i, is W_k over its own D / (4 sigma): the solid angle around it, in
which D may fall off from where the node is; times the integral of the cosine half-way to the incidences beside its own.
Between measured nodes and others, below the horizon, the measured ones stand for all. (Solid angles of cells alone give
the centre of a mirror-like lobe its peak over the whole of the first cell, along which D falls to nothing: 28 times the
light of a glossy film.) All nodes at theta_m = 0 are one direction, of which S has many values: they are one sample,
their mean by W.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .scattered import cosine_shares
from .warp import Densities, warped

GRAZING = np.radians(
    89.99
)  # light from beyond is none: 90 degrees may be stored a little less, and no file measures it
LEAST_SEEN = 1e-3  # of what a value is drawn from, the part that samples have to be
GAUSS = 6  # points along either side of a cell: albedos of RGL's files are within 0.5 % of those by 16


@dataclass(frozen=True)
class Slice:
    """Samples of one incidence.

    Attributes:
        azimuth, incidence: which of the file's. node: which nodes are samples, (n, n), one of those at theta_m = 0.
        normal: weights of these in their mean, (n,). theta_i, theta_o, phi: of the samples, as of
            `scattered.ScatteredMeasurement`, (k,).
        factor: BRDF (1/sr) over S, (k,). solid_angle: (sr), (k,). share: of Eq. 56, (k,).
    """

    azimuth: int
    incidence: int
    node: np.ndarray
    normal: np.ndarray
    theta_i: np.ndarray
    theta_o: np.ndarray
    phi: np.ndarray
    factor: np.ndarray
    solid_angle: np.ndarray
    share: np.ndarray

    def values(self, stored: np.ndarray) -> np.ndarray:
        """BRDF (1/sr) of the samples, (k,), of the S of all nodes, (n, n)."""
        whole, counted = stored.astype(float), self.normal > 0
        if counted.any():
            whole[:, 0] = np.average(whole[counted, 0], weights=self.normal[counted])
        return whole[self.node] * self.factor


@dataclass(frozen=True)
class Nodes:
    """All samples of a file and the way in which renderers draw what lies between them.

    Attributes:
        parts: of the file, as of `slices`. slices: of its samples, in their order.
    """

    parts: Mapping[str, np.ndarray]
    slices: tuple[Slice, ...]

    def between(
        self, values: np.ndarray, theta_i: np.ndarray, cos_o: np.ndarray, theta_m: np.ndarray, phi_m: np.ndarray
    ) -> np.ndarray:
        """BRDF (1/sr), (C, M), as Mitsuba's `measured` has it; NaN where no node around is a sample.

        Where some are none, being below the horizon, the others stand for all; the file has made-up values there.

        Args:
            values: of the samples, (C, N), 1/sr. theta_i, cos_o: of light and viewer, and theta_m, phi_m: of the normal
                between them, phi_m from the light's azimuth (rad), (M,).
        """
        theta = self.parts["theta_i"].astype(float)[: self.slices[-1].incidence + 1]
        low = np.clip(np.searchsorted(theta, theta_i) - 1, 0, max(len(theta) - 2, 0))
        span = theta[np.minimum(low + 1, len(theta) - 1)] - theta[low]
        high = np.clip((theta_i - theta[low]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        beside = [(low, 1 - high), (np.minimum(low + 1, len(theta) - 1), high)]
        u, v = np.sqrt(2 * theta_m / np.pi), (phi_m + np.pi) / (2 * np.pi)
        found = np.zeros((len(values), len(theta_i)))
        for azimuth, phi_i in enumerate(self.parts["phi_i"].astype(float)):
            s, t = Densities(self.parts["vndf"][azimuth, : len(theta)]).back(beside, u, v)
            stored = self._stored(values, azimuth)
            stored, known = np.nan_to_num(stored), np.isfinite(stored).astype(float)
            drawn, seen = (sum(w * _bilinear_of(x, k, s, t) for k, w in beside) for x in (stored, known))
            drawn = np.where(seen > LEAST_SEEN, drawn / np.maximum(seen, LEAST_SEEN), np.nan)
            scale = np.ones_like(u)
            if self.parts["jacobian"][0]:
                sigma = bilinear(self.parts["sigma"], np.sqrt(2 * theta_i / np.pi), (phi_i + np.pi) / (2 * np.pi))
                scale = bilinear(self.parts["ndf"], u, v) / (4 * np.where(sigma > 0, sigma, np.inf))
            found += drawn * scale / cos_o / len(self.parts["phi_i"])
        return found

    def _stored(self, values: np.ndarray, azimuth: int) -> np.ndarray:
        """S of the nodes of every incidence, (C, T, n, n), of values (C, N); NaN at those that are no samples."""
        size, first = self.parts["luminance"].shape[2], 0
        found = np.full((len(values), self.slices[-1].incidence + 1, size, size), np.nan)
        for part in self.slices:
            own = values[:, first : (first := first + len(part.factor))]
            if part.azimuth == azimuth:
                plane = found[:, part.incidence]
                plane[:, part.node] = own / part.factor
                normal = part.node[:, 0]
                plane[:, :, 0] = plane[:, normal, 0] if normal.any() else np.nan
        return found


def slices(parts: Mapping[str, np.ndarray]) -> Iterator[Slice]:
    """Samples of every azimuth and incidence that light comes from: at 90 degrees none does.

    Args:
        parts: theta_i (T,), phi_i (P,) (rad), ndf and sigma (h, w), vndf (P, T, H, W), luminance (P, T, n, n), jacobian
            (1,): 0 if S holds f cos theta_o itself.
    """
    theta = parts["theta_i"].astype(float)
    cosine = cosine_shares(theta)
    for azimuth, phi in enumerate(parts["phi_i"].astype(float)):
        for incidence in np.flatnonzero(theta < GRAZING):
            yield _slice(parts, azimuth, int(incidence), phi, float(theta[incidence]), float(cosine[incidence]))


def _slice(
    parts: Mapping[str, np.ndarray], azimuth: int, incidence: int, phi_i: float, theta_i: float, cosine: float
) -> Slice:
    density = parts["vndf"][azimuth, incidence].astype(float)
    luminance = parts["luminance"][azimuth, incidence]
    sigma = float(bilinear(parts["sigma"], np.sqrt(2 * theta_i / np.pi), (phi_i + np.pi) / (2 * np.pi)))
    steps = np.linspace(0, 1, len(luminance))
    u = warped(density, steps, steps)
    o, reaches = mirrored(u, theta_i)
    scale = _scale(parts, u, sigma)
    used = reaches & (o[..., 2] > 0) & (luminance != 0) & (scale > 0)
    reflected = _weights(parts, density, theta_i, sigma, used)
    solid = np.divide(reflected, scale, out=np.zeros_like(scale), where=used)
    normal = reflected[:, 0]
    solid[:, 0] = solid[:, 0].sum()
    used[:, 0] = (normal > 0) & (np.arange(len(used)) == np.argmax(normal > 0))
    o = o[used]
    theta_o, phi = np.arctan2(np.hypot(o[:, 0], o[:, 1]), o[:, 2]), np.arctan2(o[:, 1], o[:, 0])
    solid_angle = solid[used] / len(parts["phi_i"])
    factor = scale[used] / o[:, 2]
    theta = np.full(len(o), theta_i)
    return Slice(azimuth, incidence, used, normal, theta, theta_o, phi, factor, solid_angle, cosine * solid_angle)


def _scale(parts: Mapping[str, np.ndarray], u: tuple[np.ndarray, np.ndarray], sigma: float) -> np.ndarray:
    """f cos theta_o over S, (m, n), at u: 0 where there is no normal, or none is seen."""
    if not parts["jacobian"][0]:
        return (bilinear(parts["ndf"], u[0], u[1][:, None]) > 0) * 1.0
    return bilinear(parts["ndf"], u[0], u[1][:, None]) / (4 * sigma) if sigma > 0 else np.zeros_like(u[0])


def _weights(
    parts: Mapping[str, np.ndarray], density: np.ndarray, theta_i: float, sigma: float, used: np.ndarray
) -> np.ndarray:
    """W of all nodes, (n, n): how much light is reflected above the horizon of a node's S; 0 where not used."""
    nodes = len(used)
    x, weight = np.polynomial.legendre.leggauss(GAUSS)
    inside = np.tile((x + 1) / 2, nodes - 1)
    cell = np.repeat(np.arange(nodes - 1), GAUSS)
    points = (cell + inside) / (nodes - 1)
    hats = np.zeros((len(points), nodes))
    hats[np.arange(len(points)), cell], hats[np.arange(len(points)), cell + 1] = 1 - inside, inside
    u = warped(density, points, points)
    o, reaches = mirrored(u, theta_i)
    measured = hats @ used @ hats.T
    part = np.tile(weight / (2 * (nodes - 1)), nodes - 1)
    spread = _scale(parts, u, sigma) * _solid_angle(density, u, theta_i) * part * part[:, None]
    whole = np.where(reaches & (o[..., 2] > 0) & (measured > 0), spread, 0.0) / np.where(measured > 0, measured, 1.0)
    return used * (hats.T @ whole @ hats)


def _solid_angle(density: np.ndarray, u: tuple[np.ndarray, np.ndarray], theta_i: float) -> np.ndarray:
    """|d omega_o / ds|, (m, n), at u: of mirrored light, of normals by u, of u by the warp."""
    theta, phi = u[0] ** 2 * np.pi / 2, (2 * u[1][:, None] - 1) * np.pi
    cosine = np.sin(theta) * np.cos(phi) * np.sin(theta_i) + np.cos(theta) * np.cos(theta_i)
    whole = np.mean((density[1:, 1:] + density[1:, :-1] + density[:-1, 1:] + density[:-1, :-1]) / 4)
    here = bilinear(density, u[0], u[1][:, None]) / whole
    normals = 2 * np.pi**2 * u[0] * np.sin(theta)
    return np.divide(4 * np.maximum(cosine, 0.0) * normals, here, out=np.zeros_like(here), where=here > 0)


def mirrored(u: tuple[np.ndarray, np.ndarray], theta_i: float) -> tuple[np.ndarray, np.ndarray]:
    """Where light goes that facets at u, (m, n) and (m,), mirror: unit vectors (m, n, 3); and whether it reaches them.

    The azimuth of the light is 0.
    """
    theta, phi = u[0] ** 2 * np.pi / 2, (2 * u[1][:, None] - 1) * np.pi
    m = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    i = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
    cosine = m @ i
    return 2 * cosine[..., None] * m - i, cosine > 0


def bilinear(table: np.ndarray, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
    """A table (H, W) over the unit square, x along its columns."""
    at_x, at_y = (np.clip(v, 0.0, 1.0) * (n - 1) for v, n in ((x, table.shape[1]), (y, table.shape[0])))
    column = np.minimum(np.asarray(at_x, int), table.shape[1] - 2)
    row = np.minimum(np.asarray(at_y, int), table.shape[0] - 2)
    right, down = at_x - column, at_y - row
    upper = table[row, column] * (1 - right) + table[row, column + 1] * right
    lower = table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right
    return np.asarray(upper * (1 - down) + lower * down)


def _bilinear_of(tables: np.ndarray, which: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`bilinear` of the tables (C, T, n, n) that ``which`` names, (C, M)."""
    size = tables.shape[-1]
    column, row = (np.minimum((np.clip(z, 0.0, 1.0) * (size - 1)).astype(int), size - 2) for z in (x, y))
    right, down = np.clip(x, 0.0, 1.0) * (size - 1) - column, np.clip(y, 0.0, 1.0) * (size - 1) - row
    found = np.zeros((len(tables), len(x)))
    for a, part in ((0, 1 - down), (1, down)):
        for b, other in ((0, 1 - right), (1, right)):
            found += part * other * tables[:, which, row + a, column + b]
    return found
