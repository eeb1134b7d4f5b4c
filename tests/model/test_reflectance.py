"""Names of parameters and settings that are missing, misspelt or not needed, and values that do not fit."""

import numpy as np
import pytest
from merlfit.model.geometry import Geometry
from merlfit.model.reflectance import setting, shaped
from merlfit.model.registry import made
from merlfit.model.rivals.gtr import GTR
from merlfit.model.two_scale import TwoScale

METAL = {"beta": 0.1, "p": 0.5, "n": [1.0] * 3, "k": [3.0] * 3}


def shape(effects, **params):
    geometry = Geometry.from_vectors(np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))
    return shaped(effects, {**METAL, **params}, setting(geometry, (0.645, 0.526, 0.444)))


def test_a_parameter_of_no_effects_is_refused():
    with pytest.raises(KeyError, match=r"two-scale \(complex none, no diffraction\) has no parameter albdeo, sigma"):
        shape(TwoScale("none", "off"), albdeo=[0.1] * 3, sigma=0.1)


def test_parameters_of_other_effects_are_passed_over():
    found = shape(TwoScale("none", "off"), b=3.0, albedo=[0.1] * 3, grazing_exponent=0.5)
    assert set(found) == set(METAL)


def test_a_missing_parameter_is_named():
    with pytest.raises(KeyError, match=r"two-scale \(complex none\) needs b, c, sigma_s"):
        shape(TwoScale("none"))


def test_several_values_of_a_parameter_that_channels_share_are_refused():
    with pytest.raises(ValueError, match=r"needs one value of beta, not 3"):
        shape(TwoScale("none", "off"), beta=np.array([0.1, 0.2, 0.3]))
    with pytest.raises(ValueError, match=r"needs 3 values of n, not 2"):
        shape(TwoScale("none", "off"), n=np.array([1.0, 2.0]))
    assert shape(TwoScale("none", "off"), beta=np.array([0.1]))["beta"].shape == ()


def test_a_choice_that_is_a_number_may_be_given_as_one():
    assert made("gtr", {"gamma": 2}) == made("gtr", {"gamma": "2"}) == GTR(gamma="2")
    for wrong in (3, True, 2.0, "two"):
        with pytest.raises(ValueError, match=r"gtr: gamma .* is none of free, 1, 2"):
            made("gtr", {"gamma": wrong})
