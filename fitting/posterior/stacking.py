"""Weights of models by how well each one's posterior predicts what it has not seen (Yao et al. 2018).

The data are parted into pieces, as many as residuals are independent. What a model's posterior says of a piece that is
left out follows from its draws by importance weights, smoothed by ArviZ (PSIS-LOO, Vehtari et al. 2017). The weights
are those of the mixture of posteriors that predicts the pieces best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .importance import smoothed

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


class Said(NamedTuple):
    """What draws of a model's posterior say of pieces.

    Attributes:
        contributions: of each piece to the logarithm of the likelihood, (n, B). densities: logarithms of the
            probability density of each piece, (n, B).
    """

    contributions: np.ndarray
    densities: np.ndarray

    @classmethod
    def of(
        cls, squares: np.ndarray, pieces: np.ndarray, log_likelihood: np.ndarray, variance: float, count: float
    ) -> "Said":
        """Of draws by their residuals.

        The likelihood is no product over pieces, since residuals are correlated: each piece has of its logarithm what
        it has of the squares.

        Args:
            squares: of residuals, (n, S). pieces: which one each is in. log_likelihood: of the draws, (n,).
            variance: of one of N residuals. count: N.
        """
        many = int(pieces.max()) + 1
        each = squares @ (pieces[:, None] == np.arange(many))
        densities = -each / (2 * variance) - count / many * np.log(2 * np.pi * variance) / 2
        return cls(log_likelihood[:, None] * each / each.sum(1, keepdims=True), densities)

    def left_out(self) -> tuple[np.ndarray, float]:
        """Logarithms of the density of each piece by the posterior of all others, (B,), and Pareto's largest k."""
        found = [smoothed(-each) for each in self.contributions.T]
        weights = np.stack([w for w, _ in found], 1)
        highest = self.densities.max(0)
        return np.log(np.sum(weights * np.exp(self.densities - highest), 0)) + highest, max(k for _, k in found)


def stacked(models: Sequence[Said]) -> Stacked:
    """Weights of models, each of which may have as many draws as it likes."""
    found = [each.left_out() for each in models]
    return Stacked(best_mixture(np.stack([x for x, _ in found])), np.array([k for _, k in found]))


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
