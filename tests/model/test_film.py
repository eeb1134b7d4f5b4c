"""A film's reflectance against characteristic matrices, its limits and its channels' bands."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import film
from merlfit.model.fresnel import fresnel
from merlfit.model.parameters import WAVELENGTHS_UM

from tests.oracles import films

reflectance = jax.jit(film.reflectance)
N, K = jnp.array([1.3, 0.4, 2.1])[:, None], jnp.array([0.2, 3.0, 0.0])[:, None]
CHANNELS = jnp.array(WAVELENGTHS_UM)[:, None]
RED, GREEN, BLUE = (1 / x for x in WAVELENGTHS_UM)
GAPS = (GREEN - RED, (BLUE - RED) / 2, BLUE - GREEN)  # between wavenumbers


def by_oracle(cosines, eta, thickness, widths):
    rows = zip(np.ravel(N).tolist(), np.ravel(K).tolist(), WAVELENGTHS_UM, widths, strict=True)
    return np.array(
        [[films.reflectance(c, n, k, eta, thickness, um, w) for c in cosines.tolist()] for n, k, um, w in rows]
    )


def test_at_a_wavelength_alone_to_1e_12():
    cosines, lines = jnp.linspace(0.02, 1, 12), [CHANNELS[c : c + 1] for c in range(3)]
    found = np.concatenate([reflectance(cosines, *at, 1.8, 0.37, um) for *at, um in zip(N, K, lines, strict=True)])
    assert abs(found - by_oracle(cosines, 1.8, 0.37, (0, 0, 0))).max() < 1e-12
    assert abs(found - by_oracle(cosines, 1.8, 0.40, (0, 0, 0))).max() > 0.05


@pytest.mark.parametrize(("eta", "thickness"), [(1.4, 0.9), (1.8, 0.3), (2.4, 0.5)])
def test_of_three_channels_to_3e_3_up_to_70_degrees_and_1_5_percent_at_85(eta, thickness):
    cosines = jnp.cos(jnp.radians(jnp.array([0.0, 40.0, 70.0, 85.0])))
    found = np.asarray(reflectance(cosines, N, K, eta, thickness, CHANNELS))
    away = abs(found - by_oracle(cosines, eta, thickness, GAPS)).max(0)
    assert away[:3].max() < 3e-3
    assert away[3] < 0.015
    assert abs(found - by_oracle(cosines, eta, thickness, (0, 0, 0))).max() > 0.02  # a line is none of these bands


def test_a_film_of_index_1_is_none_and_a_quarter_wave_of_the_root_cancels():
    cosines, one = np.linspace(1e-3, 1, 9), np.ones((1, 1))
    assert (
        abs(np.asarray(reflectance(cosines, N, K, 1.0, 0.5, CHANNELS)) - jax.jit(fresnel)(cosines, N, K)).max() < 1e-14
    )
    assert reflectance(np.ones(1), 2.25 * one, 0 * one, 1.5, 0.5 / (4 * 1.5), 0.5 * one)[0, 0] < 1e-15


@pytest.mark.parametrize("point", [(1.5, 0.0, 1.01, 0.3), (0.02, 1e-3, 3.0, 1.0), (10.0, 15.0, 1.01, 0.02)])
def test_derivatives_are_finite_at_the_edges(point):
    def of(p):
        return film.reflectance(jnp.array([0.0, 1e-9, 0.5, 1.0]), p[0] * jnp.ones((3, 1)), p[1], p[2], p[3], CHANNELS)

    assert np.isfinite(jax.jit(jax.jacfwd(of))(jnp.array(point))).all()


def test_three_colours_have_bands_side_by_side_and_other_wavelengths_none():
    widths = np.ravel(film.between_nodes(CHANNELS)) / film.STEP * film.FWHM
    assert np.allclose(widths, GAPS)
    for lines in ([0.633, 0.532, 0.405], [0.5], np.linspace(0.4, 0.7, 31)):
        assert not np.any(film.between_nodes(jnp.asarray(lines)))
    assert np.isclose(sum(film.WEIGHTS), 1)


def test_at_the_ends_of_the_bounds_bands_are_good_to_4_percent():
    cosines = jnp.cos(jnp.radians(jnp.array([0.0, 40.0, 70.0, 80.0, 85.0])))
    away = [
        abs(np.asarray(reflectance(cosines, N, K, eta, 1.0, CHANNELS)) - by_oracle(cosines, eta, 1.0, GAPS)).max(0)
        for eta in (2.0, 3.0)
    ]
    assert np.max(away) < 0.045
    assert np.max(np.array(away)[:, :3]) < 0.03


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_it_keeps_the_precision_that_it_is_given(precision):
    wavelengths = np.array([[0.61], [0.54], [0.45]], precision)
    constants = (np.full((3, 1), x, precision) for x in (1.2, 2.0))
    found = reflectance(np.array([0.1, 0.9], precision), *constants, precision(1.5), precision(0.4), wavelengths)
    assert found.dtype == precision
    assert found.shape == (3, 2)
