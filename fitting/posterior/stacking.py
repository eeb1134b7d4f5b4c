"""Weights of models by how well each one's posterior predicts what it has not seen (Yao et al. 2018).

The data are parted into pieces, as many as residuals are independent. What a model's posterior says of a piece that is
left out follows from its draws by importance weights (PSIS-LOO, Vehtari et al. 2017, by ArviZ). The weights are those
of the mixture of posteriors that predicts the pieces best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from arviz_stats.base.array import array_stats

FEWEST, MOST = 8, 64  # pieces
STEPS, SETTLED = 10_000, 1e-9  # of the search for the weights


class Stacked(NamedTuple):
    """What stacking says of models.

    Attributes:
        weights: of the models, sum 1. pareto_k: the largest of any piece, of each model: above 0.7 its prediction of
            that piece is uncertain.
    """

    weights: np.ndarray
    pareto_k: np.ndarray


def pieces_of(energy: np.ndarray, count: float) -> np.ndarray:
    """Number of the piece that each place is in, (S,), of consecutive places with about the same energy.

    Args:
        energy: of each place, (S,). count: N, how many independent residuals there are.
    """
    many = int(np.clip(round(count), FEWEST, MOST))
    before = np.cumsum(energy) - energy / 2
    return np.minimum((many * before / energy.sum()).astype(int), many - 1)


def log_densities(squares: np.ndarray, pieces: np.ndarray, variance: float, count: float) -> np.ndarray:
    """Logarithms of the probability densities of pieces, (n, B), for n draws.

    Args:
        squares: of residuals, (n, S), summed over all. pieces: which one each is in. variance: of one of N residuals.
            count: N.
    """
    many = int(pieces.max()) + 1
    each = squares @ (pieces[:, None] == np.arange(many))
    return -each / (2 * variance) - count / many * np.log(2 * np.pi * variance) / 2


def stacked(densities: Sequence[np.ndarray]) -> Stacked:
    """Weights of models from the `log_densities` of their draws, (n, B) each, which need not be as many."""
    found = [array_stats.loo(each[None], chain_axis=0, draw_axis=1) for each in densities]
    expected = np.stack([np.asarray(one[0]) for one in found])
    return Stacked(best_mixture(expected), np.array([np.max(one[1]) for one in found]))


def best_mixture(expected: np.ndarray) -> np.ndarray:
    """The weights (M,) for which the sum of log(weights @ exp(expected)) is largest, by expectation-maximisation.

    Args:
        expected: logarithms of densities of what is left out, (M, B).
    """
    densities = np.exp(expected - expected.max(0))
    weights = np.full(len(expected), 1 / len(expected))
    for _ in range(STEPS):
        before, parts = weights, weights[:, None] * densities
        weights = (parts / parts.sum(0)).mean(1)
        if np.abs(weights - before).max() < SETTLED:
            break
    return weights
