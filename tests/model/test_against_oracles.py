"""The fast formulas against the slow oracles, each with a wrong formula that the comparison rejects."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from merlfit.model import body, convolution, diffraction, fresnel
from merlfit.model.masking import smith
from merlfit.model.ndf.epd import epd
from merlfit.model.two_scale import TwoScale
from oracles import bodies as o_bodies
from oracles import convolution as o_convolution
from oracles import diffraction as o_diffraction
from oracles import fresnel as o_fresnel
from oracles import masking as o_masking
from oracles import ndf as o_ndf

SEED = 20261121


def worst(found, expected):
    """Largest relative difference."""
    found, expected = (
        np.asarray(found, float),
        np.array([float(x) for x in np.ravel(expected)]).reshape(np.shape(found)),
    )
    return np.max(np.abs(found - expected) / np.maximum(np.abs(expected), 1e-300))


def optical_cases(count=60):
    rng = np.random.default_rng(SEED)
    n = np.exp(rng.uniform(np.log(0.05), np.log(6), count))
    k = np.where(np.arange(count) % 3 == 0, 0.0, np.exp(rng.uniform(np.log(1e-3), np.log(12), count)))
    return rng.uniform(0, np.pi / 2, count), rng.uniform(0, np.pi / 2, count), rng.uniform(0, np.pi, count), n, k


def j(*numbers):
    """JAX arrays of numbers."""
    return [jnp.asarray(x, dtype=float) for x in numbers]


def test_fresnel_to_1e_8():
    theta, _, _, n, k = optical_cases()
    expected = [o_fresnel.fresnel(np.cos(t), *nk) for t, *nk in zip(theta, n, k, strict=True)]
    assert worst(fresnel.fresnel(*j(np.cos(theta), n, k)), expected) < 1e-8
    swapped = [o_fresnel.fresnel(np.cos(t), b, a) for t, a, b in zip(theta, n, k, strict=True) if b > 0]
    assert worst(fresnel.fresnel(*j(np.cos(theta), n, k))[k > 0], swapped) > 1e-2


def test_diffraction_colour_to_1e_8_and_is_half_of_q():
    i, o, phi, n, k = optical_cases()
    dot = -np.sin(i) * np.sin(o) * np.cos(phi)  # phi is counted from the mirror direction
    found = fresnel.diffraction_colour(jnp.cos(i), jnp.cos(o), jnp.asarray(dot), jnp.asarray(n), jnp.asarray(k))
    q = np.array([float(o_fresnel.rayleigh_rice_q(*case)) for case in zip(i, o, phi, n, k, strict=True)])
    assert worst(found, q / 2) < 1e-8
    assert worst(found, q) > 0.4  # the printed Q, twice as much


def test_diffraction_colour_is_fresnel_in_the_mirror_direction():
    theta, _, _, n, k = optical_cases()
    cos = jnp.cos(theta)
    colour = fresnel.diffraction_colour(cos, cos, -(1 - cos**2), jnp.asarray(n), jnp.asarray(k))
    np.testing.assert_allclose(colour, fresnel.fresnel(cos, *j(n, k)), rtol=1e-9)


@pytest.mark.parametrize(("beta", "p"), [(0.001, 0.3), (0.1, 0.2), (0.1, 1.0), (0.5, 5.0), (1.0, 0.7), (2.0, 2.0)])
def test_epd_to_1e_8_and_normalised(beta, p):
    theta = np.arctan(beta * np.array([0.0, 1e-3, 0.3, 1.0, 1.7]))
    assert worst(epd(*j(theta, beta, p)), [o_ndf.epd(t, beta, p) for t in theta]) < 1e-8

    def mass(density):  # over v = 2 p log(tan/beta), where it is smooth
        v, step = np.linspace(-60 * max(p, 0.5), np.log(60.0), 6001, retstep=True)
        tan = beta * np.exp(v / (2 * p))
        t = np.arctan(tan)
        return float(np.sum(density(t) * np.cos(t) * 2 * np.pi * np.sin(t) * np.cos(t) * np.sin(t) / (2 * p)) * step)

    def density(t):
        return np.asarray(epd(*j(t, beta, p)))

    assert mass(density) == pytest.approx(1, abs=1e-8)
    assert mass(lambda t: density(t) * np.cos(t)) != pytest.approx(1, abs=1e-8)


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


def test_renormalisation_to_1e_8():
    rng = np.random.default_rng(SEED)
    s = np.concatenate([rng.uniform(0, 1, 30), [0.0, 1.0, 1.0, 0.999999]])
    bl = np.concatenate([np.exp(rng.uniform(np.log(1e-3), np.log(1e4), 30)), [2.0, 1e4, 1e-3, 300.0]])
    c = np.concatenate([1 + np.exp(rng.uniform(np.log(1e-3), np.log(7), 30)), [2.0, 1.001, 3.0, 1.5]])
    expected = np.array([float(o_diffraction.renormalisation(*case)) for case in zip(s, bl, c, strict=True)])
    found = diffraction.renormalisation(jnp.asarray(s), jnp.asarray(bl), jnp.asarray(c))
    assert worst(found, expected) < 1e-8
    centred = 1 - (1 + bl**2) ** (-(c - 1) / 2)  # as if the disc were always centred
    assert worst(centred, expected) > 1e-2


def test_bodies_to_1e_8():
    rng = np.random.default_rng(SEED)
    for _ in range(12):
        i, o = rng.uniform(0, 1.55, 2)
        n, albedo = rng.uniform(1.001, 3.5), rng.uniform(0.01, 0.999)
        args = (jnp.cos(i), jnp.cos(o), jnp.asarray(n), jnp.asarray(albedo))
        assert float(body.plastic(*args)) == pytest.approx(float(o_bodies.plastic(i, o, n, albedo)), rel=1e-8)
        assert float(body.subsurface(*args)) == pytest.approx(float(o_bodies.subsurface(i, o, n, albedo)), rel=1e-8)
        as_printed = float(body.plastic(*args)) * n**2
        assert as_printed != pytest.approx(float(o_bodies.plastic(i, o, n, albedo)), rel=1e-4)


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
    error = abs(float(convolution.convolve(*j(*case), order)) / o_convolution.convolve(*case) - 1)
    assert least < error < most


def test_convolution_check_rejects_the_dirac_limit(convolutions):
    cases, expected = convolutions
    lobe = np.asarray(jax.vmap(convolution.lobe)(*j(cases[:, 0], cases[:, 1], cases[:, 2])))
    assert np.median(np.abs(lobe / expected - 1)) > 1e-2


def test_convolution_tends_to_the_lobe_for_narrow_normals():
    theta_h = jnp.linspace(0.0, 1.4, 15)
    wide = convolution.convolve(theta_h, *j(3.0, 2.0, 1e-4, 1.0), 48)
    # D integrates to one with the cosine, and cos = 1 on a narrow lobe
    np.testing.assert_allclose(wide, convolution.lobe(theta_h, *j(3.0, 2.0)), rtol=1e-3)


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
        return np.asarray(value(tuple(jnp.asarray(cases.T))))

    reference = at(96)
    error = np.abs(at(TwoScale().order) / reference - 1)
    assert error.max() < 3e-3, cases[error.argmax()]
    assert np.abs(at(16) / reference - 1).max() > 2e-2  # the comparison sees a quadrature that is too coarse


@pytest.mark.parametrize(("order", "median", "largest"), [(16, 3e-4, 4e-2), (24, 5e-5, 6e-3), (32, 1.5e-5, 3e-3)])
def test_grid_table_is_as_good_as_its_quadrature(order, median, largest):
    """What fits use: table and quadrature together, over all bounds, against order 96 point by point."""
    theta_h = jnp.asarray(((np.arange(4, 90, 15) + 0.5) / 90) ** 2 * np.pi / 2)
    cos_d = np.cos((np.arange(0, 90, 3) + 0.5) / 90 * np.pi / 2)
    u = jnp.asarray((cos_d[:, None] / np.array([0.645, 0.526, 0.444])).ravel())[None]
    rng = np.random.default_rng(SEED)
    low, high = np.log([0.05, 0.01, 1e-3, 0.2]), np.log([200, 5, 1, 5])
    b, c, beta, p = np.exp(rng.uniform(low, high, (60, 4))).T
    hard = np.array([[166.9, 1.017, 0.573, 4.77], [49.9, 1.015, 0.344, 4.823], [63.6, 2.315, 0.01, 4.778]])
    sets = np.concatenate([np.stack([b, 1 + c, beta, p], 1), hard])
    points = jax.jit(lambda x: convolution.convolve(theta_h[:, None], 2 * x[0] * u, *x[1:], 96))
    table = jax.jit(lambda x: convolution.convolve_many(theta_h[:, None], u, *x, order))
    error = np.array([np.abs(np.asarray(table(jnp.asarray(x)) / points(jnp.asarray(x))) - 1) for x in sets])
    assert np.median(error) < median
    assert error.max() < largest, sets[error.max((1, 2)).argmax()]


def test_high_precision_fresnel_at_the_edges():
    mp.mp.dps = 30
    for cos in (0.0, 1e-9, 1.0):
        for n, k in ((1.0, 0.0), (0.1, 20.0), (1.5, 0.0)):
            found = float(fresnel.fresnel(jnp.asarray(cos), jnp.asarray(n), jnp.asarray(k)))
            if not (cos == 0.0 and n == 1.0):
                assert found == pytest.approx(float(o_fresnel.fresnel(cos, n, k)), abs=1e-9)
