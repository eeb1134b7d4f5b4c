"""Points of the unit square, moved so that uniform ones get a given density: RGL's files are parameterized so.

The density is bilinear between its nodes. First the row is found from the distribution of rows, then the column from
the distribution along the line between the two rows beside it: the mapping is continuous (Mitsuba's `Marginal2D`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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


@dataclass(frozen=True)
class Densities:
    """Some densities (T, H, W), of which points are moved by mixtures, and moved back.

    Attributes:
        density: at nodes, in any unit, none negative.
    """

    density: np.ndarray

    @cached_property
    def _along(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of an integral of 1: the densities and their integrals along lines, (T, H, W), and those of the rows."""
        density = self.density.astype(float)
        rows = ((density[..., 1:] + density[..., :-1]) / 2).sum(-1)
        whole = ((rows[:, 1:] + rows[:, :-1]) / 2).sum(-1)[:, None]
        density, rows = density / whole[..., None], rows / whole
        return density, _integral(density), rows, _integral(rows)

    def back(
        self, parts: Sequence[tuple[np.ndarray, np.ndarray]], x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the points (x, y), (M,), come from: along the columns and along the rows, between 0 and 1.

        Args:
            parts: of the mixture at each point: which density, and how much of it, (M,) each.
        """
        density, below, rows, above = self._along
        (row, down), (column, right) = _cell(y, density.shape[1]), _cell(x, density.shape[2])

        def mixed(table: np.ndarray, *at: np.ndarray) -> np.ndarray:
            return np.sum([weight * table[(k, *at)] for k, weight in parts], 0)

        def line(table: np.ndarray, at: np.ndarray) -> np.ndarray:
            return (1 - down) * mixed(table, row, at) + down * mixed(table, row + 1, at)

        last = np.full_like(column, density.shape[2] - 1)
        along = line(below, column) + _within(line(density, column), line(density, column + 1), right)
        across = mixed(above, row) + _within(mixed(rows, row), mixed(rows, row + 1), down)
        total = line(below, last)
        return np.divide(along, total, out=np.zeros_like(along), where=total > 0), across


def _integral(heights: np.ndarray) -> np.ndarray:
    """From the first node to each, along the last axis."""
    found = np.zeros_like(heights)
    np.cumsum((heights[..., 1:] + heights[..., :-1]) / 2, axis=-1, out=found[..., 1:])
    return found


def _within(left: np.ndarray, right: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Integral over the first share of a cell whose ends have these heights."""
    return share * (left + (right - left) * share / 2)


def _cell(x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of ``count`` nodes over the unit interval the one before x, and how far x is from it to the next."""
    place = np.clip(x, 0.0, 1.0) * (count - 1)
    node = np.minimum(place.astype(int), count - 2)
    return node, place - node
