"""Points of the unit square, moved so that uniform ones get a given density: RGL's files are parameterized so.

The density is bilinear between its nodes. First the row is found from the distribution of rows, then the column from
the distribution along the line between the two rows beside it: the mapping is continuous (Mitsuba's `Marginal2D`).
"""

import numpy as np


def warped(density: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the points (x, y) of a lattice go.

    Args:
        density: at nodes, in any unit, (H, W), none negative. x, y: between 0 and 1, (n,), (m,).

    Returns:
        along the columns (m, n), and along the rows (m,); between 0 and 1.
    """
    moved = _quantiles((density[:, 1:] + density[:, :-1]).sum(1), y)
    at = moved * (len(density) - 1)
    row = np.minimum(at.astype(int), len(density) - 2)
    between = (at - row)[:, None]
    lines = (1 - between) * density[row] + between * density[row + 1]
    return np.stack([_quantiles(line, x) for line in lines]), moved


def _quantiles(heights: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Up to where, between 0 and 1, a piecewise linear density holds these shares of all."""
    mass = (heights[1:] + heights[:-1]) / 2
    below = np.concatenate([[0.0], np.cumsum(mass)])
    target = share * below[-1]
    piece = np.clip(np.searchsorted(below, target) - 1, 0, len(mass) - 1)
    low, rise = heights[piece], heights[piece + 1] - heights[piece]
    rest = np.maximum(target - below[piece], 0.0)
    # the root of low t + rise t^2 / 2 = rest, in the form that no subtraction spoils
    root = low + np.sqrt(np.maximum(low**2 + 2 * rise * rest, 0.0))
    inside = np.divide(2 * rest, root, out=np.zeros_like(rest), where=root > 0)
    return (piece + np.minimum(inside, 1.0)) / len(mass)
