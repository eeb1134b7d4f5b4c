"""The EPD against slow oracles, with wrong formulas that are rejected."""

import jax
import numpy as np
import pytest
from merlfit.model.ndf import epd as of_epd

from tests.oracles import ndf as o_ndf
from tests.support.arrays import worst

epd = jax.jit(of_epd.epd)


@pytest.mark.parametrize(("beta", "p"), [(0.001, 0.3), (0.1, 0.2), (0.1, 1.0), (0.5, 5.0), (1.0, 0.7), (2.0, 2.0)])
def test_epd_to_1e_8_and_normalised(beta, p):
    theta = np.arctan(beta * np.array([0.0, 1e-3, 0.3, 1.0, 1.7]))
    assert worst(epd(theta, beta, p), [o_ndf.epd(t, beta, p) for t in theta]) < 1e-8

    def mass(density):  # over v = 2 p log(tan/beta), where it is smooth
        v, step = np.linspace(-60 * max(p, 0.5), np.log(60.0), 6001, retstep=True)
        tan = beta * np.exp(v / (2 * p))
        t = np.arctan(tan)
        return float(np.sum(density(t) * np.cos(t) * 2 * np.pi * np.sin(t) * np.cos(t) * np.sin(t) / (2 * p)) * step)

    def density(t):
        return np.asarray(epd(t, beta, p))

    assert mass(density) == pytest.approx(1, abs=1e-8)
    assert mass(lambda t: density(t) * np.cos(t)) != pytest.approx(1, abs=1e-8)
