"""Each rival model against an oracle from its paper and against a wrong formula; edges, gradients, reciprocity."""

from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from merlfit.model.published import SOURCES, materials, published
from merlfit.model.rivals import he_series

from tests.rivals import rival_oracles as oracle
from tests.support.compiled import evaluate, from_half_difference, from_vectors

# parameters that a random test draws, log-uniform between two bounds; every channel its own
DRAWN = {
    "sgd": {"alpha": (0.01, 0.8), "p": (0.1, 1.8), "Lambda": (0.5, 5), "c": (1e-3, 1.0), "k": (2, 20),
            "theta0": (0.05, 0.6), "F0": (0.02, 0.9), "F1": (0.01, 0.3), "albedo": (0.1, 1),
            "diffuse_albedo": (0.01, 0.4)},
    "smooth": {"A": (1, 100), "B": (5, 5e3), "C": (0.3, 2), "eta": (1.05, 4), "diffuse_albedo": (0.01, 0.4)},
    "abc-microfacet": {"A": (1, 100), "B": (10, 1e5), "C": (0.3, 2), "eta": (1.05, 8), "diffuse_albedo": (0.01, 0.4)},
    "cook-torrance": {"roughness": (0.2, 1), "eta": (1.05, 8), "albedo": (0.01, 0.3), "diffuse_albedo": (0.01, 0.4)},
    "cook-torrance-ngan": {"roughness": (0.2, 1), "F0": (0.01, 0.9), "albedo": (0.01, 0.9),
                           "diffuse_albedo": (0.01, 0.4)},
    "he": {"roughness": (0.05, 3.0), "autocorrelation": (2, 12), "eta": (1.05, 8), "albedo": (0.1, 3),
           "diffuse_albedo": (0.01, 0.4)},
}  # fmt: skip
RIGHT = {
    "sgd": oracle.sgd,
    "smooth": oracle.smooth,
    "abc-microfacet": oracle.abc_microfacet,
    "cook-torrance": oracle.cook_torrance,
    "cook-torrance-ngan": oracle.cook_torrance_ngan,
    "he": oracle.he,
}
WRONG = {
    "sgd": partial(oracle.sgd, fresnel=oracle.sgd_fresnel_without_f0),
    "smooth": partial(oracle.smooth, cosine=oracle.facet_cosine),
    "abc-microfacet": partial(oracle.abc_microfacet, normalisation=1),  # the paper's Eq. 15
    "cook-torrance": partial(oracle.cook_torrance, masking=oracle.no_masking),
    "cook-torrance-ngan": partial(oracle.cook_torrance_ngan, normalisation=1),
    "he": partial(oracle.he, shadowing=oracle.he_shadowing_as_printed),  # the 1991 print
}
MODELS = list(SOURCES)


def random_parameters(name, rng):
    per_channel = {q.name: q.per_channel for q in SOURCES[name].model.parameters}
    draw = {key: np.exp(rng.uniform(*np.log(bounds), 3)) for key, bounds in DRAWN[name].items()}
    return {key: np.asarray(x if per_channel[key] else x[0]) for key, x in draw.items()}


def evaluated(name):
    """BRDF of parameters in directions, (3, ...)."""
    return partial(evaluate, SOURCES[name].model)


def random_vectors(rng, count):
    """Unit vectors up to 86 degrees from the normal, the second near the first's mirror half of the time."""
    theta, phi = rng.uniform(0.02, 1.5, (2, count)), rng.uniform(0, 2 * np.pi, (2, count))
    mirrored = np.arange(count) % 2 == 0
    theta[1] = np.where(mirrored, np.clip(theta[0] + rng.normal(0, 0.1, count), 0.02, 1.5), theta[1])
    phi[1] = np.where(mirrored, phi[0] + np.pi + rng.normal(0, 0.1, count), phi[1])
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def channel(parameters, index):
    """The scalars of one channel, as the oracles want them."""
    values = {k: mp.mpf(float(v[index] if np.ndim(v) else v)) for k, v in parameters.items()}
    if "theta0" in values:  # SGD's constant: what normalises the distribution
        alpha, p = values["alpha"], values["p"]
        values["K"] = 1 / (alpha * mp.gammainc(1 - p, alpha))
    return values | {"wavelength": mp.mpf((0.645, 0.526, 0.444)[index])}


