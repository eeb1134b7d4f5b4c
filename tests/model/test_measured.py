"""What an apparatus makes of any material: its sharp lobes lose light, its body none."""

import jax
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from merlfit.model.acquisition import RINGS_RAD, exponent_of_lobe
from merlfit.model.apparatus import Apparatus
from merlfit.model.measured import Measured, material_of, profile, with_material
from merlfit.model.ndf.ggx import D
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.oren_nayar_qualitative import OrenNayarQualitative
from merlfit.model.two_scale import TwoScale

from tests.support.compiled import evaluate, from_half_difference

VALUES = {"alpha": 0.02, "F0": np.array([0.9, 0.6, 0.3]), "albedo": np.array([0.02, 0.1, 0.3])}
ANGLES = np.array([[0.01, 0.2, 0.3], [0.02, 1.2, 1.0], [0.1, 0.9, 3.0]]).T


@pytest.fixture(scope="module")
def geometry():
    return from_half_difference(*ANGLES)


def loss(geometry, exponent):
    """p(i, o) of HP17 Eq. 59-60, once more."""
    bases = (1 - 4 * np.arccos(np.asarray(cos)) ** 2 / np.pi**2 for cos in (geometry.cos_i, geometry.cos_o))
    return np.prod(list(bases), 0) ** exponent


@pytest.mark.parametrize("how", ["free", 0.4])
def test_the_sharp_lobe_of_a_rival_is_dimmed_and_its_body_is_not(how, geometry):
    values = {**VALUES, "grazing_exponent": 0.4} if how == "free" else VALUES
    body = VALUES["albedo"][:, None] / np.pi
    expected = loss(geometry, 0.4) * (np.asarray(evaluate(GGX(), VALUES, geometry)) - body) + body
    np.testing.assert_allclose(evaluate(Measured(GGX(), how), values, geometry), expected, rtol=1e-12)
    assert not np.allclose(expected, loss(geometry, 0.4) * np.asarray(evaluate(GGX(), VALUES, geometry)), rtol=1e-2)


def test_the_derived_exponent_of_a_rival_is_that_of_its_distribution(geometry):
    """Its lobe at theta_d = 0 is D, up to a factor that matters for no width."""
    lobe = np.asarray(jax.jit(lambda v: profile(GGX(), "specular", v))(VALUES))
    alone = np.asarray(jax.jit(D)(np.asarray(RINGS_RAD), 0.02))
    np.testing.assert_allclose(lobe / lobe[0], alone / alone[0], rtol=1e-12)
    for apparatus in (Apparatus(), Apparatus(lamp_sigma_rad=0.02)):
        measured = Measured(GGX(), "derived", apparatus)
        k = float(jax.jit(measured.exponent, static_argnums=0)("specular", VALUES))
        expected = float(jax.jit(exponent_of_lobe, static_argnums=1)(alone, apparatus))
        assert k == pytest.approx(expected, rel=1e-9)
        assert 0.05 < k < 0.9
        given = evaluate(Measured(GGX(), k), VALUES, geometry)
        np.testing.assert_allclose(evaluate(measured, VALUES, geometry), given, rtol=1e-12)


def test_what_has_no_sharp_lobe_loses_nothing():
    seen = Measured(OrenNayarQualitative())
    assert seen.grazing_loss == "off"
    assert not seen.loses
    assert seen.parameters == OrenNayarQualitative().parameters


@pytest.mark.parametrize(("given", "words"), [
    ((TwoScale(), "free", Apparatus(100.0)), "apparatus has an effect only where grazing_loss is derived"),
    ((OrenNayarQualitative(), 0.4), "only on sharp lobes"),
    ((OrenNayarQualitative(), "derived"), "only on sharp lobes"),
])  # fmt: skip
def test_what_would_have_no_effect_is_refused(given, words):
    with pytest.raises(ValueError, match=words):
        Measured(*given)


def test_a_loss_may_be_a_number_of_any_kind():
    assert Measured(GGX(), np.float64(0.5)) == Measured(GGX(), 0.5)
    for wrong in (True, 1.5, np.float64(np.nan)):
        with pytest.raises((ValueError, TypeCheckError), match="grazing_loss"):
            Measured(GGX(), wrong)


def test_exponents_stand_between_shared_parameters_and_those_of_channels():
    names = [q.name for q in Measured(TwoScale("lambert")).parameters]
    assert names[4:] == ["sigma_s", "grazing_exponent", "grazing_exponent_diffracted", "eta", "albedo"]
    assert Measured(TwoScale(), "derived").parameters == TwoScale().parameters
    assert [q.name for q in Measured(GGX()).parameters] == ["alpha", "grazing_exponent", "F0", "albedo"]


def test_values_of_a_measured_material_do_for_the_material_alone(geometry):
    given = {**VALUES, "grazing_exponent": 0.4}
    np.testing.assert_array_equal(evaluate(GGX(), given, geometry), evaluate(GGX(), VALUES, geometry))
    np.testing.assert_array_equal(evaluate(Measured(GGX(), "off"), given, geometry), evaluate(GGX(), VALUES, geometry))


def test_a_material_is_found_and_replaced():
    seen = Measured(TwoScale(), "derived", Apparatus(100.0))
    assert material_of(seen) == material_of(TwoScale()) == TwoScale()
    assert with_material(seen, GGX()) == Measured(GGX(), "derived", Apparatus(100.0))
    assert with_material(TwoScale(), GGX()) == GGX()
    assert with_material(seen, OrenNayarQualitative()) == Measured(OrenNayarQualitative())
    assert str(seen) == str(TwoScale()) == "two-scale (complex none)"


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="is measured already"):
        Measured(Measured(GGX()))
    for wrong in ("some", 2.0, -0.1):
        with pytest.raises((ValueError, TypeCheckError), match=str(wrong)):
            Measured(GGX(), wrong)
