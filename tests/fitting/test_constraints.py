"""What a user says of parameters: fixed, bounded, tied, started, another prior; from settings, commands and Python."""

import jax.numpy as jnp
import merlfit
import numpy as np
import pytest
import typer
from merlfit.fitting.commands.settings import parameters_given
from merlfit.fitting.fit.projection import _linear
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.comparison import row_of
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.settings.config import ConfigError, load, parameters_of, parse
from merlfit.model.measured import Measured
from merlfit.model.priors import Constraint, LogNormal
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale
from scipy.special import ndtr
from scipy.stats import truncnorm

from tests.support.compiled import evaluate
from tests.support.made_results import put_result
from tests.support.scattered_arrays import directions

PLASTIC = Measured(TwoScale("plastic"))
VALUES = {
    "beta": 0.1, "p": 0.9, "b": 2.0, "c": 1.8, "sigma_s": 0.03, "grazing_exponent": 0.4,
    "grazing_exponent_diffracted": 0.3, "eta": np.array([1.5, 1.52, 1.54]), "albedo": np.array([0.4, 0.2, 0.1]),
}  # fmt: skip
pytestmark = pytest.mark.usefixtures("compiled_quickly")


def constrained(model=PLASTIC, **said):
    return layout_of(model, constraints=tuple(said.items()))


def slopes_by_differences(layout, z, h=1e-5):
    flat = lambda z: np.asarray(layout.flat(jnp.asarray(z)))  # noqa: E731
    return np.array([(flat(z + e) - flat(z - e)) / (2 * h) for e in h * np.eye(layout.size)]).T


