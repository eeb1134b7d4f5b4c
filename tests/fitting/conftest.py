"""What several tests of the fit share."""

import jax
import pytest
from merlfit.fitting.cost import calibration

from tests.support import frontiers

PROGRAMS = "jax_compilation_cache_dir"


@pytest.fixture
def made():
    """A frontier of invented numbers: every point twice as accurate as the last and 1.5 times as dear."""
    return frontiers.invented()


@pytest.fixture
def file(tmp_path):
    """A synthetic conductor as a MERL file."""
    return calibration.make("drawn-1000", tmp_path / "files")


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """A cache folder of its own, for what merlfit has measured of this machine; programs stay with those of others."""
    folder, update = tmp_path / "cache", jax.config.update
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(folder))
    monkeypatch.setattr(jax.config, "update", lambda name, x: update(name, x) if name != PROGRAMS else None)
    return folder
