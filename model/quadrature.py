"""Gauss-Legendre rules, computed once."""

from functools import lru_cache

import numpy as np


@lru_cache
def gauss_legendre(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on [0, 1]: exact for polynomials of degree ``2 * order - 1``."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return (nodes + 1) / 2, weights / 2