@pytest.mark.parametrize("name", ["p", "beta", "sigma_s", "eta", "albedo"])
def test_what_is_fixed_stays_and_has_no_coordinate(name):
    """Those that others' priors move with, one whose own prior moves, and one of every kind per channel."""
    fixed = tuple(np.ravel(VALUES[name]).tolist())
    layout, whole = constrained(**{name: Constraint(fixed=fixed)}), layout_of(PLASTIC)
    assert layout.size == whole.size - len(fixed)
    assert len(layout.names) == whole.size
    assert name not in {layout.entries[k].name for k in layout.leads}
    z = np.random.default_rng(1).normal(size=layout.size)
    values, slopes = layout.values_and_slopes(z)
    np.testing.assert_array_equal(np.ravel(values[name]), fixed)
    np.testing.assert_array_equal(np.asarray(slopes)[layout.slices[name]], 0)
    np.testing.assert_allclose(slopes, slopes_by_differences(layout, z), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(layout.free(values), z, atol=1e-8)
    np.testing.assert_allclose(layout.free({**values, name: 1.1}), z, atol=1e-8)  # whatever it is given


def test_others_are_as_they_are_where_nothing_is_fixed():
    """Given the value of what is fixed: the half width is that of p, whether p is fitted or not."""
    layout, whole = constrained(p=Constraint(fixed=(0.9,))), layout_of(PLASTIC)
    z = whole.free(VALUES)
    kept = np.delete(z, whole.slices["p"])
    np.testing.assert_allclose(layout.flat(jnp.asarray(kept)), whole.flat(jnp.asarray(z)), rtol=1e-9)


@pytest.mark.parametrize("name", ["eta", "albedo"])
def test_what_is_tied_is_one_number(name):
    layout = constrained(**{name: Constraint(tied=True)})
    assert layout.size == layout_of(PLASTIC).size - 2
    assert layout.kinds[layout.slices[name]] == ("tied", "free", "tied")
    z = np.random.default_rng(2).normal(size=layout.size)
    values, slopes = layout.values_and_slopes(z)
    assert np.ptp(values[name]) == 0
    np.testing.assert_allclose(slopes, slopes_by_differences(layout, z), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(layout.free(values), z, atol=1e-8)
    whole = layout_of(PLASTIC).values(jnp.asarray(layout_of(PLASTIC).free(values)))
    np.testing.assert_allclose(values[name], whole[name], rtol=1e-9)


def test_priors_are_cut_at_the_bounds_that_are_set():
    """Of a log-normal prior, of odds and of a uniform one; quantiles in closed form."""
    layout = constrained(
        p=Constraint(lower=0.5, upper=2.0),
        albedo=Constraint(upper=0.3),
        grazing_exponent=Constraint(lower=0.2, upper=0.6),
    )
    z = np.array([-3.0, -0.5, 0.0, 1.0, 4.0])
    found = layout.values(np.tile(z[:, None], layout.size))
    prior = layout.priors.p
    low, high = np.log(np.array([0.5, 2.0]) / prior.median) / np.log(prior.factor)
    expected = truncnorm.ppf(ndtr(z), low, high, np.log(prior.median), np.log(prior.factor))
    np.testing.assert_allclose(np.log(found["p"]), expected, rtol=1e-9)
    odds = layout.priors.odds
    high = (np.log(0.3 / 0.7) - np.log(odds.median)) / np.log(odds.factor)
    expected = truncnorm.ppf(ndtr(z), -np.inf, high, np.log(odds.median), np.log(odds.factor))
    np.testing.assert_allclose(found["albedo"][:, 0], 1 / (1 + np.exp(-expected)), rtol=1e-9)
    np.testing.assert_allclose(found["grazing_exponent"], 0.2 + 0.4 * ndtr(z), rtol=1e-12)
    far = layout.values(np.full((1, layout.size), 50.0))
    assert far["p"][0] == pytest.approx(2.0, rel=1e-12)
    np.testing.assert_allclose(far["albedo"], 0.3, rtol=1e-9)
    assert layout.free({**VALUES, "albedo": 0.9}).max() < 8  # a start beyond a bound is moved just inside
    assert "in [0, 0.3]" in layout.prior(next(q for q in layout.parameters if q.name == "albedo"))


def test_a_prior_that_is_set_is_that_of_the_parameter_itself():
    layout = constrained(beta=Constraint(prior=LogNormal(0.2, 1.5)))
    z = np.random.default_rng(3).normal(size=(50, layout.size))
    beta = np.log(layout.values(z)["beta"])
    np.testing.assert_allclose(beta, np.log(0.2) + np.log(1.5) * z[:, 0], rtol=3e-3)  # whatever p; bounds are far
    assert layout.coordinates[0] == "beta"
    assert layout.prior(layout.parameters[0]) == "beta log-normal, 0.2 times or over 1.5; beta in [0.001, 1]"


def test_models_without_what_is_said_are_left_out():
    assert [m.variant for m in candidates(load(parameters=parameters_of({"eta": 1.5})))] == [
        m.variant for m in candidates(load()) if "eta" in {q.name for q in m.parameters}
    ]
    assert len(candidates(load(parameters=parameters_of(bounds={"p": (0.5, None)})))) == len(candidates(load()))
    config = load(model=["two-scale", "ggx"], parameters=parameters_of(start={"alpha": 0.1}))
    with pytest.raises(ConfigError, match="two-scale has no parameter alpha; it has albedo, b, beta"):
        candidates(config)
    with pytest.raises(ConfigError, match="two-scale has no variant with all of eta, n"):
        candidates(load(parameters=parameters_of({"eta": 1.5, "n": 1.0})))


@pytest.mark.parametrize(
    ("said", "line"),
    [
        ({"bounds": {"p": (0.1, 9.0)}}, "p cannot be bounded by 0.1 and 9: .* within those of the model, 0.2 and 5"),
        ({"bounds": {"p": (2.0, 1.0)}}, "p cannot be bounded by 2 and 1: the lower bound comes first"),
        ({"fix": {"p": 9.0}}, "p cannot be fixed at 9: its bounds are 0.2 and 5"),
        ({"bounds": {"p": (1.0, 2.0)}, "start": {"p": 0.5}}, "p cannot be started at 0.5: its bounds are 1 and 2"),
        ({"tie": ["beta"]}, "beta is the same in all channels already"),
        ({"fix": {"beta": [0.1, 0.2]}}, "beta should be fixed at one value, not at 2"),
        ({"fix": {"eta": [1.5, 1.6]}}, "eta should be fixed at one value, or one for each of the 3 channels, not at 2"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_what_cannot_be_kept_is_refused_in_a_line(said, line):
    config = load(parameters=parameters_of(**said))
    with pytest.raises(ConfigError, match=f"parameters: {line}"):
        [layout_for(config, model) for model in candidates(config)]


def test_priors_and_idle_keys_that_make_no_sense_are_refused():
    with pytest.raises(ConfigError, match=r"parameters\.eta: start would have no effect on what is fixed"):
        load({"parameters": {"eta": {"fixed": 1.5, "start": 1.4}}})
    with pytest.raises(
        ConfigError, match=r"unknown key 'parameters\.p\.uper'; the nearest known one is 'parameters\.p\.upper'"
    ):
        load({"parameters": {"p": {"uper": 1.5}}})
    prior = {"median": 0.1, "factor": 2.0}
    config = load({"parameters": {"albedo": {"prior": prior}}})
    with pytest.raises(ConfigError, match=r"albedo has no log-normal prior that could be set: set priors\.odds"):
        candidates(config)
    with pytest.raises(ValueError, match="nothing is left to fit"):
        constrained(GGX(), **{q.name: Constraint(fixed=(q.default,)) for q in GGX().parameters})
    with pytest.raises(ConfigError, match="bounds of p should be a lower and an upper one"):
        parameters_of(bounds={"p": (1.0,)})


def test_options_of_the_command_are_the_same_settings(capsys):
    given = parameters_given(["eta=1.5", "n=0.2,0.9,1.1"], ["p=0.5:2", "b=1:"], ["beta=0.1"], ["albedo"])
    said = {"eta": 1.5, "n": [0.2, 0.9, 1.1]}, {"p": (0.5, 2.0), "b": (1.0, None)}, {"beta": 0.1}, ["albedo"]
    assert given == parameters_of(*said)
    assert load(parameters=given) == load({"parameters": given})
    twice = ["eta=1.5", "eta=1.6"]
    for wrong in (
        (["eta"], None),
        (["eta=x"], None),
        (twice, None),
        (None, ["p=3"]),
        (None, ["=1:2"]),
        (None, ["p=:"]),
    ):
        with pytest.raises(typer.Exit):
            parameters_given(*wrong, None, None)
        assert capsys.readouterr().err.count("\n") == 1


def test_a_constant_that_is_fixed_is_the_only_one_tried():
    assert _linear(constrained(eta=Constraint(fixed=(1.45,)))).constants["eta"].tolist() == [1.45]
    assert len(_linear(constrained(p=Constraint(fixed=(0.9,)))).constants["eta"]) > 1


def test_arrays_with_a_fixed_index_and_bounds_give_the_rest():
    """A synthetic table of a plastic; what is not fixed is recovered, what is said of parameters is in the result."""
    where, arrays = directions(800, seed=4)
    truth = {"alpha": 0.12, "eta": np.full(3, 1.45), "albedo": np.array([0.5, 0.3, 0.1])}
    model = GGX(fresnel="dielectric")
    values = np.asarray(evaluate(model, truth, where)).T
    settings = {"model": {"name": "ggx", "fresnel": "dielectric"}}
    fit = merlfit.fit({**arrays, "values": values}, settings=settings, fix={"eta": 1.45}, bounds={"alpha": (0.05, 0.5)})
    assert fit.status == "CONVERGED"
    for name, expected in truth.items():
        np.testing.assert_allclose(fit.parameters[name], expected, rtol=1e-5, err_msg=name)
    assert [q.fitted for q in fit.result.parameters] == ["free", "fixed", "fixed", "fixed", "free", "free", "free"]
    found = {q.name: q for q in fit.result.parameters}
    assert (found["alpha"].lower, found["alpha"].upper) == (0.05, 0.5)
    assert found["eta_526nm"].laplace is None
    assert np.nanmax(np.abs(fit.residuals())) < 1e-5
    assert fit.result.identifiability.coordinates == ["alpha", "odds_645nm", "odds_526nm", "odds_444nm"]
    assert "fixed" in str(fit)


def test_settings_of_a_result_are_read_again_with_what_is_fixed():
    """As a result keeps them, every key written out."""
    config = load(parameters=parameters_of({"eta": (1.5, 1.51, 1.52)}, {"p": (0.5, None)}, {"b": 1.0}, ["albedo"]))
    assert parse(config.plain(), "here") == config
    assert (
        load({"parameters": {"eta": {"fixed": (1.5, 1.51, 1.52)}}}).parameters
        == load(parameters=parameters_of({"eta": [1.5, 1.51, 1.52]})).parameters
    )
    with pytest.raises(ConfigError, match=r"parameters\.eta\.fixed: should be a number, or a list"):
        load({"parameters": {"eta": {"fixed": "glass"}}})


def test_what_is_given_beside_a_file_of_settings_replaces_only_that():
    own = {"parameters": {"p": {"upper": 2.0, "prior": {"median": 0.8, "factor": 1.5}}, "eta": {"fixed": 1.5}}}
    found = load(own, parameters=parameters_of(start={"p": 1.0}, bounds={"eta": (1.3, None)})).parameters
    assert found["p"] == Constraint(upper=2.0, start=1.0, prior=LogNormal(0.8, 1.5))
    assert found["eta"] == Constraint(lower=1.3)
    assert load(own, parameters=parameters_of({"p": 1.0})).parameters["p"] == Constraint(fixed=(1.0,))


@pytest.mark.parametrize(("median", "lower", "upper"), [(0.25, 0.5, 5.0), (0.05, 0.21, 0.3), (4.0, 0.2, 1.0)])
def test_a_prior_beyond_the_bounds_leaves_what_is_nearest_to_it(median, lower, upper):
    """Ten and more standard deviations away, where the mass above them is no number."""
    factor = 1.1 if lower > median else 1.15
    layout = constrained(p=Constraint(lower=lower, upper=upper, prior=LogNormal(median, factor)))
    z = np.array([-2.0, -0.5, 0.0, 0.5, 2.0])
    found = layout.values(np.tile(z[:, None], layout.size))["p"]
    near = lower if lower > median else upper
    assert np.all(np.abs(np.log(found / near)) < 0.06)
    assert np.all(np.diff(found) > 0)
    for k in range(len(z)):
        values = layout.values(jnp.full(layout.size, z[k]))
        assert layout.free(values)[layout.leads.tolist().index(1)] == pytest.approx(z[k], abs=1e-6)
    with pytest.raises(ValueError, match=r"p has a prior of 0\.25 times or over 1\.01, of which nothing is between"):
        constrained(p=Constraint(lower=0.5, prior=LogNormal(0.25, 1.01)))


def test_numbers_of_a_model_are_those_that_were_fitted(tmp_path):
    """Where models are ranked by them, and where a sentence says what depends on what."""
    result = put_result(tmp_path)
    free = len(result.parameters)
    fixed = [q.model_copy(update={"fitted": "fixed"}) if k < 3 else q for k, q in enumerate(result.parameters)]
    assert row_of(result.model_copy(update={"parameters": fixed})).numbers == row_of(result).numbers - 3 == free - 3
