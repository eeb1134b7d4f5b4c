"""Both ways to evaluate the polynomial through Chebyshev nodes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import chebyshev

evaluate, weights = jax.jit(chebyshev.evaluate), jax.jit(chebyshev.weights, static_argnums=1)


@pytest.mark.parametrize("count", [2, 5, 24])
def test_recurrence_and_weights_are_the_same_polynomial(count):
    x = np.linspace(-0.02, 1.02, 101)  # beyond the ends, too
    values = np.random.default_rng(0).normal(size=(count, 3, 1))
    expected = np.einsum("kc,kx->cx", values[..., 0], weights(x, count))
    np.testing.assert_allclose(evaluate(values, x), expected, rtol=1e-12, atol=1e-12)


def test_a_smooth_function_is_met_between_its_nodes():
    x = np.linspace(0, 1, 57)
    values = np.exp(chebyshev.nodes(16))
    np.testing.assert_allclose(evaluate(values, x), np.exp(x), rtol=1e-13)


def test_single_precision_is_kept():
    values, x = (np.asarray(chebyshev.nodes(9), np.float32) for _ in range(2))
    assert evaluate(values, x).dtype == jnp.float32
    assert weights(x, 9).dtype == jnp.float32
