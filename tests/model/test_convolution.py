"""The convolution (S * D) against slow oracles, with wrong formulas that are rejected."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import convolution
from merlfit.model.two_scale import TwoScale

from tests.oracles import convolution as o_convolution

SEED = 20261121
convolve = jax.jit(convolution.convolve, static_argnums=5)
lobe = jax.jit(jax.vmap(convolution.lobe))  # theta_h, B and c each
surface = jax.jit(convolution.surface, static_argnums=4)
from_surface = jax.jit(convolution.from_surface)


def convolution_cases(count, seed=SEED):
    """Parameters over all of the fit's bounds, half of the half angles near the lobe of normals."""
    rng = np.random.default_rng(seed)
    cases = []
    for k in range(count):
        beta, p = 10 ** rng.uniform(-3, 0), np.exp(rng.uniform(np.log(0.2), np.log(5)))
        c, B = 1 + np.exp(rng.uniform(np.log(0.01), np.log(5))), 10 ** rng.uniform(-2, np.log10(900))
        theta_h = rng.uniform(0, 1.57) if k % 2 else min(1.57, np.arctan(beta * rng.uniform(0, 4)))
        cases.append((theta_h, B, c, beta, p))
    return np.array(cases)


@pytest.fixture(scope="module")
def convolutions():
    """Random cases and what the oracle says of them."""
    cases = convolution_cases(300)
    return cases, np.array([o_convolution.convolve(*case) for case in cases])


@pytest.mark.parametrize(
    ("order", "median", "largest"), [(16, 3e-4, 5e-2), (32, 5e-5, 3e-3), (48, 1e-5, 1e-3), (96, 2e-6, 2e-4)]
)
def test_convolution_in_all_bounds(order, median, largest, convolutions):
    cases, expected = convolutions
    found = jax.jit(jax.vmap(lambda x: convolution.convolve(x[0], x[1], x[2], x[3], x[4], order)))(cases)
    error = np.abs(np.asarray(found) / expected - 1)
    assert np.median(error) < median
    assert error.max() < largest, cases[error.argmax()]


@pytest.mark.parametrize(("order", "case", "least", "most"), [
    (16, (0.784837, 900.0, 6.0, 1.0, 0.203389), 5.1e-2, 5.3e-2),
    (24, (1.54550, 864.357, 1.01, 0.970024, 0.2), 1.3e-2, 1.5e-2),
    (32, (1.54610, 900.0, 1.01096, 1.0, 0.2), 4.9e-3, 5.2e-3),
    (48, (1.56326, 387.595, 1.01002, 0.923081, 0.2), 8e-4, 1e-3),
    (32, (1.51324, 900.0, 6.0, 1e-3, 0.201344), 0.9, 1.0),
])  # fmt: skip
def test_convolution_where_it_is_worst(order, case, least, most):
    """What a search found at the bounds of the fit; the last is a value of 1e-19 (`convolution.convolve`)."""
    error = abs(float(convolve(*case, order)) / o_convolution.convolve(*case) - 1)
    assert least < error < most


def test_convolution_check_rejects_the_dirac_limit(convolutions):
    cases, expected = convolutions
    unblurred = np.asarray(lobe(*cases[:, :3].T))
    assert np.median(np.abs(unblurred / expected - 1)) > 1e-2


def test_convolution_tends_to_the_lobe_for_narrow_normals():
    theta_h = np.linspace(0.0, 1.4, 15)
    wide = convolve(theta_h, 3.0, 2.0, 1e-4, 1.0, 48)
    # D integrates to one with the cosine, and cos = 1 on a narrow lobe
    np.testing.assert_allclose(wide, lobe(theta_h, np.full(15, 3.0), np.full(15, 2.0)), rtol=1e-3)


def test_convolution_gradients_against_differences():
    cases = convolution_cases(40)[:, :]

    def value(x):
        return jnp.log(convolution.convolve(x[0], jnp.exp(x[1]), 1 + jnp.exp(x[2]), jnp.exp(x[3]), jnp.exp(x[4]), 64))

    x = np.column_stack([cases[:, 0], np.log(cases[:, 1]), np.log(cases[:, 2] - 1), np.log(cases[:, 3:])])
    slope = np.asarray(jax.jit(jax.vmap(jax.jacfwd(value)))(x))
    reverse = np.asarray(jax.jit(jax.vmap(jax.jacrev(value)))(x))
    np.testing.assert_allclose(reverse, slope, rtol=1e-9, atol=1e-12)
    batch = jax.jit(jax.vmap(value))
    for k in range(1, 5):
        h = 1e-3 * np.eye(5)[k]
        difference = (np.asarray(batch(x + h)) - np.asarray(batch(x - h))) / 2e-3
        scale = 1 + np.abs(difference)
        assert np.max(np.abs(slope[:, k] - difference) / scale) < 2e-2
        assert np.median(np.abs(slope[:, k] - difference) / scale) < 1e-4


