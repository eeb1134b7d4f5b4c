"""The Gaussian approximation of the posterior at an optimum; its likelihood is that of `posterior`."""

import numpy as np


def likelihood_precision(normal: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Curvature of sum_c N_c/2 log S_c at any point, (P, P): sum_c N_c H_c / S_c, H_c the Gauss-Newton matrix."""
    return np.sum([n * m[:-1, :-1] / max(m[-1, -1], 1e-30) for m, n in zip(normal, counts, strict=True)], axis=0)


def laplace_covariance(normal: np.ndarray, counts: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Covariance of the Gaussian approximation in free coordinates, (P, P), with the curvature at ``z``.

    The curvature of N_c/2 log S_c is N_c H_c / S_c with H_c the channel's Gauss-Newton matrix; the logistic prior adds
    2 u (1 - u). Directions that the data leave open are thus held by the prior, never infinite.

    Args:
        normal: per channel, (C, P+1, P+1). counts: effective sample counts N_c, (C,).
    """
    u = 1 / (1 + np.exp(-z))
    return np.linalg.inv(np.diag(2 * u * (1 - u) + 1e-3) + likelihood_precision(normal, counts))
