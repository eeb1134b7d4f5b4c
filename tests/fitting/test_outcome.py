"""What a result says of itself: at which bound it is, and what a user of its parameters should know."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit.largest_albedo import largest_albedo
from merlfit.fitting.fit.levenberg_marquardt import BLACK, LEAST_BINS, UNEXPLAINED_COST, Solution, Status
from merlfit.fitting.fit.outcome import POOR, Fitted, cautions, excess
from merlfit.fitting.fit.plausible import METAL_FLOOR
from merlfit.fitting.fit.selection import ALIKE, MARGIN
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline import run
from merlfit.fitting.pipeline.result import make_result
from merlfit.fitting.results.schema import Candidate
from merlfit.fitting.settings.config import load
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.binary import DIMS
from merlfit.model.measured import Measured
from merlfit.model.priors import PRIORS
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale
from scipy.stats import norm

from tests.support.stand_ins import uncorrelated

LAYOUT = layout_of(Measured(TwoScale("lambert", index="complex")))
VALUES = {
    "beta": 0.1, "p": 0.8, "b": 3.0, "c": 2.0, "sigma_s": 0.02, "grazing_exponent": 0.4,
    "grazing_exponent_diffracted": 0.2, "n": np.full(3, 1.5), "k": np.full(3, 3.0), "albedo": np.full(3, 0.01),
}  # fmt: skip
GOOD = Errors(0.01, 0.02, 0.01, 0.01, 1.0, 0.5)


def fitted(values=VALUES, cost=0.01, candidates=(), errors=GOOD, converged=True):
    """A fit of parameters that the data determine a little better than the prior does."""
    z = LAYOUT.free(values)
    normal = np.tile(np.diag([*np.full(len(z), 0.1 * cost), cost / 3]), (3, 1, 1))
    solution = Solution(z, cost, normal, 9, 1e-4, converged)
    return Fitted(LAYOUT, solution, np.full(3, cost / 3), uncorrelated(normal, cost, 100.0), errors, list(candidates))


def said(one, **given):
    return " ".join(cautions(one, load(**given).fit.weights))


def test_statuses_tell_the_numbers_that_decide():
    assert f"fewer than {LEAST_BINS} valid bins brighter than {BLACK:g}/sr" in Status.NO_DATA.value
    assert f"less than {1 - UNEXPLAINED_COST:.0%} of the file" in Status.UNEXPLAINED.value


def test_a_good_fit_needs_no_caution():
    assert fitted().status is Status.CONVERGED
    assert said(fitted()) == ""


@pytest.mark.parametrize(("one", "words"), [
    (fitted(cost=1.1 * POOR), ["does not describe this file well", "6% of its weighted energy"]),
    (fitted({**VALUES, "sigma_s": 0.3}), ["sigma_s is more than half a wavelength"]),
    (fitted({**VALUES, "albedo": np.array([0.0, 2 * METAL_FLOOR, 0.0])}), ["no metal", "effective values"]),
    (fitted({**VALUES, "n": np.full(3, 0.8), "k": np.full(3, 0.9)}), ["no metal has n 0.8 with k 0.9 (R)"]),
    (fitted({**VALUES, "p": 0.2005}), ["at a bound", "p 0.2005 (lower, 0.2, to 0.1% of the logarithmic range)"]),
    (fitted({**VALUES, "grazing_exponent": 0.999}), ["grazing_exponent 0.999 (upper, 1, to 0.1% of the range)"]),
    (fitted(errors=replace(GOOD, highlight=0.3)), ["0.3 times as bright as the file's", "--weights adaptive"]),
    (fitted(converged=False), ["still falling"]),
    (fitted(errors=replace(GOOD, lamp=0.4, environment=5.8)), ["0.4 under a lamp, 5.8 under"]),
])  # fmt: skip
def test_what_is_doubtful_is_said(one, words):
    assert all(word in said(one) for word in words), said(one)
    assert len([line for line in cautions(one, load().fit.weights) if "--model auto" not in line]) == 1


@pytest.mark.parametrize(("one", "advised"), [
    (fitted(), False),
    (fitted(converged=False), False),
    (fitted(cost=1.1 * POOR), True),
    (fitted(errors=replace(GOOD, highlight=0.3)), True),
    (fitted(errors=replace(GOOD, lamp=5.8)), True),
    (fitted(errors=replace(GOOD, lamp=5.8, highlight=0.3)), True),
])  # fmt: skip
def test_where_one_lobe_is_too_few_more_are_advised_once_and_not_to_who_asked_for_them(one, advised):
    assert said(one).count("--model auto") == advised
    assert "--model auto" not in " ".join(cautions(one, "compressive", richer=True))


def test_the_costs_of_all_bins_leave_the_matrix_of_the_last_grid_alone(monkeypatch):
    solution, costs = fitted().solution, np.array([0.1, 0.2, 0.4])
    monkeypatch.setattr(run, "predict_samples", lambda *_: None)
    monkeypatch.setattr(run, "assess_prediction", lambda *_: (GOOD, costs))
    monkeypatch.setattr(run, "count_of", lambda *_: 100.0)
    monkeypatch.setattr(run, "noise_of", lambda *_: None)
    found = run.assess(LAYOUT, solution, None, None)
    assert found.costs is costs
    assert found.solution.cost == pytest.approx(0.7)
    assert found.solution.normal is solution.normal


def test_a_lost_highlight_is_no_reason_to_advise_what_was_done():
    assert "no exponent" in said(fitted(errors=replace(GOOD, highlight=3.0)), weights="adaptive")
    scattered = fitted(errors=replace(GOOD, highlight=3.0, picture=float("nan")))
    assert "--weights none" in said(scattered)
    assert "no exponent" in said(scattered, weights="none")


def test_normal_equations_that_are_not_finite_are_no_fit():
    one = fitted()
    broken = replace(one.solution, normal=one.solution.normal * np.nan)
    file = SimpleNamespace(
        fraction_uncertain=None,
        path="x.binary", name="x", sha1="0" * 40, blob_sha1="0" * 40, format="MERL", genuine=None, dims=DIMS,
        valid=np.ones(3, bool), outliers=0, quantity="brdf",
    )  # fmt: skip
    samples = SimpleNamespace(weight=np.ones((3, 2, 2)))
    found = make_result(file, samples, replace(one, solution=broken), None, load(), {"total": 0.1})
    assert found.fit.status == "NON_FINITE"
    assert found.model is None


def test_what_is_well_determined_beside_a_bound_is_not_at_it():
    one = fitted({**VALUES, "p": 0.2005})
    sharp = replace(one.noise, precision=1e7 * one.noise.precision)
    assert set(replace(one, noise=sharp).at_bound) == {"no"}


def test_an_albedo_is_at_no_bound():
    """Its odds never reach one: a floor of nearly nothing is a value like others."""
    one = fitted({**VALUES, "albedo": np.full(3, 1e-5)})
    assert set(one.at_bound) == {"no"}
    assert np.all(np.isfinite(one.standard_errors))


def test_intervals_are_those_of_the_free_coordinates():
    """Against the priors' formulas; the prior of sigma_s moves with b and c."""
    one, deviation = fitted(), 31**-0.5
    found = dict(zip(LAYOUT.names, one.laplace, strict=True))
    q = next(q for q in LAYOUT.parameters if q.name == "grazing_exponent")
    z = norm.ppf((0.4 - q.lower) / (q.upper - q.lower))
    expected = q.lower + norm.cdf(z + deviation * norm.ppf([0.05, 0.95])) * (q.upper - q.lower)
    np.testing.assert_allclose(found["grazing_exponent"], expected, rtol=1e-4)
    assert found["grazing_exponent"][1] < q.upper

    q, prior = next(q for q in LAYOUT.parameters if q.name == "b"), PRIORS.b
    low, high = (np.log(x / prior.median) / np.log(prior.factor) for x in (q.lower, q.upper))
    cut = lambda p: norm.ppf(norm.cdf(low) + p * (norm.cdf(high) - norm.cdf(low)))  # noqa: E731
    share = (norm.cdf(np.log(3.0 / prior.median) / np.log(prior.factor)) - norm.cdf(low)) / (
        norm.cdf(high) - norm.cdf(low)
    )
    ends = norm.cdf(norm.ppf(share) + deviation * norm.ppf([0.05, 0.95]))
    np.testing.assert_allclose(found["b"], prior.median * prior.factor ** cut(ends), rtol=1e-4)

    z, at = one.solution.z, LAYOUT.names.index("sigma_s")
    step = 1e-6 * np.eye(len(z))
    slope = np.array([(LAYOUT.flat(z + s)[at] - LAYOUT.flat(z - s)[at]) / 2e-6 for s in step])
    wide = deviation * np.linalg.norm(slope) / slope[at]
    assert wide > 1.02 * deviation, "b and c move it"
    ends = [LAYOUT.flat(z + side * 1.6449 * wide * np.eye(len(z))[at])[at] for side in (-1, 1)]
    np.testing.assert_allclose(found["sigma_s"], ends, rtol=1e-5)


