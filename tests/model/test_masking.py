"""Smith's masking under the EPD against slow oracles, with wrong formulas that are rejected."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model.masking import smith

from tests.oracles import masking as o_masking
from tests.support.arrays import j, worst

SEED = 20261121


def test_smith_lambda_to_1e_8_and_beckmann():
    rng = np.random.default_rng(SEED)
    p = np.concatenate([np.exp(rng.uniform(np.log(0.12), np.log(5), 25)), np.ones(5)])
    tau = np.concatenate([np.exp(rng.uniform(np.log(0.3), np.log(300), 25)), [0.3, 1.0, 3.0, 10.0, 1e3]])
    expected = np.array([float(o_masking.smith_lambda(t, q)) for t, q in zip(tau, p, strict=True)])
    large = expected > 1e-12
    found = np.asarray(jax.vmap(smith.smith_lambda)(jnp.asarray(tau), jnp.asarray(p)))
    assert worst(found[large], expected[large]) < 1e-8
    assert worst(found[large] / 2, expected[large]) > 0.4  # the printed limits of Eq. 36 give half
    beckmann = [o_masking.beckmann_lambda(t) for t in tau[25:]]
    assert worst(found[25:], beckmann) < 1e-8


@pytest.mark.parametrize(("p", "of_lambda", "of_masking"), [
    (0.12, 1e-10, 1e-14), (0.5, 1e-13, 1e-14), (2.0, 1e-12, 1e-13), (4.0, 1e-9, 3e-10), (5.0, 1.4e-8, 3.3e-9)
])  # fmt: skip
def test_smith_lambda_and_masking_at_all_slopes(p, of_lambda, of_masking):
    """What the docstrings say of the largest exponents, where the rule is least accurate, and of others."""
    tau = np.exp(np.linspace(np.log(max(0.05, 27 ** (-1 / (2 * p)))), np.log(3e3), 400))
    expected = np.array([o_masking.smith_lambda(t, p) for t in tau])
    found = np.asarray(jax.vmap(smith.smith_lambda, (0, None))(*j(tau, p)))
    masking = np.asarray(smith.masking_direct(*j(np.cos(np.arctan(tau)), 1.0, p)))
    assert worst(found[expected > 1e-12], expected[expected > 1e-12]) < of_lambda
    assert np.max(np.abs(masking - 1 / (1 + expected))) < of_masking
    assert worst(found[expected > 1e-12] * (1 + 1e-7), expected[expected > 1e-12]) > of_lambda


@pytest.mark.parametrize("beta", [0.001, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("p", [0.2, 0.5, 1.0, 5.0])
def test_masking_table_to_1e_9(beta, p):
    cos = jnp.cos(jnp.linspace(0, np.pi / 2, 4001))
    table, direct = smith.masking(cos, *j(beta, p)), smith.masking_direct(cos, *j(beta, p))
    assert float(jnp.max(jnp.abs(table - direct))) < 1e-9
    slopes = [jax.jacfwd(lambda x, f=f: f(cos, x[0], x[1]))(jnp.array([beta, p])) for f in (
        smith.masking, smith.masking_direct)]  # fmt: skip
    assert bool(jnp.all(jnp.isfinite(slopes[0])))
    assert float(jnp.max(jnp.abs(slopes[0] - slopes[1]) * jnp.array([beta, p]))) < 5e-8


@pytest.mark.parametrize(("p", "low", "high"), [(5.2, 5e-5, 7e-5), (8.0, 9e-4, 1e-3), (0.11, 3e-3, 4e-3)])
def test_the_table_ends_with_the_exponents_of_fits(p, low, high):
    """As the docstrings say: beyond them it is no better than this."""
    cos = jnp.cos(jnp.linspace(0, np.pi / 2, 2001))
    off = np.abs(smith.masking(cos, *j(0.05, p)) - smith.masking_direct(cos, *j(0.05, p)))
    assert low < off.max() < high


@pytest.mark.parametrize("tau", [1, np.int32(1), np.array([1, 1])])
def test_whole_slopes_give_the_same_masking(tau):
    expected = smith.smith_lambda(jnp.asarray(1.0), jnp.asarray(1.0))
    for p in (1, 1.0):
        found = smith.smith_lambda(tau, p)
        assert found.dtype == jnp.float64
        np.testing.assert_allclose(found, expected, rtol=1e-15)
