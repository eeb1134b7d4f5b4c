"""Colours of wavelengths: the observer against its tables, white, and the order of columns."""

import numpy as np
import pytest
from merlfit.merl_io.bands import MERL, XYZ, Bands
from merlfit.scene.colour import REFLECTANCE_NM, cielab, coloured, observer, reflectances, weights_of

COPPER = {0.45: 0.55, 0.532: 0.6, 0.633: 0.93}  # reflectance at normal incidence by wavelength (um)
CIE_1931 = {  # x, y and z by wavelength (nm), of CIE 15's table
    445: (0.3481, 0.0298, 1.7826), 500: (0.0049, 0.3230, 0.2720), 555: (0.5121, 1.0000, 0.0057),
    600: (1.0622, 0.6310, 0.0008), 650: (0.2835, 0.1070, 0.0),
}  # fmt: skip


def bands(*wavelengths_um):
    return Bands(tuple(f"{1000 * x:g}nm" for x in wavelengths_um), wavelengths_um)


def test_the_observer_is_that_of_the_table():
    found = observer(np.array(list(CIE_1931), float)).T
    np.testing.assert_allclose(found, list(CIE_1931.values()), atol=0.03)


@pytest.mark.parametrize("given", [(0.55,), (0.45, 0.65), tuple(np.linspace(0.4, 0.7, 31)), (1.55, 10.6)])
def test_white_is_white(given):
    np.testing.assert_allclose(weights_of(bands(*given)).sum(1), 1, rtol=1e-9)
    np.testing.assert_allclose(coloured(np.full((len(given), 4), 0.2), bands(*given)), 0.2, rtol=1e-9)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_copper_is_copper_whatever_the_order_of_columns(order):
    given = [list(COPPER)[k] for k in order]
    found = coloured(np.array([COPPER[x] for x in given]), bands(*given))
    np.testing.assert_allclose(found, (0.953, 0.645, 0.538), atol=2e-3)
    _, a, b = cielab(found)
    assert 40 < np.degrees(np.arctan2(b, a)) < 60  # orange; taken as R, G and B it is at 260 degrees, blue


def test_narrow_bands_are_the_colours_of_their_light():
    """A reflector of one end of the spectrum alone: red at the long end, blue at the short one, green between."""
    given = bands(0.44, 0.46, 0.5, 0.56, 0.6, 0.65)
    red, green, blue = (coloured(np.array(x, float), given) for x in (
        (0, 0, 0, 0, 0, 1), (0, 0, 1, 1, 0, 0), (1, 1, 0, 0, 0, 0),
    ))  # fmt: skip
    assert [int(np.argmax(x)) for x in (red, green, blue)] == [0, 1, 2]


def test_three_channels_that_are_named_stay_what_they_are():
    values = np.array([[1.0], [2.0], [3.0]])
    assert coloured(values, MERL) is values
    turned = Bands(("B", "R", "G"), (0.444, 0.645, 0.526))
    np.testing.assert_array_equal(coloured(values, turned), [[2], [3], [1]])


def test_spectra_of_red_green_and_blue_have_these_colours_under_daylight_as_mitsuba_sees_them():
    """By its tables of the observer and of D65; our observer is within 1 %."""
    mi = pytest.importorskip("mitsuba", reason="needs merlfit[mitsuba]")
    mi.set_variant("scalar_spectral")
    nm, at, lamp = np.arange(360.0, 831.0), mi.SurfaceInteraction3f(), mi.load_dict({"type": "d65"})

    def daylight(x):
        at.wavelengths = [x] * 4
        return lamp.eval(at)[0]

    seen = np.array([mi.cie1931_xyz(float(x)) for x in nm]).T * [daylight(float(x)) for x in nm]
    found = reflectances()
    assert np.all((found >= 0) & (found <= 1))
    np.testing.assert_allclose(found.sum(0), 1, atol=1e-5)
    xyz = seen @ np.stack([np.interp(nm, REFLECTANCE_NM, each) for each in found]).T / seen[1].sum()
    np.testing.assert_allclose(np.linalg.solve(XYZ, xyz), np.eye(3), atol=0.012)
