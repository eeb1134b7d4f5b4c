"""The calibration of the normal approximation in directions of genuine files, with and without stated uncertainties."""

from functools import partial

from . import calibration

run = partial(calibration.run, chain=False, reaches=calibration.SCATTERED)
