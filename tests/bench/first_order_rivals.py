"""The calibration of the normal approximation of rivals, of sums of two lobes among them."""

from functools import partial

from . import calibration

run = partial(calibration.run, chain=False, models=calibration.RIVALS)
