"""The calibration of the normal approximation at the fit: the noise model by itself, seconds a run."""

from functools import partial

from . import calibration

run = partial(calibration.run, chain=False)
