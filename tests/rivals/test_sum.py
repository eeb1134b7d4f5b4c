"""Sums of lobes: against their parts, in their limits, by their names."""

from dataclasses import asdict

import jax
import numpy as np
import pytest
from merlfit.fitting.fit.hints import hints_of
from merlfit.model.measured import Measured
from merlfit.model.registry import made, variants
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.ggx import GGX
from merlfit.model.sum import Sum
from merlfit.model.two_scale import TwoScale

from tests.oracles import fresnel as oracle
from tests.support.compiled import evaluate, from_vectors

RNG = np.random.default_rng(3)
THETA_I, THETA_O, PHI = RNG.uniform(0, 1.45, (2, 40)), RNG.uniform(0, 1.45, (2, 40)), RNG.uniform(0, np.pi, (2, 40))
DARK = {"albedo": np.zeros(3)}
TOP = {"alpha": 0.05, "F0": np.array([0.3, 0.1, 0.04])}
BASE = {"beta": 0.3, "p": 0.7, "F0": np.array([0.05, 0.2, 0.6]), "albedo": np.array([0.1, 0.2, 0.5])}


def directions(theta_i=THETA_I, theta_o=THETA_O):
    def vector(theta, phi):
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)

    return from_vectors(vector(theta_i, 0 * PHI), vector(theta_o, PHI))


def named(values, suffix):
    return {f"{name}{suffix}": x for name, x in values.items() if name != "albedo"}


def test_surfaces_side_by_side_share_the_body():
    model, share = made("ggx+epd", {}), 0.3
    found = evaluate(model, {**BASE, **named(TOP, "_2"), "share_2": share}, directions())
    body = BASE["albedo"][:, None, None] / np.pi
    lobes = [evaluate(m, {**v, **DARK}, directions()) for m, v in ((GGX(), TOP), (EPD(), BASE))]
    np.testing.assert_allclose(found, share * lobes[0] + (1 - share) * lobes[1] + body, rtol=1e-12)


def test_a_coat_dims_what_lies_below_on_the_way_in_and_out():
    model, eta = made("coat(ggx)+epd", {}), 1.6
    found = evaluate(model, {**BASE, "alpha_coat": 0.05, "eta_coat": eta}, directions())
    through = [1 - np.vectorize(oracle.fresnel)(np.cos(x), eta) for x in (THETA_I, THETA_O)]
    above = evaluate(GGX("dielectric"), {"alpha": 0.05, "eta": np.full(3, eta), **DARK}, directions())
    np.testing.assert_allclose(found, above + through[0] * through[1] * evaluate(EPD(), BASE, directions()), rtol=1e-10)


def test_three_parts_are_a_sum_of_sums():
    model = made("coat(ggx)+ggx+epd", {})
    values = {**BASE, **named(TOP, "_2"), "share_2": 0.2, "alpha_coat": 0.02, "eta_coat": 1.5}
    below = made("ggx+epd", {})
    expected = evaluate(Sum(GGX(), below, coated=True), values, directions())
    np.testing.assert_array_equal(evaluate(model, values, directions()), expected)
    assert [q.name for q in model.parameters if not q.per_channel] == [
        "beta", "p", "share_2", "alpha_2", "alpha_coat", "eta_coat",
    ]  # fmt: skip
    assert made("ggx+epd+two-scale", {}).suffix == "_3"


@pytest.mark.parametrize("name", ["ggx+epd", "coat(beckmann)+ggx", "epd+two-scale", "coat(ggx)+ggx+epd"])
def test_exchanging_light_and_viewer_changes_nothing(name):
    model = made(name, {})
    values = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in model.parameters}
    there, back = (evaluate(model, values, g) for g in (directions(), directions(THETA_O, THETA_I)))
    np.testing.assert_allclose(there, back, rtol=1e-9)


def test_without_its_share_a_surface_is_not_there():
    model = made("ggx+two-scale", {"base": asdict(TwoScale("plastic"))})
    base = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in TwoScale("plastic").parameters}
    found = evaluate(model, {**base, **named(TOP, "_2"), "share_2": 0.0}, directions())
    np.testing.assert_allclose(found, evaluate(TwoScale("plastic"), base, directions()), rtol=1e-12)


def test_names_settings_and_kinds_are_read_back():
    for name in ("ggx+ggx", "coat(epd)+two-scale", "ggx+epd+two-scale"):
        model = made(name, {})
        assert model.name == name
        assert made(name, asdict(model)) == model
        assert hash(made(name, {})) == hash(model)
    kinds = [m.variant for m in variants("two-scale")]
    assert [m.variant for m in variants("ggx+two-scale")] == [f"{kind} + ggx" for kind in kinds]
    assert variants("coat(ggx)+epd+two-scale")[0].variant == "complex none + epd + coat(ggx)"
    assert [*Measured(made("ggx+hp15", {})).lobes] == ["specular", "diffracted", "specular_2"]
    names = [q.name for q in Measured(made("ggx+epd", {})).parameters]
    assert names[3:7] == ["alpha_2", "grazing_exponent", "grazing_exponent_2", "F0"]


@pytest.mark.parametrize(
    ("name", "settings", "told"),
    [
        ("ggx+epd+coat(ggx)", {}, "a coat comes first"),
        ("ggx+epd+ggx+epd", {}, "has more than 3 parts"),
        ("coat(smooth)+ggx", {}, "smooth is no coat"),
        ("coat(two-scale)+ggx", {}, "two-scale is no coat"),
        ("oren-nayar-qualitative+ggx", {}, "has no sharp lobe"),
        ("interfaced-lambertian+ggx", {}, "has no sharp lobe"),
        ("coat(ggx)", {}, "a coat comes first"),
        ("ggx+", {}, "there is no ''"),
        ("ggx+gx", {}, "the nearest is 'ggx'"),
        ("ggx+epd", {"masking": "none"}, "has no setting 'masking': its settings are top and base"),
        ("ggx+epd", {"coated": True}, "coated should be False"),
        ("ggx+epd", {"top": {"masking": "nothing"}}, "'nothing' is none of smith"),
    ],
)
def test_what_is_no_sum_is_refused(name, settings, told):
    with pytest.raises(ValueError, match=told):
        made(name, settings)


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(ValueError, match="sgd cannot be part of a sum"):
        hints_of(made("sgd+ggx", {}))


def test_slopes_are_those_of_differences():
    model = made("coat(ggx)+ggx+epd", {})
    values = {**BASE, **named(TOP, "_2"), "share_2": 0.2, "alpha_coat": 0.02, "eta_coat": 1.5}
    for name in ("share_2", "eta_coat", "alpha_2"):
        of = jax.jit(lambda x, name=name: evaluate(model, {**values, name: x}, directions()))
        slope = jax.jvp(of, (values[name],), (1.0,))[1]
        step = 1e-6
        difference = (of(values[name] + step) - of(values[name] - step)) / (2 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-7)
