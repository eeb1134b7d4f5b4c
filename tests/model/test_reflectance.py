"""Names of parameters that are missing, misspelt or not needed."""

import numpy as np
import pytest
from merlfit.model.geometry import Geometry
from merlfit.model.reflectance import setting, shaped
from merlfit.model.two_scale import TwoScale

METAL = {"beta": 0.1, "p": 0.5, "n": [1.0] * 3, "k": [3.0] * 3}


def shape(effects, **params):
    geometry = Geometry.from_vectors(np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))
    return shaped({**METAL, **params}, setting(geometry, effects, (0.645, 0.526, 0.444)))


def test_a_parameter_of_no_effects_is_refused():
    with pytest.raises(KeyError, match=r"two-scale \(complex none\) has no parameter albdeo, sigma"):
        shape(TwoScale("none", "off"), albdeo=[0.1] * 3, sigma=0.1)


def test_parameters_of_other_effects_are_passed_over():
    found = shape(TwoScale("none", "off"), b=3.0, albedo=[0.1] * 3, grazing_exponent=0.5)
    assert set(found) == set(METAL)


def test_a_missing_parameter_is_named():
    with pytest.raises(KeyError, match=r"two-scale \(complex none\) needs b, c, sigma_s"):
        shape(TwoScale("none"))
