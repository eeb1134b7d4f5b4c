"""Directions follow their densities, weights are what they are said to be, and printed densities do not pass."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model.sampling.hemisphere import Cosine
from merlfit.model.sampling.visible import visible
from merlfit.model.two_scale import TwoScale
from scipy.stats import gamma

from tests.reference.samplers import (
    EPD,
    GGX,
    Beckmann,
    Diffracted,
    Facets,
    Mixture,
    hp15,
    hp17,
    interfaced_lambertian,
)
from tests.support.chi_square import AZIMUTHS, densities, draws, expected, given_at, numbers, p_value
from tests.support.compiled import evaluate, from_vectors, prepared

ANGLES = (0.0, 35.0, 70.0, 86.0)
WIDTHS = ((0.003, 0.3), (0.02, 5.0), (0.1, 1.0), (0.4, 0.2), (0.8, 3.0))
LOBES = ((0.3, 1.1), (2.0, 1.5), (10.0, 3.0), (100.0, 5.0))
METAL = {
    "beta": 0.1, "p": 0.6, "b": 3.0, "c": 2.0, "sigma_s": 0.03,
    "n": np.array([1.9, 1.7, 1.6]), "k": np.array([3.6, 3.1, 2.4]),
}  # fmt: skip
PLASTIC = {**METAL, "beta": 0.02, "p": 1.4, "eta": np.array([1.5, 1.5, 1.5]), "albedo": np.array([0.5, 0.2, 0.1])}


def made(kind, *numbers):
    """A sampler, as one program for all numbers."""
    return _made(kind, *(np.asarray(x, float) for x in numbers))


_made = eqx.filter_jit(lambda kind, *numbers: kind(*numbers))


def facets(kind, *numbers):
    return Facets(made(kind, *numbers))


CASES = {
    "cosine": (Cosine,),
    **{f"epd {beta:g} {p:g}": (facets, EPD, beta, p) for beta, p in WIDTHS},
    "ggx": (facets, GGX, 0.3),
    "beckmann": (facets, Beckmann, 0.3),
    **{f"diffracted {b:g} {c:g}": (made, Diffracted, b, c) for b, c in LOBES},
}


def of_model(model, values):
    return eqx.filter_jit(lambda v: visible(lambda g: evaluate(model, v, g)))(prepared(model, values))


@pytest.fixture(scope="module")
def tables():
    model = TwoScale(order=8)
    return {"metal": of_model(model, METAL), "plastic": of_model(TwoScale("plastic", order=8), PLASTIC)}


@pytest.mark.parametrize("name", CASES)
def test_draws_follow_the_density(name):
    seed, (make, *given) = 1 + list(CASES).index(name), CASES[name]
    sampler = make(*given)
    found = [p_value(sampler, given_at(angle), seed=100 * seed + k) for k, angle in enumerate(ANGLES)]
    assert min(found) > 1e-4, found  # of 48 cases one in 200 suites of correct samplers


@pytest.mark.parametrize("name", ["metal", "plastic"])
def test_draws_of_visible_facets_follow_the_density(tables, name):
    found = [p_value(tables[name], given_at(angle), seed=9000 + k) for k, angle in enumerate((*ANGLES, 50.3, 88.0))]
    assert min(found) > 1e-4, found


@pytest.mark.parametrize("make", [hp15, hp17, interfaced_lambertian])
def test_published_mixtures_follow_their_density(make):
    values = {
        hp15: {"beta": 0.1, "p": 0.8, "k_s": 0.4, "k_w": 2e-3, "diffuse_albedo": 0.2},
        hp17: {**METAL, "albedo": 0.3}, interfaced_lambertian: {"roughness": 0.3, "eta": 1.5, "albedo": 0.6},
    }[make]  # fmt: skip
    sampler = eqx.filter_jit(make)({name: np.asarray(x) for name, x in values.items()})
    found = [p_value(sampler, given_at(angle), seed=700 + k) for k, angle in enumerate(ANGLES)]
    assert min(found) > 1e-4, found


class Printed(Diffracted):
    """HP17's density as printed, without 1/M."""

    def density(self, given, drawn):
        return super().density(given, drawn) * self._mass(jnp.hypot(given[..., 0], given[..., 1]))


class TurnedByPi(Diffracted):
    """HP17 Eq. 54 as printed."""

    def draw(self, given, u):
        o = super().draw(given, u)
        f = o[..., :2] + given[..., :2]
        away = -given[..., :2] - f
        return jnp.concatenate([away, jnp.sqrt(jnp.maximum(1 - jnp.sum(away**2, -1, keepdims=True), 0.0))], -1)


