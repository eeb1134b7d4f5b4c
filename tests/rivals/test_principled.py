"""Disney's principled model and OpenPBR's base and coat against their oracles, their limits, and light that is kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import chebyshev
from merlfit.model.body import energy_preserving_oren_nayar as of_diffuse
from merlfit.model.rivals.disney import Disney
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.openpbr import OpenPBR, albedo_table

from tests.oracles import rivals as oracle
from tests.oracles.facets import direction
from tests.support.compiled import evaluate, from_vectors

COLOUR = np.array([0.7, 0.3, 0.05])
DISNEY = {
    "baseColor": COLOUR, "metallic": 0.3, "specular": 0.7, "specularTint": 0.4, "roughness": 0.45, "sheen": 0.6,
    "sheenTint": 0.3, "clearcoat": 0.8, "clearcoatGloss": 0.6, "subsurface": 0.35,
}  # fmt: skip
OPENPBR = {
    "base_color": COLOUR, "specular_color": np.array([0.9, 1.0, 0.6]), "coat_color": np.array([0.9, 0.5, 0.8]),
    "specular_roughness": 0.5, "specular_ior": 1.5, "base_metalness": 0.3, "base_diffuse_roughness": 0.6,
    "coat_weight": 0.7, "coat_roughness": 0.3, "coat_ior": 1.6,
}  # fmt: skip
BARE = {**OPENPBR, "coat_weight": 0.0, "base_metalness": 0.0, "specular_color": np.ones(3)}


def pairs(count, seed=3, most=75.0):
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(most)), 1, (count, 2)))
    i, o = np.swapaxes([[direction(t, rng.uniform(0, 2 * np.pi)) for t in each] for each in theta], 0, 1)
    o[::3] = i[::3] * [-1, -1, 1] + 0.1 * rng.normal(size=o[::3].shape)  # near the mirror direction
    return i, o / np.linalg.norm(o, axis=-1, keepdims=True) * np.sign(o[:, 2:])


def brdf(model, values, i, o):
    return np.asarray(evaluate(model, values, from_vectors(i, o)))


@pytest.mark.parametrize("masking", ["smith", "remapped"])
def test_disney_is_burleys(masking):
    i, o = pairs(30, most=88.0)
    expected = np.transpose([oracle.disney(a, b, DISNEY, masking) for a, b in zip(i, o, strict=True)])
    np.testing.assert_allclose(brdf(Disney(masking), DISNEY, i, o), expected, rtol=1e-10)
    np.testing.assert_allclose(brdf(Disney(masking), DISNEY, o, i), expected, rtol=1e-10)
    wrong = np.transpose([oracle.disney(a, b, DISNEY, masking, gain=4.0) for a, b in zip(i, o, strict=True)])
    assert not np.allclose(wrong, expected, rtol=1e-3), "a clearcoat of 1 is a quarter of its facets"


def test_a_disney_metal_is_ggx():
    i, o = pairs(20)
    metal = {**DISNEY, "metallic": 1.0, "clearcoat": 0.0}
    facets = {"alpha": DISNEY["roughness"] ** 2, "F0": COLOUR, "albedo": np.zeros(3)}
    np.testing.assert_allclose(brdf(Disney(), metal, i, o), brdf(GGX(), facets, i, o), rtol=1e-12)
    assert not np.allclose(brdf(Disney("remapped"), metal, i, o), brdf(GGX(), facets, i, o), rtol=0.05)


@pytest.mark.parametrize("coat", [0.0, 0.7, 1.0])
def test_openpbr_is_the_mean_of_both_ways_of_the_specifications_formula(coat):
    i, o = pairs(6)
    values = {**OPENPBR, "coat_weight": coat}
    there, back = (
        np.transpose([oracle.openpbr(*pair, values) for pair in zip(*each, strict=True)]) for each in ((i, o), (o, i))
    )
    found = brdf(OpenPBR(), values, i, o)
    np.testing.assert_allclose(found, (there + back) / 2, rtol=1e-3)
    np.testing.assert_allclose(found, brdf(OpenPBR(), values, o, i), rtol=1e-12)
    for wrong in ({"albedos": False}, *([{"darkening": 0.0}] if coat else [])):
        other = np.transpose([oracle.openpbr(a, b, values, **wrong) for a, b in zip(i, o, strict=True)])
        assert not np.allclose(other, there, rtol=5e-3), wrong


def test_an_openpbr_metal_is_ggx_but_for_masking():
    """White edge tint: Schlick's factor; masking is height-correlated there."""
    i, o = pairs(20)
    metal = {**BARE, "base_metalness": 1.0}
    alpha = OPENPBR["specular_roughness"] ** 2
    facets = brdf(GGX(masking="none"), {"alpha": alpha, "F0": COLOUR, "albedo": np.zeros(3)}, i, o)
    one, other = (np.array([2 / (1 + np.sqrt(1 + alpha**2 * (1 / c**2 - 1))) for c in v[:, 2]]) for v in (i, o))
    np.testing.assert_allclose(brdf(OpenPBR(), metal, i, o), facets / (1 / one + 1 / other - 1), rtol=1e-10)


