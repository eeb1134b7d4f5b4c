"""Both ways to evaluate the polynomial through Chebyshev nodes."""

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import chebyshev


@pytest.mark.parametrize("count", [2, 5, 24])
def test_recurrence_and_weights_are_the_same_polynomial(count):
    x = jnp.linspace(-0.02, 1.02, 101)  # beyond the ends, too
    values = np.random.default_rng(0).normal(size=(count, 3, 1))
    expected = np.einsum("kc,kx->cx", values[..., 0], chebyshev.weights(x, count))
    np.testing.assert_allclose(chebyshev.evaluate(jnp.asarray(values), x), expected, rtol=1e-12, atol=1e-12)


def test_a_smooth_function_is_met_between_its_nodes():
    x = np.linspace(0, 1, 57)
    values = jnp.exp(jnp.asarray(chebyshev.nodes(16)))
    np.testing.assert_allclose(chebyshev.evaluate(values, jnp.asarray(x)), np.exp(x), rtol=1e-13)


def test_single_precision_is_kept():
    values, x = (jnp.asarray(chebyshev.nodes(9), jnp.float32) for _ in range(2))
    assert chebyshev.evaluate(values, x).dtype == jnp.float32
    assert chebyshev.weights(x, 9).dtype == jnp.float32
