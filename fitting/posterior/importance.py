"""From the chain on a few of the data to the posterior of all: importance weights, and what must hold to trust them.

Draws from the chain are weighed by the ratio of the two likelihoods; the largest weights are smoothed by the
generalised Pareto distribution that they follow (PSIS, Vehtari et al. 2024, by ArviZ), whose shape k says whether the
weighted mean has a finite variance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from arviz_stats.base.array import array_stats

from .chain import Chain, spread_over
from .diagnosis import LEAST_SIZE, Diagnosis, diagnose

LARGEST_K = 0.7  # of the Pareto shape: above it the weights cannot be trusted
DRAWS, MOST_DRAWS = 600, 2400  # on all data: to begin with, and to come to the least size
AT_ONCE = 8  # draws between two words of progress
MARGIN = 1.1  # of what is expected to be enough
GO_ON = "continue the chain with `merlfit sample`"
FEWER = "a longer chain does not mend it, fewer parameters may (`--body`)"
TOO_UNEVEN = (
    "effective size of {name} in {count} weighted draws is {least:.0f}, {most} are needed: the weights are uneven, "
    "since the chain, which uses few of the data, is far from the posterior of all data; " + FEWER
)
TOO_FAR = (
    "the chain, which uses few of the data, is too far from the posterior of all data: Pareto k of its weights "
    "is {k:.2f}, at most {most} is accepted; " + FEWER
)


@dataclass(frozen=True)
class Posterior:
    """The posterior of all data, and what is known about how it was come by.

    Attributes:
        chain: on few of the data. draws: some of its states, (n, P); weights: theirs, smoothed, sum 1, (n,).
        log_ratio: log L of all data minus the chain's, (n,), and log L itself. pareto_k: shape of the largest weights.
        diagnosis: of the chain.
        effective_size: of the weighted draws, (P,). sufficient: whether intervals may be given. message: in a sentence.
        wanted: steps of the chain with which its weighted draws would be enough, where they are not and all else is; 0
        otherwise.
    """

    chain: Chain
    draws: np.ndarray
    weights: np.ndarray
    log_ratio: np.ndarray
    log_likelihood: np.ndarray
    pareto_k: float
    diagnosis: Diagnosis
    effective_size: np.ndarray
    sufficient: bool
    message: str
    wanted: int = 0


def smoothed(log_ratio: np.ndarray) -> tuple[np.ndarray, float]:
    """Smoothed weights that sum to one, and Pareto's k."""
    if np.ptp(log_ratio) < 1e-9:  # equal weights have no tail to fit
        return np.full(len(log_ratio), 1 / len(log_ratio)), 0.0
    log_weights, k = array_stats.psislw(log_ratio.max() - log_ratio)  # it wants minus the logarithms: log likelihoods
    weights = np.exp(log_weights - np.max(log_weights))
    return weights / weights.sum(), float(k)


def sizes(draws: np.ndarray, weights: np.ndarray, independent: np.ndarray) -> np.ndarray:
    """Effective size of weighted draws for the mean of every coordinate, (P,).

    Var(x) / sum w^2 (x - mean)^2 were the draws independent (Owen 2013, Eq. 9.9), in the ratio in which they are.

    Args:
        independent: effective size of the chain they are from, (P,).
    """
    away = (draws - weights @ draws) ** 2
    found = (weights @ away) / np.maximum(weights**2 @ away, 1e-300)
    return found * np.minimum(independent / len(draws), 1.0)


def correct(
    chain: Chain,
    log_few: Callable[[np.ndarray], np.ndarray],
    log_likelihood: Callable[[np.ndarray], np.ndarray],
    names: tuple[str, ...],
    progress: Callable[[int, int], None] = lambda done, most: None,
) -> Posterior:
    """Weigh draws from the chain, as many as make `LEAST_SIZE` if that is possible, and assess all.

    Args:
        log_few: log L of the chain at points (N, P), (N,). log_likelihood: the same on all data.
        names: of the coordinates.
    """
    diagnosis, size = diagnose(chain.states), chain.states.shape[-1]
    failed = [f"{said}; {GO_ON}" for said in diagnosis.failures(names)]
    flat = chain.states.reshape(-1, size)
    draws, log_ratio, of_all, wanted = np.empty((0, size)), np.empty(0), np.empty(0), DRAWS
    while True:
        new = flat[spread_over(len(flat), wanted, len(draws))]
        whole = np.empty(0)
        while len(whole) < len(new):
            whole = np.concatenate([whole, log_likelihood(new[len(whole) :][:AT_ONCE])])
            progress(len(draws) + len(whole), wanted)
        draws, of_all = np.concatenate([draws, new]), np.concatenate([of_all, whole])
        log_ratio = np.concatenate([log_ratio, whole - log_few(new)])
        weights, k = smoothed(log_ratio)
        own = sizes(draws, weights, np.full(size, np.inf)).min()  # what more draws can mend; the chain is for itself
        good = k <= LARGEST_K and own >= LEAST_SIZE
        if good or len(draws) >= MOST_DRAWS or failed:  # a chain that failed is not worth more
            break
        # of few draws k is uncertain by tenths: more of them decide
        wanted = min(int(len(draws) * np.clip(MARGIN * LEAST_SIZE / own, 1.5, 4.0)) + 1, MOST_DRAWS)
    effective = sizes(draws, weights, diagnosis.bulk)
    if not k <= LARGEST_K:
        failed.append(TOO_FAR.format(k=k, most=LARGEST_K))
    longer = 0
    if not (least := effective.min()) >= LEAST_SIZE:
        name = names[int(effective.argmin())]
        if own >= LEAST_SIZE:  # the chain is what is too short for them
            longer = 0 if failed else int(np.ceil(MARGIN * diagnosis.steps * LEAST_SIZE / least))
            failed.append(
                f"effective size of {name} in the weighted draws is {least:.0f}, {LEAST_SIZE} are needed; {GO_ON}"
            )
        else:
            failed.append(TOO_UNEVEN.format(name=name, count=len(draws), least=least, most=LEAST_SIZE))
    good = f"{diagnosis.steps} steps are {diagnosis.ratio:.0f} autocorrelation times, Pareto k {k:.2f}"
    message = (failed or [good])[0]
    return Posterior(chain, draws, weights, log_ratio, of_all, k, diagnosis, effective, not failed, message, longer)
