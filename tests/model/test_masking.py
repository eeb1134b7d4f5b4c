"""Smith's masking under the EPD against slow oracles, with wrong formulas that are rejected."""

import jax
import numpy as np
import pytest
from merlfit.model.masking import smith

from tests.oracles import masking as o_masking
from tests.support.arrays import worst

SEED = 20261121
GRAZING = np.linspace(0, np.pi / 2, 4001)
smith_lambda = jax.jit(jax.vmap(smith.smith_lambda))  # a slope and an exponent each
direct = jax.jit(smith.masking_direct)


@jax.jit
def both(cos, beta, p):
    """Masking by the table and direct, and the slopes of each by beta and p."""

    def of(f):
        by = [jax.jvp(lambda *at: f(cos, *at), (beta, p), along)[1] for along in ((1.0, 0.0), (0.0, 1.0))]
        return f(cos, beta, p), by

    return of(smith.masking), of(smith.masking_direct)


def test_smith_lambda_to_1e_8_and_beckmann():
    rng = np.random.default_rng(SEED)
    p = np.concatenate([np.exp(rng.uniform(np.log(0.12), np.log(5), 25)), np.ones(5)])
    tau = np.concatenate([np.exp(rng.uniform(np.log(0.3), np.log(300), 25)), [0.3, 1.0, 3.0, 10.0, 1e3]])
    expected = np.array([float(o_masking.smith_lambda(t, q)) for t, q in zip(tau, p, strict=True)])
    large = expected > 1e-12
    found = np.asarray(smith_lambda(tau, p))
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
    found = np.asarray(smith_lambda(tau, np.full_like(tau, p)))
    masking = np.asarray(direct(np.cos(np.arctan(tau)), 1.0, p))
    assert worst(found[expected > 1e-12], expected[expected > 1e-12]) < of_lambda
    assert np.max(np.abs(masking - 1 / (1 + expected))) < of_masking
    assert worst(found[expected > 1e-12] * (1 + 1e-7), expected[expected > 1e-12]) > of_lambda


@pytest.mark.parametrize("beta", [0.001, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("p", [0.2, 0.5, 1.0, 5.0])
def test_masking_table_to_1e_9(beta, p):
    (table, slopes), (right, right_slopes) = jax.tree.map(np.asarray, both(np.cos(GRAZING), beta, p))
    assert np.max(np.abs(table - right)) < 1e-9
    assert np.all(np.isfinite(slopes))
    for slope, other, number in zip(slopes, right_slopes, (beta, p), strict=True):
        assert np.max(np.abs(slope - other)) * number < 5e-8


@pytest.mark.parametrize(("p", "low", "high"), [(5.2, 5e-5, 7e-5), (8.0, 9e-4, 1e-3), (0.11, 3e-3, 4e-3)])
def test_the_table_ends_with_the_exponents_of_fits(p, low, high):
    """As the docstrings say: beyond them it is no better than this."""
    (table, _), (right, _) = both(np.cos(GRAZING), 0.05, p)
    assert low < np.max(np.abs(np.asarray(table) - np.asarray(right))) < high


@pytest.mark.parametrize("tau", [1, np.int32(1), np.array([1, 1])])
def test_whole_slopes_give_the_same_masking(tau):
    expected = jax.jit(smith.smith_lambda)(1.0, 1.0)
    for p in (1, 1.0):
        found = jax.jit(smith.smith_lambda)(tau, p)
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, np.asarray(expected), rtol=1e-15)


@pytest.mark.parametrize("p", [0.12, 0.9, 8.0])
def test_one_direction_alone_is_as_it_is_among_many(p):
    """Whatever the exponent, beyond that of fits as well, where the table and the integral part."""
    many = np.asarray(jax.jit(smith.masking)(np.cos(GRAZING), 0.3, p))
    alone = jax.jit(smith.masking)
    for k in (0, 1000, 3999):
        assert float(alone(np.cos(GRAZING[k : k + 1]), 0.3, p)[0]) == pytest.approx(many[k], rel=1e-14)
