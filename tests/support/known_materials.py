"""Known materials as MERL's apparatus would have stored them: synthetic data."""

import jax
import numpy as np
from merlfit.merl_io.grid import merl_grid
from merlfit.model.measured import Measured
from merlfit.model.two_scale import two_scale

from tests.support.compiled import from_half_difference

CONDUCTOR = {
    "beta": 0.12, "p": 0.6, "b": 4.8, "c": 2.2, "sigma_s": 0.027, "n": np.array([1.9, 1.7, 1.6]),
    "k": np.array([3.5, 3.2, 2.4]),
}  # fmt: skip
PLASTIC = {
    "beta": 0.08, "p": 0.8, "b": 1.5, "c": 1.8, "sigma_s": 0.04, "eta": np.array([1.45, 1.5, 1.55]),
    "albedo": np.array([0.5, 0.2, 0.05]),
}  # fmt: skip
EXPONENTS = {"grazing_exponent": 0.35, "grazing_exponent_diffracted": 0.15}


def tabulate(values, effects, exponents=EXPONENTS):
    """Of every bin, (3, 90, 90, 180); NaN below the horizon."""
    grid = merl_grid()
    parts = []
    compiled = jax.jit(lambda g: two_scale({**values, **exponents}, g, Measured(effects)))
    for rows in np.split(np.arange(90), 9):
        g = from_half_difference(grid.theta_h[rows, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :])
        parts.append(np.asarray(compiled(g)))
    return np.where(grid.above, np.concatenate(parts, 1), np.nan)
