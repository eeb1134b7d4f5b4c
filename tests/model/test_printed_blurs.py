"""The quadrature beside HP17's own ways to blur the diffraction lobe: where they agree, and where they fail."""

import math

import jax
import numpy as np
import pytest
from merlfit.model import convolution

from tests.oracles import scaled as o_scaled
from tests.oracles import zonal as o_zonal
from tests.support.lobes import ANGLES, draw, truth

convolve = jax.jit(convolution.convolve, static_argnums=5)
SMOOTH = [(1.0, 2.0, 0.3, 1.0), (4.0, 1.2, 0.1, 2.0), (0.5, 5.0, 1.0, 0.6)]  # B, c, beta, p


def moment(function, degree):
    """The oracle's coefficient without the factor of Y_l."""
    return o_zonal.coefficient(function, degree) / (2 * math.pi * math.sqrt((2 * degree + 1) / (4 * math.pi)))


def test_the_oracle_knows_moments_in_closed_form():
    # Int_0^1 x^2 P_l dx
    found = [moment(o_zonal.lobe(0.0, 3.0), k) for k in range(3)]
    np.testing.assert_allclose(found, [1 / 3, 1 / 4, 2 / 15], rtol=1e-12)


@pytest.mark.parametrize("lobe", SMOOTH)
def test_zonal_harmonics_of_smooth_lobes_tend_to_the_quadrature(lobe):
    """HP17 Appendix A, Eq. 61-64: an integral of another kind than ours."""
    theta_h = np.linspace(0, 1.3, 6)
    found = np.asarray(convolve(theta_h, *lobe, 64))
    expected = o_zonal.truncated(theta_h, *lobe, 60)
    np.testing.assert_allclose(expected, found, rtol=2e-4)  # the horizon of S leaves terms like l^-5 or so
    # orthonormal coefficients multiplied as if they were Fourier's
    wrong = o_zonal.truncated(theta_h, *lobe, 60, factor=lambda degree: 1.0)
    assert np.max(np.abs(wrong / found - 1)) > 1e-2


def test_zonal_harmonics_of_a_sharp_lobe_ring():
    """Why they are no tier (docs/physics.md): half of the peak is missing, and there is light where there is none."""
    lobe, theta_h = (300.0, 3.0, 0.003, 1.0), np.linspace(0, 0.3, 40)
    found, expected = o_zonal.truncated(theta_h, *lobe, 50), np.asarray(convolve(theta_h, *lobe, 64))
    assert found.min() < -1e-3 * expected[0]
    assert found[0] < 0.5 * expected[0]


def errors_of_best(lobes, squared_cosine=True):
    """Of the best scaled lobes, relative where the lobe is above 1e-3 of its peak: the median of each."""
    blurred = np.asarray(truth(lobes))
    found = [o_scaled.best(np.asarray(ANGLES), x, c, squared_cosine) for x, c in zip(blurred, lobes[:, 1], strict=True)]
    seen = blurred > 1e-3 * blurred[:, :1]
    return np.array([np.median(np.abs(f / x - 1)[s]) for f, x, s in zip(found, blurred, seen, strict=True)])


def test_a_scaled_lobe_is_good_for_narrow_normals_alone():
    """HP17 Eq. 39-41 with the cos^2 that they lack (docs/physics.md)."""
    narrow, wide = draw(40, (0.3, 1.1, 0.002, 0.6), (10, 5, 0.01, 3)), draw(40, (10, 1.1, 0.1, 0.6), (300, 5, 0.5, 3))
    good, printed = errors_of_best(narrow), errors_of_best(narrow, squared_cosine=False)
    assert np.median(good) < 2e-3
    assert np.median(printed) > 10 * np.median(good)
    assert np.median(errors_of_best(wide)) > 0.05
