"""What several tests of the fit share."""

import frontiers
import pytest
from merlfit.fitting.cost import calibration


@pytest.fixture
def made():
    """A frontier of invented numbers: every point twice as accurate as the last and 1.5 times as dear."""
    return frontiers.invented()


@pytest.fixture
def file(tmp_path):
    """A synthetic conductor as a MERL file."""
    return calibration.make("drawn-1000", tmp_path / "files")