def check_against(name, reference):
    rng = np.random.default_rng(11)
    for _ in range(3):
        parameters = random_parameters(name, rng)
        i, o = random_vectors(rng, 8)
        ours = np.asarray(evaluated(name)(parameters, from_vectors(i, o)))
        for point in range(8):
            index = point % 3
            pair = [tuple(mp.mpf(float(x)) for x in v[point]) for v in (i, o)]
            unit = [oracle.scaled(v, 1 / oracle.norm(v)) for v in pair]
            assert ours[index, point] == pytest.approx(float(reference(*unit, channel(parameters, index))), rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_agrees_with_its_paper(name):
    check_against(name, RIGHT[name])


@pytest.mark.parametrize("name", MODELS)
def test_a_wrong_formula_is_noticed(name):
    with pytest.raises(AssertionError):
        check_against(name, WRONG[name])


G_AND_E = [(1e-6, 0.0), (0.3, 5.0), (3.0, 400.0), (40.0, 0.0), (49.0, 30.0), (53.0, 10.0), (60.0, 900.0), (150.0, 2e3),
           (2.0, 6e3), (900.0, 0.0), (900.0, 2e4), (6e4, 0.0), (6e4, 3e5)]  # fmt: skip


def check_series(series):
    series = jax.jit(series)
    for g, e in G_AND_E:
        exact = oracle.he_sum(mp.mpf(g), mp.mpf(e)) / g
        assert float(series(g, e)) == pytest.approx(float(exact), rel=2e-9), (g, e)


def test_he_series_from_smooth_to_very_rough():
    check_series(he_series.full)


def test_he_series_cut_short_is_noticed():
    """Ten terms, as some implementations have, are not enough."""
    m = np.arange(1, 11)
    short = lambda g, e: jnp.sum(jnp.exp(m * jnp.log(g) - g - jax.scipy.special.gammaln(m + 1.0) - e / m) / m) / g  # noqa: E731
    with pytest.raises(AssertionError):
        check_series(short)


def he_domain():
    """g and e over what the table holds, more of them where the lobe is bright."""
    rng = np.random.default_rng(4)
    g = np.exp(rng.uniform(np.log(1e-8), np.log(4e5), 100_000))
    return g, 60 * rng.uniform(size=g.size) ** 4 * (1 + g)


def test_he_series_looked_up_is_the_sum():
    """Values to 1e-7, derivatives by log g and log e to 2e-5 of the value."""
    g, e = he_domain()
    right, tried = (jax.jit(partial(jax.jvp, f)) for f in (he_series.full, he_series.series))
    for along in ((g, 0 * e), (0 * g, e)):
        (value, slope), (looked_up, its_slope) = right((g, e), along), tried((g, e), along)
        assert np.mean(np.asarray(value) != np.asarray(looked_up)) > 0.9  # it is another route
        np.testing.assert_allclose(looked_up, value, rtol=1e-7)
        assert np.all(np.abs(np.asarray(its_slope) - np.asarray(slope)) <= 2e-5 * np.asarray(value))


def test_he_series_looked_up_stays_finite_beyond_its_table():
    """Black or nearly so, and falling with e."""
    phases, decays = [0.0, 1e-300, 1e-12, 1.0, 4e5, 1e9], np.geomspace(50, 1e6, 1000)
    g, decay = (x.ravel() for x in np.meshgrid(phases, decays, indexing="ij"))
    e, slope = decay * (1 + g), jax.jit(partial(jax.jvp, he_series.series))
    (value, by_e), (_, by_g) = (np.asarray(slope((g, e), along)) for along in ((0 * g, 1 + 0 * e), (1 + 0 * g, 0 * e)))
    assert np.isfinite([value, by_e, by_g]).all()
    assert (value >= 0).all()
    assert (np.diff(value.reshape(len(phases), -1)) <= 0).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_he_series_looked_up_has_the_slopes_of_a_black_lobe(precision):
    """The table begins at g = 1e-8; slopes below are those of the sum there."""
    e = np.linspace(0.0, 3.0, 6000, dtype=precision)
    ours, sums = (
        jax.jit(partial(jax.jvp, f))
        for f in (he_series.series, lambda g, e: he_series.full(g.astype(float) + 1e-11, e.astype(float)))
    )
    for g in (0.0, 1e-12, 1e-6):
        at, along = (np.full_like(e, g), e), (np.ones_like(e), 0 * e)
        (value, by_g), (_, expected) = ours(at, along), sums(at, along)
        assert value.dtype == precision
        np.testing.assert_allclose(value, np.exp(-e), rtol=1e-5)
        np.testing.assert_allclose(by_g, expected, rtol=1e-3, atol=1e-3)


def test_he_geometrical_factor_collapses():
    """Eq. 76's polarisation vectors drop out: G = (v.v / v_z)^2."""
    for i, o in np.swapaxes(random_vectors(np.random.default_rng(2), 10), 0, 1):
        pair = [tuple(mp.mpf(float(x)) for x in v) for v in (i, o)]
        i_, o_ = (oracle.scaled(v, 1 / oracle.norm(v)) for v in pair)
        simple = ((2 + 2 * oracle.dot(i_, o_)) / (i_[2] + o_[2])) ** 2
        assert float(oracle.he_geometry(i_, o_) / simple) == pytest.approx(1, rel=1e-12)


def test_lambert_w():
    x = np.array([0.0, 1e-12, 1e-3, 0.5, 3.0, 1e3, 1e50, 1e249])
    w, slope = map(np.asarray, jax.jit(jax.vmap(jax.value_and_grad(he_series.lambert_w)))(x))
    np.testing.assert_allclose(w, [float(mp.lambertw(float(v)).real) for v in x], rtol=1e-14)
    np.testing.assert_allclose(slope, np.exp(-w) / (1 + w), rtol=1e-14)


# --- edges


EDGES = {
    "theta_h = 0": (0.0, 0.7, 0.3),
    "theta_d = 0": (0.6, 0.0, 0.0),
    "i = o = n": (0.0, 0.0, 0.0),
    "theta_d = pi/2": (0.0, np.pi / 2, 0.5),
    "theta_d = pi/2, tilted": (0.4, np.pi / 2, np.pi / 2),
    "theta_h = pi/2": (np.pi / 2, 0.3, np.pi / 2),
    "almost grazing": (0.5, np.pi / 2 - 0.5 - 1e-9, np.pi),
    "grazing": (0.5, np.pi / 2 - 0.5, np.pi),
    "both grazing": (0.0, np.pi / 2 - 1e-12, 0.0),
    "below": (1.0, 1.2, 0.0),
    "far from the lobe": (1.4, 0.2, 1.0),
}


def edges():
    """The edges from angles, and both cosines exactly 1 or 0 from vectors."""
    angles = from_half_difference(*np.array(list(EDGES.values())).T)
    n, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    vectors = from_vectors(np.stack([n, n, x, x, x]), np.stack([n, x, n, x, -x]))
    return jax.tree.map(lambda a, b: jnp.asarray(np.concatenate([a, b])), angles, vectors)


@pytest.mark.parametrize("name", MODELS)
def test_values_and_gradients_are_finite_at_every_edge(name):
    """For every published set of parameters, forward and backward."""
    function, geometry = evaluated(name), edges()
    every = jax.jit(lambda *at: (function(*at), jax.jacfwd(function)(*at), jax.jacrev(function)(*at)))
    for material in materials(name):
        brdf, *jacobians = every(published(material, name), geometry)
        assert np.isfinite(brdf).all(), material
        assert brdf.shape == (3, len(EDGES) + 5)
        for jacobian in jacobians:
            for key, slope in jacobian.items():
                assert np.isfinite(slope).all(), (material, key)


@pytest.mark.parametrize("name", MODELS)
def test_is_zero_below_the_surface_and_not_above(name):
    parameters = published("alum-bronze", name)
    i = np.array([[0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.6, 0.0, -0.8]])
    o = np.array([[-0.6, 0.0, 0.8], [-0.8, 0.0, -0.6], [-0.6, 0.0, -0.8]])
    brdf = np.asarray(evaluated(name)(parameters, from_vectors(i, o)))
    assert (brdf[:, 0] > 0).all()
    assert (brdf[:, 1:] == 0).all()


@pytest.mark.parametrize("name", MODELS)
def test_is_reciprocal(name):
    rng = np.random.default_rng(5)
    i, o = random_vectors(rng, 200)
    for _ in range(3):
        parameters = random_parameters(name, rng)
        there = evaluated(name)(parameters, from_vectors(i, o))
        back = evaluated(name)(parameters, from_vectors(o, i))
        np.testing.assert_allclose(there, back, rtol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_gradients_are_finite_differences(name):
    """In the logarithm of every parameter, central differences."""
    rng = np.random.default_rng(8)
    parameters = random_parameters(name, rng)
    geometry = from_vectors(*random_vectors(rng, 12))

    def of_logs(logs):
        return evaluated(name)({k: jnp.exp(v) for k, v in logs.items()}, geometry)

    logs, step = {k: np.log(v) for k, v in parameters.items()}, 1e-5
    along = jax.jit(lambda logs, direction: jax.jvp(of_logs, (logs,), (direction,)))
    for k in logs:
        direction = {n: np.ones_like(v) * (n == k) for n, v in logs.items()}
        less, (value, slope), more = (
            np.asarray(along({n: v + s * step * direction[n] for n, v in logs.items()}, direction)) for s in (-1, 0, 1)
        )
        difference = (more[0] - less[0]) / (2 * step)
        tolerance = 1e-6 * (np.abs(difference) + np.abs(value))
        assert (np.abs(slope - difference) <= tolerance).all(), k


@pytest.mark.parametrize("name", MODELS)
def test_grid_and_list_are_the_same(name):
    theta_h, theta_d, phi_d = np.linspace(0.01, 0.6, 4), np.linspace(0.05, 0.8, 3), np.linspace(0.1, 3, 2)
    grid = from_half_difference(theta_h[:, None, None], theta_d[:, None], phi_d)
    scattered = from_half_difference(*(x.ravel() for x in np.meshgrid(theta_h, theta_d, phi_d, indexing="ij")))
    parameters = published("nickel", name)
    on_grid, on_list = (np.asarray(evaluated(name)(parameters, each)) for each in (grid, scattered))
    assert on_grid.shape == (3, 4, 3, 2)
    np.testing.assert_allclose(on_grid.reshape(3, -1), on_list, rtol=1e-12)
