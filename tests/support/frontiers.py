"""Frontiers of invented numbers, and synthetic materials as they are read, for the tests of what accuracy costs."""

from pathlib import Path

import numpy as np
from merlfit.fitting.cost import calibration
from merlfit.fitting.cost.frontier import OBJECTIVE, Frontier, Percentiles, Point
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import run, synthesis
from merlfit.fitting.results.storage import versions
from merlfit.fitting.settings.choice import POINTS
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.threads import machine
from merlfit.merl_io.binary import Measurement


def spread(value):
    return Percentiles(median=value / 2, p95=value, worst=2 * value)


def point(choice, error, seconds, other_minimum=0.0):
    return Point(
        choice=choice, error=spread(error), promised=spread(error), other_minimum=other_minimum, failed=0.0,
        other_body=0.0, rmse=spread(0.1), parameters=None, seconds=spread(seconds), estimate_seconds=spread(0.5),
        megabytes=900.0,
    )  # fmt: skip


def invented():
    """A frontier of invented numbers: every point twice as accurate as the last and 1.5 times as dear."""
    points = [point(choice, 0.1 / 2**k, 1.5**k) for k, choice in enumerate(POINTS)]
    return Frontier(
        objective=OBJECTIVE, data="invented materials", materials=["a"], machine=machine(), taken="2026-11-22",
        versions=versions(), points=points,
    )  # fmt: skip


def measurement(name, **given):
    """A synthetic material as it would be read, its samples, and a configuration."""
    seed, _, source = name.removeprefix("drawn-").partition(".")
    values = synthesis.from_published(seed, source)[0] if source else calibration.drawn(int(seed))
    measured = Measurement(Path(name), values, np.isfinite(values).all(0), 0, 0, 0, "", "")
    return measured, weighted_samples(measured), load(posterior=False, **given)


def fit(measured, samples, config):
    return run.fit(measured, samples, config)
