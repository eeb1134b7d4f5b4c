"""Choosing among fits of the same samples by the Bayesian information criterion."""

import numpy as np


def bic(cost: float, count: float, parameters: int) -> float:
    """BIC of a fit whose residuals have an unknown scale: N log S + P log N; lower is better.

    Args:
        cost: S, relative to one energy. count: effective sample count N, the same for all fits that are compared.
        parameters: P.
    """
    return float(count * np.log(max(cost, 1e-30)) + parameters * np.log(count))
