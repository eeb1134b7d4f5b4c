"""Samples in scattered directions: their angles, their order, and the few that stand for all."""

import numpy as np
import pytest
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.scattered import ScatteredSamples, half_difference, order, thin


def samples(value, share):
    """In rising theta_h, with the weight of their share, alike in all channels."""
    count, three = len(share), np.ones((3, 1))
    angles = np.linspace(0, 1, count), np.full(count, 0.5)
    return ScatteredSamples(*angles, *np.cos(angles), three * value, three * share, np.asarray(share, float), MERL)


def test_runs_of_the_order_are_boxes():
    """A run of 2^k samples spans 2^k / N of the cube's volume, more or less: not so in the order they came in."""
    points = np.random.default_rng(0).random((3, 4096))
    ranked = order(points)
    assert sorted(ranked) == list(range(4096))

    def spread(columns):
        boxes = points[:, columns].reshape(3, -1, 64)
        return np.ptp(boxes, axis=2).mean()

    assert spread(ranked) < 0.3
    assert spread(np.arange(4096)) > 0.9


def test_thinning_keeps_the_shares_of_all():
    all_ = samples(np.arange(7.0), np.arange(1.0, 8))
    few = thin(all_, 3)
    assert len(few.theta_h) == 3
    assert few.share.sum() == all_.share.sum() == 28
    np.testing.assert_allclose(few.weight.sum(1), all_.weight.sum(1))
    assert set(few.value[0]) <= set(all_.value[0])
    assert thin(all_, 7) is all_


def test_a_peak_of_little_share_does_not_stand_for_its_neighbours():
    """Samples crowd where a mirror's light goes: among neighbours one may have a peak's value and no share."""
    all_ = samples(np.tile([1.0, 1e3, 1.0], 10), np.tile([1.0, 1e-6, 1.0], 10))
    energy = [np.sum(x.weight * x.value**2) for x in (all_, thin(all_, 10))]
    assert energy[1] == pytest.approx(energy[0], rel=0.5)


def test_the_mirror_direction_is_at_180_degrees():
    theta_h, theta_d, _ = half_difference(*np.radians([[30.0], [30.0], [180.0]]))
    assert theta_h[0] == pytest.approx(0, abs=1e-12)
    assert np.degrees(theta_d[0]) == pytest.approx(30)
    assert half_difference(*np.radians([[30.0], [30.0], [0.0]]))[1][0] == pytest.approx(0, abs=1e-12)
