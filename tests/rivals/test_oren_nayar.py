"""Oren & Nayar's three forms against their equations, against each other, and with a surface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.merl_io.bands import MERL
from merlfit.model.rivals.oren_nayar import OrenNayar
from merlfit.model.rivals.oren_nayar_qualitative import OrenNayarQualitative
from merlfit.scene.surface import Surface

from tests.oracles import microfacets
from tests.oracles import rivals as oracle
from tests.oracles.facets import direction
from tests.reference.cavities import Cavities
from tests.support.compiled import evaluate, from_vectors

ALBEDO = np.array([0.9, 0.5, 0.1])
MATTE, INTEGRAL = OrenNayar(surface="none"), Cavities()


def pairs(count, seed=3, most=80.0):
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(most)), 1, (count, 2)))
    return [[direction(t, rng.uniform(0, 2 * np.pi)) for t in each] for each in theta]


def brdf(model, sigma, i, o):
    return np.asarray(evaluate(model, {"roughness": sigma, "albedo": ALBEDO}, from_vectors(i, o)))


@pytest.mark.parametrize("sigma", [0.1, 0.5, 1.2])
@pytest.mark.parametrize(("model", "of"), [
    (OrenNayarQualitative(), oracle.oren_nayar_qualitative), (MATTE, oracle.oren_nayar_functional),
], ids=["qualitative", "functional"])  # fmt: skip
def test_the_approximations_are_the_papers(model, of, sigma):
    expected = np.transpose([[of(i, o, sigma, x) for x in ALBEDO] for i, o in pairs(30, most=89.0)])
    i, o = np.swapaxes(pairs(30, most=89.0), 0, 1)
    np.testing.assert_allclose(brdf(model, sigma, i, o), expected, rtol=1e-10)
    np.testing.assert_allclose(brdf(model, sigma, o, i), expected, rtol=1e-10)
    assert np.all(np.any(np.abs(brdf(model, 1.001 * sigma, i, o) / expected - 1) > 1e-7, axis=0))


@pytest.mark.parametrize("sigma", [0.2, 0.6])
def test_the_integral_is_that_over_facets(sigma):
    i, o = np.swapaxes(pairs(4, most=70.0), 0, 1)
    ours = brdf(INTEGRAL, sigma, i, o)[0]
    expected, direct = (
        [oracle.cavities(a, b, sigma, ALBEDO[0], 120, 180, bounces) for a, b in zip(i, o, strict=True)]
        for bounces in (True, False)
    )
    np.testing.assert_allclose(ours, expected, rtol=4e-3)
    assert not np.allclose(direct, expected, rtol=4e-3), "interreflection counts"


ERRORS = {  # medians, 95th percentiles and largest of all, over roughnesses and albedos
    "functional": (MATTE, (0.0, 0.03), (0.02, 0.14), 0.29),
    "qualitative": (OrenNayarQualitative(), (0.01, 0.11), (0.08, 0.88), 2.5),
}


@pytest.mark.parametrize("form", ERRORS)
def test_an_approximation_is_as_near_to_the_integral_as_the_documents_say(form):
    """Within 75 degrees, relative; the paper shows agreement in pictures and states no number."""
    model, medians, tails, largest = ERRORS[form]
    i, o = np.swapaxes(pairs(600, 5, 75.0), 0, 1)
    away = np.array([np.abs(brdf(model, s, i, o) / brdf(INTEGRAL, s, i, o) - 1) for s in (0.2, 0.4, 0.6, 0.8)])
    assert medians[0] <= np.median(away, -1).min() <= np.median(away, -1).max() <= medians[1]
    assert tails[0] <= np.quantile(away, 0.95, -1).min() <= np.quantile(away, 0.95, -1).max() <= tails[1]
    assert 0.8 * largest < away.max() < largest


def test_without_roughness_it_is_lamberts():
    i, o = np.swapaxes(pairs(20), 0, 1)
    for model in (MATTE, OrenNayarQualitative()):
        np.testing.assert_allclose(brdf(model, 1e-4, i, o), np.tile(ALBEDO[:, None] / np.pi, 20), rtol=1e-6)
    np.testing.assert_allclose(brdf(INTEGRAL, 1e-3, i, o), np.tile(ALBEDO[:, None] / np.pi, 20), rtol=1e-3)


def test_the_surface_is_torrance_and_sparrows():
    i, o = np.swapaxes(pairs(20), 0, 1)
    g, values = from_vectors(i, o), {"roughness": 0.3, "albedo": ALBEDO, "k_s": np.array([0.1, 0.2, 0.3])}
    lobe = np.asarray(evaluate(OrenNayar(), values, g)) - brdf(MATTE, 0.3, i, o)
    h = (i + o) / np.linalg.norm(i + o, axis=-1, keepdims=True)
    grooves = np.array([microfacets.v_groove(*each) for each in zip(i, o, h, strict=True)])
    expected = values["k_s"][:, None] * np.exp(-((np.arccos(h[:, 2]) / 0.3) ** 2) / 2) * grooves / (i[:, 2] * o[:, 2])
    np.testing.assert_allclose(lobe, expected, rtol=1e-9, atol=1e-12)


def test_gradients_are_finite_along_the_normal_and_in_the_plane():
    up, tilted = direction(0.0, 0.0), direction(0.7, 0.0)
    g = from_vectors(np.array([up, up, tilted, tilted]), np.array([up, tilted, tilted, tilted * [-1, 1, 1]]))
    for model in (MATTE, INTEGRAL):
        slopes = jax.jit(jax.jacfwd(lambda r, model=model: evaluate(model, {"roughness": r, "albedo": ALBEDO}, g)))
        assert np.all(np.isfinite(slopes(0.4)))


def test_to_a_renderer_a_negative_value_is_black():
    """The functional form is negative opposite the light; a picture's light is not."""
    model = OrenNayar(surface="none")
    towards, away = np.array([0.0, 0.9975, 0.07]), np.array([0.0, -0.9975, 0.07])
    g = from_vectors(np.array([towards, towards]), np.array([towards, away]))
    values = {"roughness": jnp.asarray(1.5), "albedo": jnp.asarray(np.full(3, 0.5))}
    found = np.asarray(evaluate(model, values, g)).min(0)
    assert min(found) < 0
    drawn = np.asarray(jax.jit(lambda g: Surface(model, values, MERL).brdf(g))(g)).min(0)
    assert min(drawn) == 0
