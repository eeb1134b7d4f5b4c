"""What a row of azimuths says about a smooth function, in a few numbers instead of 180 bins.

At one (theta_h, theta_d) the BRDF of an isotropic, reciprocal material is a function of cos^2 phi_d alone: a mirror
image turns phi_d into -phi_d, and exchanging light and viewer turns it into pi - phi_d. Where the horizon cuts the row,
at cos^2 phi_d = u, masking and loss behave like roots of the distance to it: in s = sqrt(1 - cos^2 phi_d / u) both they
and everything else are smooth, so that a polynomial through a few nodes f_k of s gives the function at every bin,
f = B f_k. The weighted squares of a row are then a quadratic form of the nodes,

    sum over bins of w (m - f)^2 = |q - R f_k|^2 + rest,    R^T R = B^T w B,    R^T q = B^T w m,

with an upper triangular R: every bin counts, none is left out or averaged, and a model is evaluated at the nodes alone.
rest is what no smooth function explains.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from .grid import cosines, trigonometry
from .samples import Samples

AZIMUTHS = 8  # nodes of a row of 180 bins; accuracy in `gather`
# Added to R^T R, relative to its trace and times K^2: rows of fewer bins than nodes leave directions open, in which
# rounding, which grows with the nodes, may leave it less than 0.
JITTER = 1e-15


@dataclass(frozen=True)
class Rows:
    """Samples with azimuths gathered row by row.

    Attributes:
        theta_h, theta_d: axes (rad), shapes (H,), (D,). cos_i, cos_o: of light and viewer at the nodes, (H, D, K).
        root: R times the square root of the weights' unit, (C, H, D, K, K). target: q, (C, H, D, K).
        rest: what no function of the nodes explains, (C,), in the unit of w m^2.
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    root: np.ndarray
    target: np.ndarray
    rest: np.ndarray


def gather(samples: Samples, nodes: int) -> Rows:
    """Quadratic forms of all rows of azimuths.

    Args:
        nodes: K per row. Rows of no more bins than that stay as they are.

    Accuracy: of f, weighted as the bins are, relative to all of it: 8 nodes median below 3e-5, worst below 2e-3 over
    the bounds of the fit (``tests/fitting/test_problem.py``).
    """
    if nodes >= len(samples.phi_d):
        root = np.sqrt(samples.weight)
        diagonal = root[..., None] * np.eye(len(samples.phi_d))
        nothing = np.zeros(len(samples.value))
        return Rows(
            samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o, diagonal, root * samples.value, nothing
        )
    at_nodes, squares, products = [], [], []
    for h, theta_h in enumerate(samples.theta_h):
        basis, cos2 = _row(theta_h, samples.theta_d, samples.phi_d, nodes)
        at_nodes.append(cos2)
        weight, value = samples.weight[:, h], samples.value[:, h]
        weighted = np.swapaxes(weight[..., None] * basis, -1, -2)  # (C, D, K, P)
        squares.append(weighted @ basis)
        products.append((weighted @ value[..., None])[..., 0])
    root, target = _triangular(np.stack(squares, 1), np.stack(products, 1))
    energy = np.sum(samples.weight * samples.value**2, (1, 2, 3))
    rest = np.maximum(energy - np.sum(target**2, (1, 2, 3)), 0.0)
    cos_i, cos_o = _at_nodes(samples.theta_h, samples.theta_d, np.stack(at_nodes))
    return Rows(samples.theta_h, samples.theta_d, cos_i, cos_o, root, target, rest)


@dataclass(frozen=True)
class Nodes:
    """Where a smooth function is to be known, and what it is then at every bin.

    Attributes:
        cos_i, cos_o: of light and viewer at the nodes, (H, D, K). basis: B, (H, D, P, K).
    """

    cos_i: np.ndarray
    cos_o: np.ndarray
    basis: np.ndarray

    def at_bins(self, at_nodes: np.ndarray) -> np.ndarray:
        """Values (C, H, D, K) at the nodes as values at the bins, (C, H, D, P); of no meaning below the horizon."""
        return np.moveaxis(self.basis @ np.moveaxis(at_nodes, 0, -1), -1, 0)


def nodes_of(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray, nodes: int) -> Nodes:
    """Nodes of a product grid of angles (rad), phi_d below pi/2.

    Accuracy as in :func:`gather`; a bin that alone in its row is above the horizon (12 of MERL's, at 89.9 degrees) has
    the value of another azimuth near it.
    """
    basis, cos2 = zip(*(_row(h, theta_d, phi_d, nodes) for h in theta_h), strict=True)
    return Nodes(*_at_nodes(theta_h, theta_d, np.stack(cos2)), np.stack(basis))


def _row(theta_h: float, theta_d: np.ndarray, phi_d: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices of one theta_h: B, (D, P, K), and cos^2 phi_d at the nodes, (D, K)."""
    x = -np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    s, low, high, horizon = _positions(theta_h, theta_d, phi_d)
    at_bins = chebvander(np.clip(2 * (s - low) / (high - low) - 1, -1, 1), nodes - 1)
    basis = at_bins @ np.linalg.inv(chebvander(x, nodes - 1))
    return basis, horizon * (1 - (low + (x + 1) / 2 * (high - low)) ** 2)


def _at_nodes(theta_h: np.ndarray, theta_d: np.ndarray, cos2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """cos_i and cos_o of rows (H, D) at some cos^2 phi_d, (H, D, K)."""
    return cosines(trigonometry(theta_h[:, None, None]), trigonometry(theta_d[:, None]), np.sqrt(cos2))


def _positions(
    theta_h: float, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions at one theta_h: s of every bin (D, P), its range over bins above the horizon (D, 1), and u (D, 1)."""
    horizon = np.minimum(1 / np.tan(theta_h) / np.tan(theta_d), 1.0)[:, None] ** 2
    s2 = 1 - np.cos(phi_d) ** 2 / horizon
    s, above = np.sqrt(np.maximum(s2, 0.0)), s2 > 0
    low = np.where(above, s, 1.0).min(-1, keepdims=True)
    high = np.where(above, s, 0.0).max(-1, keepdims=True)
    narrow = high - low < 1e-3  # one bin or none: any range will do that is above the horizon
    return s, np.where(narrow, 0.5, low), np.where(narrow, 1.0, high), horizon


def _triangular(squares: np.ndarray, products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R and q of R^T R = squares (..., K, K), R^T q = products (..., K); zero where squares are."""
    unit = np.trace(squares, axis1=-2, axis2=-1)[..., None, None]
    scale = np.where(unit > 0, unit, 1.0)
    nodes = squares.shape[-1]
    lower = np.linalg.cholesky(squares / scale + (unit == 0) * np.eye(nodes) + JITTER * nodes**2 * np.eye(nodes))
    lower, root_scale = lower * (unit > 0), np.sqrt(scale)
    safe = np.where(unit > 0, lower, np.eye(nodes))
    target = np.linalg.solve(safe, products[..., None] / root_scale)[..., 0]
    return np.swapaxes(lower, -1, -2) * root_scale, target
