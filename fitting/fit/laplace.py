"""The Gaussian approximation of the posterior at an optimum; its likelihood is that of ``posterior.likelihood``."""

import numpy as np


def likelihood_precision(normal: np.ndarray, cost: float, count: float) -> np.ndarray:
    """Curvature of N/2 S(z)/S_0 at the optimum, (P, P): N H / S_0, H the Gauss-Newton matrix of all channels."""
    return count * np.sum(normal, axis=0)[:-1, :-1] / max(cost, 1e-30)


def laplace_covariance(normal: np.ndarray, cost: float, count: float) -> np.ndarray:
    """Covariance of the Gaussian approximation in free coordinates, (P, P).

    To the curvature of the likelihood the prior, standard normal in these coordinates, adds one. Directions that the
    data leave open are thus held by the prior.

    Args:
        normal: per channel, (C, P+1, P+1). cost: S_0, of all bins and channels. count: effective sample count N.
    """
    precision = likelihood_precision(normal, cost, count)
    return np.linalg.inv(np.eye(len(precision)) + precision)
