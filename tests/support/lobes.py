"""Random lobes and the truth about them, for the tests of the cheap ways to blur the diffraction lobe."""

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model import convolution, scaled

SEED = 20261121
ANGLES = jnp.asarray(((np.arange(90) + 0.5) / 90) ** 2 * np.pi / 2)  # MERL's half angles


def draw(count, low, high, seed=SEED):
    """Random (B, c, beta, p), one column each, log-uniform, c in c - 1."""
    low, high = np.array(low) - [0, 1, 0, 0], np.array(high) - [0, 1, 0, 0]
    return low * (high / low) ** np.random.default_rng(seed).uniform(size=(count, 4)) + [0, 1, 0, 0]


@jax.jit
def truth(lobes):
    """The quadrature at MERL's half angles, one row a lobe."""
    return jax.lax.map(lambda x: convolution.convolve(ANGLES, *x, 64), lobes)


LOW, HIGH = np.array(scaled.RANGE).T * [2, 1, 1, 1]
INSIDE = {"B": 3.0, "c": 2.0, "beta": 0.2, "p": 1.0}
OUTSIDE = [
    {"B": 2.01 * 455}, {"c": 1.005}, {"c": 6.5}, {"beta": 5e-4}, {"beta": 1.2}, {"p": 0.15}, {"p": 6.0},
    {"beta": 0.5, "p": 0.25},
]  # fmt: skip


def lobes_in_range(count, seed=SEED):
    lobes = draw(count, (0.01, *LOW[1:]), HIGH, seed)
    widest = np.minimum(1, scaled.widest_beta(lobes[:, 3]))
    lobes[:, 2] = LOW[2] * (widest / LOW[2]) ** (np.log(lobes[:, 2] / LOW[2]) / np.log(HIGH[2] / LOW[2]))
    return lobes
