"""Weights of models by how well each one's posterior predicts what it has not seen (Yao et al. 2018).

The data are parted into pieces, as many as residuals are independent. What a model's posterior says of a piece that is
left out follows from its draws by importance weights, smoothed by ArviZ (PSIS-LOO, Vehtari et al. 2017). The weights
are those of the mixture of posteriors that predicts the pieces best.

Residuals are correlated, and the likelihood is no product over pieces. So what counts for a piece is its density given
all others (Bürkner et al. 2021). The likelihood is that of normal residuals with the precision 2a (1 + U V U^T)
(`likelihood`; V is its ``excess``, U what is ``along``). Of a piece with the residuals e_b, which look like the step
d_b = U_b^T e_b, with r the steps of all others together and H_b = U_b^T U_b,

    log p(b | others, z) = -a (|e_b|^2 + d_b^T V d_b + 2 d_b^T V r + r^T V H_b (1 + V H_b)^-1 V r)
                           - N_b/2 log(2 pi S_0/N) + log|1 + V H_b| / 2.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .importance import smoothed
from .likelihood import Likelihood

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
    numbers = np.minimum((many * before / energy.sum()).astype(int), many - 1)
    return np.unique(numbers, return_inverse=True)[1]  # a peak may fill several


def log_densities(
    likelihood: Likelihood, points: np.ndarray, pieces: np.ndarray, variance: float, counts: np.ndarray
) -> np.ndarray:
    """Logarithms of the density of each piece given all others, (n, B), at points (n, P).

    Args:
        pieces: which one each residual is in, (M,). variance: S_0/N. counts: N_b, of the N residuals, (B,).
    """
    residuals, excess = (likelihood.weighed(points) - likelihood.target).astype(float), likelihood.excess
    steps = np.stack([residuals[:, pieces == b] @ likelihood.along[pieces == b] for b in range(len(counts))], 1)
    found = np.empty(steps.shape[:2])
    for b, count in enumerate(counts):
        along, own, others = likelihood.along[pieces == b], steps[:, b], steps.sum(1) - steps[:, b]
        spread = np.eye(len(excess)) + excess @ along.T @ along
        known = (spread - np.eye(len(excess))) @ np.linalg.solve(spread, excess)
        squares = np.sum(residuals[:, pieces == b] ** 2, 1)
        squares += np.einsum("np,pq,nq->n", own, excess, own + 2 * others)
        squares += np.einsum("np,pq,nq->n", others, known, others)
        scale = np.linalg.slogdet(spread)[1] - count * np.log(2 * np.pi * variance)
        found[:, b] = scale / 2 - likelihood.scale * squares
    return found


def left_out(densities: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
    """Logarithms of the density of each piece by the posterior of all others, (B,), and Pareto's largest k.

    Args:
        densities: of weighted draws, (n, B). weights: theirs, (n,).
    """
    found, shapes = [], []
    for each in densities.T:
        own, k = smoothed(np.log(np.maximum(weights, np.finfo(float).tiny)) - each)
        highest = each.max()
        found.append(np.log(own @ np.exp(each - highest)) + highest)
        shapes.append(k)
    return np.array(found), max(shapes)


def stacked(models: Sequence[tuple[np.ndarray, np.ndarray]]) -> Stacked:
    """Weights of models, by `log_densities` of draws of each, (n, B), and the weights of these, (n,)."""
    found = [left_out(*each) for each in models]
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