class HP15Exponent(EPD):
    """HP15 Eq. 23 as printed: the exponent p/2 in place of 1/(2 p)."""

    def tangent(self, u):
        return self.beta * (super().tangent(u) / self.beta) ** (self.p**2)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ((made, TurnedByPi, 0.8, 1.5), (made, Diffracted, 0.8, 1.5)),
        ((facets, HP15Exponent, 0.1, 0.6), (facets, EPD, 0.1, 0.6)),
        ((facets, EPD, 0.103, 0.6), (facets, EPD, 0.1, 0.6)),
    ],
    ids=["turned by pi", "HP15's exponent", "3 % wider"],
)
def test_printed_errors_and_small_ones_are_rejected(wrong, right):
    wrong, right = (make(*given) for make, *given in (wrong, right))
    given = given_at(60.0)
    assert p_value(right, given, seed=5) > 1e-4
    by_wrong = p_value(right, given, seed=5, density_of=wrong)
    assert min(by_wrong, p_value(wrong, given, seed=5, density_of=right)) < 1e-9


def test_the_printed_density_of_diffracted_light_is_no_density():
    """Its integral is M of Eq. 52."""
    right, given = made(Diffracted, 0.8, 1.5), given_at(60.0)
    share = float(eqx.filter_jit(right._mass)(np.sin(np.radians([60.0])))[0])
    edges = np.linspace(-9, 9, 201), np.linspace(-np.pi, np.pi, AZIMUTHS + 1)
    assert share < 0.6
    for sampler, whole in ((right, 1.0), (made(Printed, 0.8, 1.5), share)):
        assert expected(sampler, given, edges).sum() == pytest.approx(whole, rel=5e-3)


@pytest.mark.parametrize(("beta", "p"), WIDTHS)
def test_quantiles_are_those_of_the_gamma_law(beta, p):
    u = np.array([1e-9, 1e-4, 0.03, 0.4, 0.9, 0.999, 1 - 1e-9])
    expected = beta * gamma.ppf(u, 1 / p) ** (1 / (2 * p))
    np.testing.assert_allclose(eqx.filter_jit(made(EPD, beta, p).tangent)(u), expected, rtol=1e-7)


def weights(sampler, model, values, angle, count=60_000):
    given = given_at(angle)
    drawn = np.asarray(draws(sampler, given, numbers(sampler, count)))
    density = np.asarray(densities(sampler, given, drawn))
    brdf = np.asarray(evaluate(model, values, from_vectors(np.broadcast_to(given, drawn.shape), drawn)))
    counted = (drawn[:, 2] > 0) & (density != 0)
    return np.where(counted, brdf * drawn[:, 2] / np.where(counted, density, 1.0), 0.0)


def test_weights_of_visible_facets_are_bounded_and_even(tables):
    """1.2 times the least they can be; means agree with those of other samplers, whatever the angle."""
    model = TwoScale(order=8)
    values = prepared(model, METAL)
    mixture = Mixture((facets(EPD, 0.1, 0.6), Cosine()), jnp.array([0.7, 0.3]))
    for angle in ANGLES:
        found = weights(tables["metal"], model, values, angle).mean(0)
        assert found.max() < 2.0
        assert found.std() / found.mean() < 0.2
        other = weights(mixture, model, values, angle).mean(0)
        assert abs(found.mean() - other.mean()) < 4 * other.std() / np.sqrt(len(other)) + 0.01 * found.mean()


def test_diffracted_light_is_weighted_by_its_colour_alone():
    """Of the unblurred lobe: (Q/2) G (1 - A) cos^2(theta_h) M phi_max / pi, at most Q/2."""
    model = TwoScale(diffraction="lobe", colour="fresnel", renormalised=False)
    values = {**METAL, "n": np.full(3, 1e-3), "k": np.full(3, 1e3)}  # reflects everything
    only = {**values, "sigma_s": 10.0}  # nothing but diffraction
    for angle in (0.0, 35.0, 70.0):
        found = weights(made(Diffracted, 3.0 / 0.526, 2.0), model, prepared(model, only), angle)[1]
        assert 0.3 < found.max() <= 1 + 1e-9


def test_weights_at_grazing_angles_are_smaller_with_diffraction():
    """HP17 Fig. 9, theta_i = 1.3: 1/pdf of both lobes and of Cook-Torrance alone, towards grazing viewers."""
    values = {**METAL, "albedo": 0.0}
    both, alone = eqx.filter_jit(hp17)(values), facets(EPD, METAL["beta"], METAL["p"])
    theta, phi = np.meshgrid(np.radians(np.linspace(80, 89, 10)), np.linspace(0, 2 * np.pi, 24, endpoint=False))
    drawn = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    given = given_at(np.degrees(1.3), 0.0)
    ours, theirs = (np.log10(1 / np.asarray(densities(s, given, drawn))) for s in (both, alone))
    smaller = ours < theirs
    assert smaller.mean() > 0.9
    assert np.median(theirs - ours) > 1


def test_shares_follow_the_angle():
    parts = (Cosine(), facets(EPD, 0.1, 1.0))
    mixture = Mixture(parts, jnp.array([[1.0, 0.0], [0.0, 1.0]]))
    for cosine in (0.0, 0.25, 1.0):
        given = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
        found = densities(mixture, given, given[None])
        each = [np.asarray(densities(part, given, given[None])) for part in parts]
        np.testing.assert_allclose(found, (1 - cosine) * each[0] + cosine * each[1])
