"""Free coordinates: inverse of the values, standard normal under the stated priors, harmless far out."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.models import candidates, layout_for, two_scale
from merlfit.fitting.settings.config import Config, ConfigError, load, parse
from merlfit.model.diffraction import renormalisation
from merlfit.model.effects import KINDS
from merlfit.model.measured import Measured
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.priors import PRIORS, LogNormal
from merlfit.model.two_scale import TwoScale
from scipy.special import ndtr
from scipy.stats import kstest, truncnorm

LAYOUTS = {
    body if index == TwoScale(body).index else f"{index} {body}": layout_of(Measured(TwoScale(body, index=index)))
    for index, body in KINDS
} | {
    "no diffraction": layout_of(TwoScale("plastic", "off")),
    "not renormalised": layout_of(Measured(TwoScale("none", renormalised=False))),
}
DRAWS = 4000
pytestmark = pytest.mark.usefixtures("compiled_quickly")
every = pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)


def drawn(layout, seed=0, most=4.0):
    """Draws from the prior, (DRAWS, P), and the parameters that they are."""
    z = np.clip(np.random.default_rng(seed).normal(size=(DRAWS, layout.size)), -most, most)
    return z, layout.values(z)


def bounds(layout):
    return np.array([(q.lower, q.upper) for q in layout.entries]).T


def half_width(values):
    return values["beta"] * np.log(2) ** (1 / (2 * values["p"]))


def share(values):
    """Of the diffracted light at normal incidence and the middle wavelength, what goes where directions are."""
    return jax.jit(renormalisation)(0.0, values["b"] / WAVELENGTHS_UM[1], values["c"])


def expected(layout, name, values):
    """Median and factor of the log-normal that is cut at the bounds, given other parameters, as documented."""
    q = next(q for q in layout.parameters if q.name == name)
    prior = getattr(layout.priors, q.quantity or name)
    median = np.full(np.shape(values[name]), prior.median)
    factor = np.full(np.shape(values[name]), prior.factor)
    if name == "beta":
        median = prior.median / np.log(2) ** (1 / (2 * values["p"]))
    if name == "sigma_s" and layout.material.renormalised:
        median = prior.median / np.sqrt(np.asarray(share(values)))
    if name == "eta":
        outer, dispersion = np.array([True, False, True]), layout.priors.dispersion
        median[:, outer] = dispersion.median * (values["eta"][:, [1]] - 1)
        factor[:, outer] = dispersion.factor
    return median, factor


def middle_and_factor(x):
    """Median and the factor of a standard deviation, by quantiles: what is cut off far out does not matter."""
    low, middle, high = np.quantile(x, ndtr([-1.0, 0.0, 1.0]))
    return middle, np.sqrt(high / low)


@every
def test_values_and_free_coordinates_are_inverse(layout):
    z, values = drawn(layout)
    for k in range(20):
        np.testing.assert_allclose(layout.free({name: x[k] for name, x in values.items()}), z[k], atol=1e-8)
    flat = np.concatenate([values[q.name].reshape(DRAWS, -1) for q in layout.parameters], 1)
    assert flat.shape == (DRAWS, layout.size) == (DRAWS, len(layout.names)) == (DRAWS, len(layout.entries))
    for k in range(3):
        np.testing.assert_allclose(layout.flat(z[k]), flat[k], rtol=1e-12)


@every
def test_slopes_are_those_of_central_differences(layout):
    def flat(z):
        return layout.flat(z)

    h = 1e-5
    for z in np.random.default_rng(1).normal(size=(5, layout.size)):
        slopes = layout.slopes(z)
        differences = np.array([(flat(z + e) - flat(z - e)) / (2 * h) for e in h * np.eye(layout.size)]).T
        np.testing.assert_allclose(slopes, differences, rtol=1e-6, atol=1e-8 * np.abs(flat(z)).max())
        where = layout.slices
        assert slopes[where["beta"], where["p"]] != 0
        assert slopes[where["p"], where["beta"]] == 0
        if "sigma_s" in where and layout.material.renormalised:
            assert np.all(slopes[where["sigma_s"], where["b"]] != 0)
            assert np.all(slopes[where["sigma_s"], where["c"]] != 0)
        if "eta" in where:
            assert np.array_equal(slopes[where["eta"], where["eta"]] != 0, [[1, 1, 0], [0, 1, 0], [0, 1, 1]])


def test_what_moves_with_others_does_so_in_a_sum():
    """The half width of the second surface with its own kurtosis, and not with that of the first."""
    config = load(model="epd+two-scale")
    layout = layout_for(config, candidates(config)[0])
    z = 0.5 * np.random.default_rng(7).normal(size=layout.size)
    np.testing.assert_allclose(layout.free(layout.values(z)), z, atol=1e-8)
    slopes, where = layout.slopes(z), layout.slices
    names = [name for name in where if name.startswith("beta")]
    assert len(names) == 2
    for name in names:
        own, other = name.replace("beta", "p"), next(n for n in names if n != name).replace("beta", "p")
        assert np.all(slopes[where[name], where[own]] != 0)
        assert np.all(slopes[where[name], where[other]] == 0)
    np.testing.assert_allclose(slopes, jax.jit(jax.jacfwd(layout.flat))(z), rtol=1e-9, atol=1e-12)


@every
def test_jax_traces_the_same_values_and_its_derivatives_are_the_slopes(layout):
    for z in 2 * np.random.default_rng(4).normal(size=(3, layout.size)):
        np.testing.assert_allclose(jax.jit(layout.flat)(z), layout.flat(z), rtol=1e-11)
        traced = jax.jit(jax.jacfwd(layout.flat))(z)
        np.testing.assert_allclose(layout.slopes(z), traced, rtol=1e-9, atol=1e-12 * np.abs(traced).max())


@every
def test_bounds_are_reached_and_never_exceeded(layout):
    low, high = bounds(layout)
    for far in (14.0, 800.0):
        for sign, bound in ((-1, low), (1, high)):
            z = jnp.full(layout.size, sign * far)
            np.testing.assert_allclose(layout.flat(z), bound, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(layout.position(z), float(sign > 0), atol=1e-9)
    corners = np.sign(np.random.default_rng(2).normal(size=(50, layout.size)))
    points = np.concatenate([14 * corners, 800 * corners, 5 * drawn(layout, 3)[0][:50]])
    flat = layout.flat(points)
    assert np.all(np.isfinite(flat))
    assert np.all((low * (1 - 1e-12) <= flat) & (flat <= high * (1 + 1e-12)))
    assert np.all(np.isfinite(layout.slopes(points)))


@every
def test_values_beyond_their_bounds_are_moved_just_inside(layout):
    low, high = bounds(layout)
    for beyond, bound in ((0.5 * low - 0.1, low), (2 * high, high)):
        values = {q.name: beyond[where] if q.per_channel else beyond[where][0] for q, where in
                  zip(layout.parameters, layout.slices.values(), strict=True)}  # fmt: skip
        z = layout.free(values)
        assert np.all(np.isfinite(z))
        np.testing.assert_allclose(layout.flat(z), bound, rtol=1e-4, atol=2e-6)
        assert np.all(np.abs(layout.slopes(z).diagonal()) > 0)


@every
def test_values_are_what_the_priors_make_of_standard_normal_coordinates(layout):
    """Quantiles of each given the others: of a log-normal cut at the bounds, of log-normal odds, or uniform."""
    z, values = drawn(layout)
    for q, where in zip(layout.parameters, layout.slices.values(), strict=True):
        place = z[:, where] if q.per_channel else z[:, where][:, 0]
        if q.name == "albedo":
            odds = layout.priors.odds.median * layout.priors.odds.factor**place
            np.testing.assert_allclose(values[q.name], odds / (1 + odds), rtol=1e-9)
            continue
        if q.scale == "linear":
            np.testing.assert_allclose(values[q.name], q.lower + (q.upper - q.lower) * ndtr(place), rtol=1e-9)
            continue
        median, factor = expected(layout, q.name, values)
        scale = np.log(factor)
        low, high = ((np.log(x - q.offset) - np.log(median)) / scale for x in (q.lower, q.upper))
        logarithm = truncnorm.ppf(ndtr(place), low, high, loc=np.log(median), scale=scale)
        np.testing.assert_allclose(values[q.name] - q.offset, np.exp(logarithm), rtol=1e-6)


@every
def test_draws_have_the_stated_priors(layout):
    """By simulation, of what the data show: where the bounds are far, median and factor are those stated."""
    _, values = drawn(layout, seed=4, most=np.inf)
    priors = layout.priors
    seen = [(half_width(values), priors.half_width)]
    if "b" in values:
        compact = values["b"] > 1.0  # below the wavelength hardly any height is seen, and its bound is near
        height = values["sigma_s"] * (np.sqrt(np.asarray(share(values))) if layout.material.renormalised else 1.0)
        seen += [(values["b"], priors.b), (values["c"] - 1, priors.c), (height[compact], priors.sigma_rel)]
    if "eta" in values:
        above = values["eta"] - 1
        seen += [(above[:, 1], priors.eta), (above[:, 0] / above[:, 1], priors.dispersion)]
        seen += [(above[:, 2] / above[:, 1], priors.dispersion)]
    else:
        seen += [(x, prior) for name, prior in (("n", priors.n), ("k", priors.k)) for x in values[name].T]
    for x, prior in seen:
        middle, factor = middle_and_factor(x)
        assert abs(np.log(middle / prior.median)) < 0.12 * np.log(prior.factor)
        assert np.log(factor) / np.log(prior.factor) == pytest.approx(1, abs=0.1)
    if "albedo" in values:
        odds = np.log(np.ravel(values["albedo"] / (1 - values["albedo"])) / priors.odds.median)
        assert kstest(odds / np.log(priors.odds.factor), "norm").pvalue > 1e-3
        assert np.mean(values["albedo"] < 0.01) > 0.1  # a floor under a metal is no oddity
    for name in {"grazing_exponent", "grazing_exponent_diffracted"} & set(values):
        assert kstest(np.ravel(values[name]), "uniform").pvalue > 1e-3


def test_what_is_cut_off_is_given_to_the_rest():
    """A metal's k, whose upper bound is 2.2 standard deviations away; and an index near its lowest."""
    layout = LAYOUTS["none"]
    _, values = drawn(layout, seed=5, most=np.inf)
    for name, q in ((q.name, q) for q in layout.parameters if q.name in ("p", "n", "k")):
        prior, x = getattr(PRIORS, name), np.ravel(values[name])
        low, high = np.log(np.array([q.lower, q.upper]) / prior.median) / np.log(prior.factor)
        cut = truncnorm(low, high, loc=np.log(prior.median), scale=np.log(prior.factor))
        assert kstest(np.log(x), cut.cdf).pvalue > 1e-3
        assert not np.any((x < q.lower) | (x > q.upper))
        assert 1 - (ndtr(high) - ndtr(low)) > 0.01
    tight = layout_of(
        TwoScale("plastic", "off"), replace(PRIORS, eta=LogNormal(2.9, 1.2), dispersion=LogNormal(1.0, 2.0))
    )
    eta = drawn(tight, seed=6)[1]["eta"]
    assert np.all(eta <= 4.0 * (1 + 1e-12))
    assert np.mean(eta[:, 0] < eta[:, 1]) > 0.55  # what is above the bound is cut off: lower ratios are likelier


