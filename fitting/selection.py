"""Choosing among fits of the same samples by the Bayesian information criterion."""

import numpy as np


def bic(channel_costs: np.ndarray, counts: np.ndarray, parameters: int) -> float:
    """BIC of a fit with an unknown scale per channel: sum_c N_c log S_c + P log sum_c N_c; lower is better.

    Args:
        channel_costs: S_c, (C,), relative to one energy. counts: effective sample counts N_c, (C,), the same for all
            fits that are compared. parameters: P.
    """
    return float(np.sum(counts * np.log(np.maximum(channel_costs, 1e-30))) + parameters * np.log(counts.sum()))
