"""Albedos of genuine measurements: ours beside those that `tests.measured_albedo` had of Mitsuba."""

import json
import os

import numpy as np
import pytest

from tests import measured, measured_albedo
from tests.support.reconstructions import DATA


@pytest.fixture(scope="module")
def mitsuba():
    return json.loads(measured_albedo.TABLE.read_text())


@pytest.fixture(scope="module")
def files():
    folder = DATA / "measured" / "rgl"
    if not folder.is_dir():
        (pytest.fail if os.environ.get("CI") else pytest.skip)("needs RGL's files in ../shared/data/measured")
    return folder


@pytest.mark.parametrize("name", ["cc_green_malachite_rgb", "chm_orange_rgb"])
def test_a_file_has_the_albedo_that_mitsuba_draws(name, files, mitsuba):
    """By the shares of its samples: within 3 % of every channel, of a tenth of the brightest one at the least."""
    ours = measured.of_the_file(files / f"{name}.bsdf").T
    there = np.array([mitsuba[name][str(theta_i)]["sampled"] for theta_i in measured.THETA_I])
    grazing = np.array(measured.THETA_I) > 70  # where the last incidence has zeros below the horizon: results/measured
    allowed = np.where(grazing, 0.05, measured.NEAR)[:, None] * np.maximum(np.abs(there), 0.1 * there.max(1)[:, None])
    assert np.all(np.abs(ours - there) < allowed)


def test_two_ways_through_mitsuba_agree(mitsuba):
    """Importance sampling by the file's density misses nothing that its values hold."""
    rows = [row for each in mitsuba.values() for row in each.values()]
    sampled, quadrature, error, clamped = (
        np.array([r[name] for r in rows]) for name in ("sampled", "quadrature", "error", "clamped")
    )
    brightest = sampled.max(1)[:, None]
    assert len(mitsuba) == 20
    assert np.all(error < 0.005 * brightest)
    np.testing.assert_allclose(sampled / brightest, quadrature / brightest, atol=0.003)
    assert np.max((clamped - sampled) / brightest) > 0.1, "without the negative values it would be another albedo"