def test_other_priors_in_the_configuration_are_those_of_the_coordinates():
    given = {"half_width": {"median": 0.1, "factor": 1.5}, "eta": {"median": 0.3, "factor": 1.2},
             "dispersion": {"median": 1.1, "factor": 1.15}, "odds": {"median": 0.5, "factor": 2.0}}  # fmt: skip
    config = parse({"effects": {"preset": "microfacet"}, "priors": given}, "here")
    layout = layout_for(config, two_scale(config, ("real", "plastic")))
    assert layout.priors == replace(PRIORS, **{name: LogNormal(**prior) for name, prior in given.items()})
    assert layout.model == two_scale(config, ("real", "plastic"))
    _, values = drawn(layout, seed=7, most=np.inf)
    above = values["eta"] - 1
    for x, name in (
        (half_width(values), "half_width"),
        (above[:, 1], "eta"),
        (above[:, 0] / above[:, 1], "dispersion"),
        (values["albedo"] / (1 - values["albedo"]), "odds"),
    ):
        middle, factor = middle_and_factor(x)
        assert middle == pytest.approx(given[name]["median"], rel=0.03)
        assert factor == pytest.approx(given[name]["factor"], rel=0.03)
    z = jnp.zeros(layout.size)
    unchanged = layout_of(layout.model)
    assert float(layout.values(z)["beta"]) > 3 * float(unchanged.values(z)["beta"])
    assert float(layout.values(z)["p"]) == float(unchanged.values(z)["p"])


