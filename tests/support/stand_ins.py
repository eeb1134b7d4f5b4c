"""Stand-ins of which everything is known, for the tests of the sampler: residuals in closed form."""

import numpy as np
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.posterior.emulator import Emulator, coordinates_of
from merlfit.fitting.posterior.likelihood import StandIn
from merlfit.model.two_scale import TwoScale

LAYOUT = layout_of(TwoScale("lambert", "off"))
OWN = coordinates_of(LAYOUT, np.zeros(LAYOUT.size))
ROWS = 6  # residuals of a channel


def gentle(seed=0, channels=OWN):
    """Three channels of smooth residuals of the coordinates of `LAYOUT`, or of others."""
    rng = np.random.default_rng(seed)
    slopes = [rng.normal(size=(len(own), ROWS)) for own in channels]
    bends = [0.3 * rng.normal(size=(len(own), ROWS)) for own in channels]

    def weighed(points):
        each = zip(channels, slopes, bends, strict=True)
        return np.concatenate([points[:, own] @ a + np.sin(points[:, own]) ** 2 @ b for own, a, b in each], 1)

    return StandIn(weighed, 0.3 * rng.normal(size=3 * ROWS), 2.0)


def banana():
    """One channel in two coordinates: a valley along a parabola, which the prior ends."""

    def weighed(points):
        x, y = points.T
        return np.stack([0.4 * x, y - x**2 + 1], 1)

    return StandIn(weighed, np.zeros(2), 3.0)


def trained(few, own, points):
    """An emulator of a stand-in, from its values at ``points``."""
    return Emulator(points[:0], np.empty((0, len(own), len(few.target) // len(own))), own, few.scale).with_points(
        few, points
    )
