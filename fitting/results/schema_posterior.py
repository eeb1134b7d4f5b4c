"""How the posterior was sampled."""

import hashlib
from typing import Self

import numpy as np
from pydantic import model_validator

from .strict import FileName, Many, Strict, same_length


class PosteriorResult(Strict):
    """How the sampling went (docs/statistics.md)."""

    sufficient: bool
    """Whether the chain is good enough for intervals; if not, there are no quantiles."""
    message: str
    """Why it is good enough, or why not."""
    steps: int
    """Steps of every walker after tuning."""
    walkers: int
    """Number of walkers."""
    acceptance: float
    """Share of proposals that were accepted."""
    effective_bins: float
    """How many independent residuals those of the fit count as."""
    draws: int
    """Draws from the chain that were weighted by the likelihood of all data."""
    pareto_k: float | None
    """Shape of the largest weights; above 0.7 they cannot be trusted."""
    coordinates: Many[str]
    """Free coordinates; the following lists are by coordinate."""
    autocorrelation_steps: Many[float | None]
    """Autocorrelation time of the chain, in steps."""
    r_hat: Many[float | None]
    """Split R-hat of the chain."""
    bulk_size: Many[float | None]
    """Effective sample size of the chain in the bulk."""
    tail_size: Many[float | None]
    """Effective sample size of the chain in the tails."""
    effective_size: Many[float | None]
    """Effective sample size of the weighted draws."""
    contraction: Many[float | None]
    """One minus the posterior's standard deviation, of which the prior's is one."""
    chain_file: FileName
    """File beside this one with the chain and the draws (docs/result.md)."""
    draws_sha1: str
    """SHA-1 of the draws in it and their weights, by which a chain of another fit is told."""

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        same_length(
            "coordinates", len(self.coordinates), autocorrelation_steps=self.autocorrelation_steps, r_hat=self.r_hat,
            bulk_size=self.bulk_size, tail_size=self.tail_size, effective_size=self.effective_size,
            contraction=self.contraction,
        )  # fmt: skip
        return self


def sha1_of_draws(values: np.ndarray, weights: np.ndarray) -> str:
    """SHA-1 of values (N, P) and weights (N,), whatever the order of bytes here."""
    return hashlib.sha1(b"".join(np.ascontiguousarray(x, "<f8").tobytes() for x in (values, weights))).hexdigest()