def test_a_coat_of_no_weight_is_none():
    i, o = pairs(8)
    values = {**OPENPBR, "coat_weight": 0.0}
    other = {**values, "coat_roughness": 0.9, "coat_ior": 2.0, "coat_color": np.full(3, 0.1)}
    np.testing.assert_allclose(brdf(OpenPBR(), values, i, o), brdf(OpenPBR(), other, i, o), rtol=1e-12)


@pytest.mark.parametrize(("roughness", "index"), [(0.032, 1.5), (0.3, 1.5), (0.6, 1.5), (1.0, 1.5), (0.3, 2.5)])
def test_albedos_of_facets_are_those_of_a_finer_rule(roughness, index):
    cosines = np.array([0.03, 0.1, 0.25, 0.5, 0.75, 1.0])
    found = jax.jit(
        lambda: chebyshev.series(albedo_table(*map(jnp.asarray, (roughness**2, index))), jnp.asarray(cosines))
    )()
    expected = [oracle.gloss_albedo(c, roughness**2, index) for c in cosines]
    np.testing.assert_allclose(found, expected, atol=2.5e-3)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_rough_diffuse_facets_are_the_papers_and_keep_all_light(roughness):
    i, o = pairs(6)
    ours = jax.jit(lambda albedo, r=jnp.asarray(roughness), at=(i, o): of_diffuse(from_vectors(*at), r, albedo))
    for albedo in (0.2, 0.9):
        if roughness == 0:
            np.testing.assert_allclose(ours(albedo), albedo / np.pi, rtol=1e-12)
            continue
        expected = [oracle.energy_preserving_oren_nayar(a, b, roughness, albedo) for a, b in zip(i, o, strict=True)]
        np.testing.assert_allclose(ours(albedo), expected, rtol=1e-5)
        # the specification of OpenPBR 0.4 prints another 1/pi in the second term, which loses light
        wrong = [oracle.energy_preserving_oren_nayar(a, b, roughness, albedo, 0.99) for a, b in zip(i, o, strict=True)]
        assert not np.allclose(wrong, expected, rtol=1e-3)
    every, measure = oracle.hemisphere(120)
    for viewer in (direction(0.2, 0.0), direction(1.2, 1.0)):
        white = jax.jit(of_diffuse)(
            from_vectors(every, np.broadcast_to(viewer, every.shape)), jnp.asarray(roughness), jnp.asarray(1.0)
        )
        assert np.sum(np.asarray(white) * every[:, 2]) * measure == pytest.approx(1, abs=2e-4)


def test_white_openpbr_gives_back_all_light_in_the_mean():
    """A diffuse base of white under a gloss of albedo E: 1 + (E - <E>) / 2, as the mean of both ways has it."""
    values = {**BARE, "base_color": np.ones(3), "specular_roughness": 0.3, "base_diffuse_roughness": 0.0}
    every, measure = oracle.hemisphere(200)
    u, w = np.polynomial.legendre.leggauss(12)
    mean = sum(w * (u + 1) / 2 * [oracle.gloss_albedo(c, 0.09, 1.5) for c in (u + 1) / 2])
    for theta in (0.3, 1.2):
        found = brdf(OpenPBR(), values, every, np.broadcast_to(direction(theta, 0.0), every.shape))[0]
        expected = 1 + (oracle.gloss_albedo(np.cos(theta), 0.09, 1.5) - mean) / 2
        assert np.sum(found * every[:, 2]) * measure == pytest.approx(expected, abs=4e-3)


def test_the_gradient_of_disney_is_that_of_differences_but_for_the_luminance():
    """Where nothing is tinted the luminance takes no part; elsewhere its slope alone is left out."""
    i, o = pairs(5)

    @jax.jit
    def both(values):
        slope = jax.jacfwd(lambda v: evaluate(Disney(), v, from_vectors(i, o)))(values)
        return slope["baseColor"], evaluate(Disney(), values, from_vectors(i, o))

    for tints, exact in (({"specularTint": 0.0, "sheenTint": 0.0}, True), ({}, False)):
        values = {k: jnp.asarray(x) for k, x in {**DISNEY, **tints}.items()}
        slope = np.asarray(both(values)[0])[0, ..., 0]
        step = jnp.array([1e-6, 0.0, 0.0])
        more, less = (both({**values, "baseColor": values["baseColor"] + sign * step})[1] for sign in (1, -1))
        difference = np.asarray(more - less)[0] / 2e-6
        assert np.allclose(slope, difference, rtol=1e-6) == exact