def test_default_order_to_3e_3_on_thousands_of_sets():
    """Against order 96, which the test above holds to 2e-4 of the oracle."""
    cases = convolution_cases(3000, SEED + 1)

    def at(order):
        value = jax.jit(lambda x: jax.lax.map(lambda y: convolution.convolve(*y, order), x, batch_size=500))
        return np.asarray(value(tuple(cases.T)))

    reference = at(96)
    error = np.abs(at(TwoScale().order) / reference - 1)
    assert error.max() < 3e-3, cases[error.argmax()]
    assert np.abs(at(16) / reference - 1).max() > 2e-2  # the comparison sees a quadrature that is too coarse


@pytest.fixture(scope="module")
def grid():
    """Rows of MERL's grid, parameters over all bounds with hard ones, and what order 96 says point by point."""
    theta_h = ((np.arange(4, 90, 15) + 0.5) / 90) ** 2 * np.pi / 2
    cos_d = np.cos((np.arange(0, 90, 3) + 0.5) / 90 * np.pi / 2)
    u = (cos_d[:, None] / np.array([0.645, 0.526, 0.444])).ravel()[None]
    rng = np.random.default_rng(SEED)
    low, high = np.log([0.05, 0.01, 1e-3, 0.2]), np.log([200, 5, 1, 5])
    b, c, beta, p = np.exp(rng.uniform(low, high, (60, 4))).T
    hard = np.array([[166.9, 1.017, 0.573, 4.77], [49.9, 1.015, 0.344, 4.823], [63.6, 2.315, 0.01, 4.778]])
    sets = np.concatenate([np.stack([b, 1 + c, beta, p], 1), hard])
    return theta_h[:, None], u, sets, [np.asarray(convolve(theta_h[:, None], 2 * x[0] * u, *x[1:], 96)) for x in sets]


@pytest.mark.parametrize(("order", "median", "largest"), [(16, 3e-4, 4e-2), (24, 5e-5, 6e-3), (32, 1.5e-5, 3e-3)])
def test_grid_table_is_as_good_as_its_quadrature(order, median, largest, grid):
    """What fits use: table and quadrature together, over all bounds, against order 96 point by point."""
    theta_h, u, sets, points = grid
    table = jax.jit(lambda x: convolution.convolve_many(jnp.asarray(theta_h), jnp.asarray(u), *x, order))
    error = np.array([np.abs(np.asarray(table(x)) / at - 1) for x, at in zip(sets, points, strict=True)])
    assert np.median(error) < median
    assert error.max() < largest, sets[error.max((1, 2)).argmax()]


@pytest.fixture(scope="module", params=range(6))
def looked_up(request):
    """A random lobe from its table at all theta_h, at 80 to 89.5 degrees and beyond: found, expected, peak of each."""
    rng = np.random.default_rng(request.param)
    low, high = np.log([3e-3, 0.25, 0.05, 0.1]), np.log([0.6, 4.0, 4.0, 30.0])
    beta, p, c, b = np.exp(rng.uniform(low, high))
    c, sharpest = 1 + c, 2 * b / 0.444
    everywhere = np.minimum(1.57, np.exp(rng.uniform(np.log(1e-4), np.log(1.57), 500)))
    steep, last = (np.radians(rng.uniform(*ends, 250)) for ends in ((80, 89.5), (89.5, 90)))
    theta = np.stack([everywhere, *(np.resize(x, 500) for x in (steep, last))])
    share = rng.random(theta.shape)
    found = np.asarray(from_surface(surface(sharpest, c, beta, p, 32), theta, share, sharpest))
    expected, peak = (np.asarray(convolve(x, share * sharpest, c, beta, p, 32)) for x in (theta, 0 * theta))
    return found, expected, peak


def test_the_surface_is_the_convolution(looked_up):
    """As its docstring says, and finely enough that nodes even in theta_h itself would be seen."""
    found, expected, peak = looked_up
    off, seen = np.abs(found / expected - 1), expected > 1e-6 * peak
    assert np.median(off[0]) < 1e-7
    assert np.quantile(off[0][seen[0]], 0.98) < 1e-5
    assert off[0][seen[0]].max() < 1e-4
    assert off[1][seen[1]].max() < 1e-5  # 0.01 to 0.5 with nodes two degrees apart
    assert np.all(np.abs(found - expected) < 5e-5 * peak)


def test_the_surface_has_slopes_up_to_the_horizon():
    """Where tan(theta_h) is 1e16, and past it by rounding."""
    table = np.asarray(surface(20.0, 2.0, 0.3, 0.4, 12))

    @jax.jit
    def with_slopes(table, theta, share, sharpest):
        along = (jnp.ones_like(theta),)
        return jax.jvp(lambda theta: convolution.from_surface(table, theta, share, sharpest), (theta,), along)

    for precision in (np.float64, np.float32):
        theta = np.asarray([0.0, 1.5, np.radians(89.9999), np.pi / 2, 1.5708], precision)
        share, sharpest = np.full_like(theta, 0.15), np.asarray(20.0, precision)
        found, slope = with_slopes(table.astype(precision), theta, share, sharpest)
        assert found.dtype == precision
        assert np.all(np.isfinite(slope))
        assert np.all(np.asarray(slope)[2:] == 0)
        np.testing.assert_allclose(np.asarray(found)[2:], np.asarray(found)[3], rtol=1e-3)
