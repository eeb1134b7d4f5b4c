"""Values at scattered directions on MERL's bins, for pictures alone: nothing that is fitted is interpolated."""

from functools import cache

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import KDTree

from ..merl_io.binary import Dims
from ..merl_io.grid import merl_grid
from ..merl_io.scattered import Between

GRID: Dims = (90, 90, 36)  # theta_h as finely as MERL's files; along phi_d a bin of 5 degrees
REFLECTED = 0.2  # of the range of a coordinate: samples so near to its end are mirrored there
FAR = 0.1  # from the nearest sample, in the coordinates of `_places`: nothing is known there
JITTER = 1e-3  # in the same
FEWEST, MOST = 30, 8000  # samples between which is interpolated


def gridded(
    theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values (C, H, D, P/2) on the folded bins of `GRID`, 1/sr, and which bins the samples cover, (H, D, P/2).

    Linear interpolation of cube roots on a Delaunay triangulation of the samples, light and viewer being exchangeable.
    Bins beyond the samples, or far from all of them, are not covered, and NaN. A sharp highlight between few samples
    comes out too wide: pictures to compare are interpolated from values at the same samples.

    Args:
        theta_h, theta_d, phi_d: of N samples (rad), phi_d in [0, pi/2]. values: (C, N), 1/sr. Of more than `MOST`
            samples so many are used, the same ones of every set of values.
    """
    rows = np.random.default_rng(0).permutation(len(theta_h))[:MOST]
    points, roots = _places(theta_h[rows], theta_d[rows], phi_d[rows]), np.cbrt(values[:, rows]).T
    for axis in range(points.shape[1]):
        near = np.flatnonzero(points[:, axis] < REFLECTED * np.ptp(points[:, axis]))
        mirrored = points[near] * np.where(np.arange(points.shape[1]) == axis, -1.0, 1.0)
        points, roots = np.concatenate([points, mirrored]), np.concatenate([roots, roots[near]])
    # regular samples make flat simplices, among which Qhull loses its way for a minute
    points = points + JITTER * np.random.default_rng(0).standard_normal(points.shape)
    asked, above = _asked()
    found = np.full((len(above), len(values)), np.nan)
    if len(points) > FEWEST:
        near = KDTree(points).query(asked, distance_upper_bound=FAR)[0] < FAR
        found[above] = np.where(near[:, None], LinearNDInterpolator(points, roots)(asked), np.nan)
    shape = GRID[0], GRID[1], GRID[2] // 2
    return (found.T**3).reshape(-1, *shape), np.all(np.isfinite(found), axis=1).reshape(shape)


def drawn(between: Between, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `gridded`, between the samples as their file is drawn, the mean of light and viewer and of both exchanged.

    Args:
        between: of the file. values: in the directions of its samples, (C, N), 1/sr.
    """
    grid, half = merl_grid(GRID), GRID[2] // 2
    theta_h, theta_d, _ = np.meshgrid(grid.theta_h, grid.theta_d, grid.phi_d, indexing="ij")
    cos_i, cos_o, theta_h, theta_d = (x[grid.above] for x in (grid.cos_i, grid.cos_o, theta_h, theta_d))
    theta_i = np.arccos(np.clip(cos_i, -1, 1))
    toward = np.cos(theta_d) - cos_i * np.cos(theta_h)  # sin theta_i sin theta_h cos phi_m
    phi_m = np.arccos(np.clip(toward / np.maximum(np.sin(theta_i) * np.sin(theta_h), 1e-12), -1, 1))
    found = np.full((len(values), *GRID), np.nan)
    found[:, grid.above] = between(values, theta_i, cos_o, theta_h, phi_m)
    both = found[..., :half], found[..., : half - 1 : -1]
    one = np.where(np.isnan(both[0]), both[1], both[0])
    mean = np.where(np.isnan(both[1]), one, (one + both[1]) / 2)
    return mean, np.asarray(np.isfinite(mean).all(0))


def _places(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
    """Coordinates in which a BRDF is smooth, (N, 3): the highlight is wide, and phi_d counts where it matters."""
    across = 2 * np.sin(theta_h) * np.sin(theta_d) * np.abs(np.cos(phi_d))  # |cos_o - cos_i|
    return np.stack([np.sqrt(theta_h / (np.pi / 2)), theta_d / (np.pi / 2), across], -1)


@cache
def _asked() -> tuple[np.ndarray, np.ndarray]:
    """Places of those folded bins that lie above the horizon, and which of all, flat, they are."""
    grid, half = merl_grid(GRID), GRID[2] // 2
    angles = np.meshgrid(grid.theta_h, grid.theta_d, grid.phi_d[:half], indexing="ij")
    above = grid.above[..., :half].ravel()
    return _places(*(x.ravel()[above] for x in angles)), above
