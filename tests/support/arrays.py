"""Numbers as arrays of JAX, and how far they are from an oracle's."""

import jax.numpy as jnp
import numpy as np


def j(*numbers):
    """JAX arrays of numbers."""
    return [jnp.asarray(x, dtype=float) for x in numbers]


def worst(found, expected):
    """Largest relative difference."""
    found, expected = (
        np.asarray(found, float),
        np.array([float(x) for x in np.ravel(expected)]).reshape(np.shape(found)),
    )
    return np.max(np.abs(found - expected) / np.maximum(np.abs(expected), 1e-300))