def test_where_the_prior_says_more_than_the_data_there_is_no_interval():
    one = fitted()
    known = [replace(one.noise, precision=precision * np.eye(one.layout.size)) for precision in (0.9, 1.2)]
    undecided = [replace(one, noise=noise).laplace for noise in known]
    assert set(undecided[0]) == {None}
    assert None not in undecided[1]


def test_other_kinds_are_named_by_the_rule_that_chooses():
    """By score, and only if neither of their errors is noticeably larger."""
    kinds = [("complex", "lambert"), ("complex", "none"), ("real", "lambert"), ("real", "plastic")]
    figures = [(0.01, 0.02, 0.0), (0.0101, 0.0201, 0.9 * ALIKE), (0.0099, 0.0199, 1.1 * ALIKE)]
    figures.append((0.01 * 1.1 * MARGIN, 0.02, 0.5 * ALIKE))
    candidates = [
        Candidate(model="two-scale", variant=f"{index} {body}", cost=j, objective=j, cube_root=e, score=score)
        for (index, body), (j, e, score) in zip(kinds, figures, strict=True)
    ]
    words = said(fitted(candidates=candidates))
    assert "complex none (+5.4)" in words
    candidates[1] = candidates[1].model_copy(update={"of_matter": False})
    assert "complex none (+5.4, but no matter is like that)" in said(fitted(candidates=candidates))
    assert words.count("(") == 2, "neither the one too far by score nor that with the larger error"


