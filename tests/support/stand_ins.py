"""Stand-ins of which everything is known, for the tests of the sampler: residuals in closed form."""

import numpy as np
from merlfit.fitting.fit.noise import Noise
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.posterior.emulator import Emulator, coordinates_of
from merlfit.fitting.posterior.likelihood import Likelihood
from merlfit.model.two_scale import TwoScale

LAYOUT = layout_of(TwoScale("lambert", "off"))
OWN = coordinates_of(LAYOUT, np.zeros(LAYOUT.size))
ROWS = 6  # residuals of a channel


def uncorrelated(normal, cost, count):
    """The noise of so many independent residuals at a fit of these normal equations (C, P+1, P+1)."""
    return Noise(cost, count, count * np.sum(normal, 0)[:-1, :-1] / cost)


def plain(weighed, target, scale):
    """A likelihood of independent residuals."""
    return Likelihood(weighed, target, scale, np.zeros((len(target), 1)), np.zeros((1, 1)))


def gentle(seed=0, channels=OWN):
    """Three channels of smooth residuals of the coordinates of `LAYOUT`, or of others; two of them count for more."""
    rng = np.random.default_rng(seed)
    slopes = [rng.normal(size=(len(own), ROWS)) for own in channels]
    bends = [0.3 * rng.normal(size=(len(own), ROWS)) for own in channels]

    def weighed(points):
        each = zip(channels, slopes, bends, strict=True)
        return np.concatenate([points[:, own] @ a + np.sin(points[:, own]) ** 2 @ b for own, a, b in each], 1)

    target, along = 0.3 * rng.normal(size=3 * ROWS), np.linalg.qr(rng.normal(size=(3 * ROWS, 2)))[0]
    return Likelihood(weighed, target, 2.0, along, np.array([[0.5, 0.2], [0.2, 1.0]]))


def banana():
    """One channel in two coordinates: a valley along a parabola, which the prior ends."""

    def weighed(points):
        x, y = points.T
        return np.stack([0.4 * x, y - x**2 + 1], 1)

    return plain(weighed, np.zeros(2), 3.0)


def trained(few, own, points):
    """An emulator of a stand-in, from its values at ``points``."""
    along = few.along.reshape(len(own), -1, few.along.shape[1])
    nothing = np.empty((0, *along.shape[:2]))
    return Emulator(points[:0], nothing, own, few.scale, along, few.excess).with_points(few, points)
