"""What is known of a chain, and whether it is enough for intervals; docs/statistics.md says why so much is asked."""

from collections.abc import Sequence
from dataclasses import dataclass

import emcee
import numpy as np
from arviz_stats.base.array import array_stats

ENOUGH = 50  # autocorrelation times a chain must span before intervals are given (emcee's recommendation)
LARGEST_R_HAT = 1.05  # 50 autocorrelation times of independent walkers make 1.02 of halves of them
LEAST_SIZE = 400  # effective draws of every coordinate
TAILS = 0.05, 0.95  # the ends of the intervals
SHORTEST = 100  # steps: of fewer nothing is said
SOON = 400  # steps: a chain that needs no more of them, or no more than it has made, is not worth beginning anew


@dataclass(frozen=True)
class Diagnosis:
    """What is known of a chain, by coordinate, (P,) each.

    Attributes:
        steps: of the chain. times: integrated autocorrelation times (steps), by emcee.
        r_hat: split, over walkers. bulk, tail: effective sizes. These three by ArviZ (Vehtari et al. 2021).
    """

    steps: int
    times: np.ndarray
    r_hat: np.ndarray
    bulk: np.ndarray
    tail: np.ndarray

    @property
    def ratio(self) -> float:
        """How many of the longest autocorrelation times the chain spans."""
        return self.steps / float(self.times.max())

    @property
    def needed(self) -> float:
        """Steps of a chain like this one that would be enough; sizes grow with them, R-hat - 1 falls inversely."""
        least = np.min([self.bulk, self.tail])
        for_sizes = self.steps * LEAST_SIZE / least if least > 0 else np.inf
        for_r_hat = self.steps * (self.r_hat.max() - 1) / (LARGEST_R_HAT - 1)
        return float(np.max([ENOUGH * self.times.max(), for_sizes, for_r_hat]))

    @property
    def slow(self) -> bool:
        """Whether a chain that begins anew, its emulator better, may well be long enough before this one."""
        return not self.needed <= self.steps + max(SOON, self.steps)

    def failures(self, names: Sequence[str] = ()) -> list[str]:
        """In what it is not good enough, in sentences; names: of the coordinates."""
        name = names or tuple(map(str, range(len(self.times))))
        found = []
        if not self.ratio >= ENOUGH:
            found.append(f"{self.steps} steps are {self.ratio:.0f} autocorrelation times, {ENOUGH} are needed")
        if not (worst := self.r_hat.max()) <= LARGEST_R_HAT:
            found.append(
                f"split R-hat of {name[int(self.r_hat.argmax())]} is {worst:.3f}, at most {LARGEST_R_HAT} is accepted"
            )
        for kind, size in (("bulk", self.bulk), ("tail", self.tail)):
            if not (least := size.min()) >= LEAST_SIZE:
                found.append(
                    f"{kind} effective size of {name[int(size.argmin())]} is {least:.0f}, {LEAST_SIZE} are needed"
                )
        return found


def diagnose(states: np.ndarray) -> Diagnosis:
    """Look at a chain's states, (steps, walkers, P)."""
    steps, _, size = states.shape
    if steps < SHORTEST:
        bad, none = np.full(size, np.inf), np.zeros(size)
        return Diagnosis(steps, bad, bad, none, none)
    with np.errstate(invalid="ignore"):  # of a walker that has not moved
        times = emcee.autocorr.integrated_time(states, tol=0, quiet=True)
    each = np.transpose(states, (2, 1, 0))  # (P, walkers, steps), as ArviZ has chains and draws
    return Diagnosis(
        steps,
        np.where(np.isfinite(times), np.maximum(times, 1.0), steps),
        np.asarray(array_stats.rhat(each)),
        np.asarray(array_stats.ess(each, method="bulk")),
        np.asarray(array_stats.ess(each, method="tail", prob=TAILS)),
    )