def test_a_material_that_makes_light_is_told_with_angle_and_mend():
    """Facets that reflect 0.9 at every angle over a body that gives back a half more of all light."""
    layout = layout_of(Measured(models()["ggx"](), "off"))
    values = {"alpha": 0.2, "F0": np.array([0.5, 0.9, 0.2]), "albedo": np.array([0.2, 0.5, 0.1])}
    one = replace(fitted(), layout=layout, solution=replace(fitted().solution, z=layout.free(values)))
    (line,) = excess(one)
    found = largest_albedo(layout.material, values, layout.bands)
    assert found.channel == "G"
    assert 1.3 < found.albedo < 1.45
    assert all(word in line for word in (f"{found.albedo:.2f} times", "0 degrees (G)", "--preset conserving"))
    dim = {**values, "F0": np.full(3, 0.3)}
    assert excess(replace(one, solution=replace(one.solution, z=layout.free(dim)))) == []


def test_a_matte_body_gives_back_its_albedo_whatever_the_angle():
    values = {"alpha": 0.2, "F0": np.zeros(3), "albedo": np.array([0.2, 0.7, 0.1])}
    found = largest_albedo(models()["ggx"](), {**values, "F0": np.full(3, 1e-12)}, MERL)
    assert found.albedo >= 0.7 - 1e-3