def test_the_configuration_s_priors_are_the_model_s():
    assert Config().priors == PRIORS
    assert layout_for(load(), Measured(TwoScale())) == layout_of(Measured(TwoScale()))
    for bad in ({"median": 0.0, "factor": 2.0}, {"median": 1.0, "factor": 1.0}, {"median": 1.0}, {"mean": 1.0}):
        with pytest.raises(ConfigError, match="priors"):
            parse({"priors": {"p": bad}}, "here")


def test_priors_are_said_in_words():
    layout = LAYOUTS["plastic"]
    said = {q.name: layout.prior(q) for q in layout.parameters}
    assert said["albedo"] == "albedo/(1 - albedo) log-normal, 0.11 times or over 9"
    assert said["beta"] == "half_width log-normal, 0.03 times or over 5; beta in [0.001, 1]"
    assert said["c"].startswith("c - 1 log-normal, 0.7 times or over 2.5")
    assert "that of the middle one times or over 1.2" in said["eta"]
    other = replace(layout, priors=replace(PRIORS, p=LogNormal(1.0, 3.0)))
    assert "1 times or over 3" in other.prior(next(q for q in layout.model.parameters if q.name == "p"))


def test_an_albedo_of_nothing_is_a_small_one():
    """A start at 0 or 1 has free coordinates from which a fit can go on."""
    layout = LAYOUTS["lambert"]
    where = layout.slices["albedo"]
    values = {q.name: q.default for q in layout.parameters}
    for given, most in ((0.0, 2e-6), (-1.0, 2e-6), (1.0, 1.0)):
        z = layout.free({**values, "albedo": np.full(3, given)})
        found = layout.values(jnp.asarray(z))["albedo"]
        assert np.all(np.abs(z[where]) < 8)
        assert np.all((found > 0) & (found <= most))
        assert np.all(layout.slopes(z).diagonal()[where] > 0)
    assert np.all(layout.values(jnp.asarray(layout.free({**values, "albedo": np.full(3, 0.002)})))["albedo"] < 0.0021)
