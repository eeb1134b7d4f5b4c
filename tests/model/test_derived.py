"""Derived quantities against closed forms and against a finer rule of another author's making."""

import jax
import numpy as np
import pytest
from merlfit.model import derived as derivation
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.two_scale import TwoScale

from tests.energy import half_vectors
from tests.oracles import diffraction as o_diffraction
from tests.oracles import fresnel as o_fresnel
from tests.support.compiled import derived, directional_albedo, drawn, two_scale

ANGLES = np.radians([0.0, 60.0, 80.0])
EFFECTS = [
    TwoScale("none"),
    TwoScale("lambert"),
    TwoScale("plastic", split="conserving"),
    TwoScale("subsurface", "off"),
]


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda e: f"{e.body} {e.diffraction} {e.split}")
def test_directional_albedo_is_the_integral_by_a_finer_rule(effects):
    rng = np.random.default_rng(0)
    for _ in range(6):
        values = drawn(rng, effects)
        B = 2 * float(values.get("b", 1.0)) / min(WAVELENGTHS_UM)
        nodes, measure = half_vectors(np.maximum(ANGLES, 1e-4), float(values["beta"]), float(values["p"]), B)
        expected = np.sum(np.asarray(two_scale(values, nodes, effects)) * np.asarray(measure), (-2, -1))
        found = directional_albedo(effects, values, ANGLES)
        np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_a_lambertian_body_under_nothing_gives_back_its_albedo():
    values = {"beta": 0.3, "p": 1.0, "eta": np.full(3, 1.0), "albedo": np.array([0.8, 0.5, 0.1])}
    found = derived(values, TwoScale("lambert", "off"))
    albedo = directional_albedo(TwoScale("lambert", "off"), values, ANGLES)
    np.testing.assert_allclose(albedo, np.repeat(values["albedo"][:, None], len(ANGLES), 1), rtol=1e-3)
    np.testing.assert_allclose(found["f0"], 0, atol=1e-12)


def test_the_others_are_those_of_the_oracles():
    values = {
        "beta": 0.1196, "p": 0.6, "b": 4.8, "c": 2.2, "sigma_s": 0.0273,
        "n": np.array([1.2, 0.4, 3.0]), "k": np.array([2.0, 3.5, 0.1]),
    }  # fmt: skip
    found = derived(values, TwoScale("none"))
    expected = [o_fresnel.fresnel(1.0, n, k) for n, k in zip(values["n"], values["k"], strict=True)]
    np.testing.assert_allclose(found["f0"], expected)
    share = [float(o_diffraction.renormalisation(0.0, 4.8 / wavelength, 2.2)) for wavelength in WAVELENGTHS_UM]
    expected = 1 - np.exp(-np.array(share) * (4 * np.pi * 0.0273 / np.array(WAVELENGTHS_UM)) ** 2)
    np.testing.assert_allclose(found["diffracted_fraction"], expected, rtol=1e-7)
    slope = np.tan(np.radians(found["lobe_half_width"]))
    assert np.exp(-((slope / 0.1196) ** 1.2)) == pytest.approx(0.5)


def test_what_is_listed_is_what_is_computed():
    for effects in EFFECTS:
        values = drawn(np.random.default_rng(1), effects)
        found = jax.eval_shape(lambda values, effects=effects: derivation.derived(values, effects), values)
        assert set(found) == {q.name for q in derivation.quantities(effects)}
        for q in derivation.quantities(effects):
            assert found[q.name].shape == ((3,) if q.per_channel else ())
