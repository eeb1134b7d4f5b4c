"""Random lobes and the truth about them, at MERL's half angles; what an apparatus makes of lobes of facets."""

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model import convolution
from merlfit.model.acquisition import epd_of_rings, exponent_of_lobe
from merlfit.model.apparatus import APPARATUS

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


def derived_exponent(beta, p, apparatus=APPARATUS):
    """k of the lobe D."""
    return exponent_of_lobe(epd_of_rings(beta, p), apparatus).astype(jnp.result_type(beta))
