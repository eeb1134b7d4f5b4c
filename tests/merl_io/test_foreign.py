"""Other programs' files: the same made-up material in each of them, genuine ones, and what is refused."""

import os
from pathlib import Path

import numpy as np
import pytest
from merlfit.merl_io import inputs
from merlfit.merl_io.bands import XYZ
from merlfit.merl_io.binary import MerlError
from merlfit.merl_io.scattered import cosine_shares, half_difference, vectors_of

INCIDENCES = (10.0, 40.0)
AZIMUTHS = np.arange(0.0, 181.0, 15.0)
RADIALS = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0])


def brdf(theta_i, theta_o, phi):
    """A made-up reciprocal one with a highlight; phi is pi on the mirror's side."""
    across = np.sin(theta_i) + np.sin(theta_o) * np.cos(phi)
    beside, up = np.sin(theta_o) * np.sin(phi), np.cos(theta_i) + np.cos(theta_o)
    return 0.02 + np.exp(-((np.hypot(across, beside) / up / 0.2) ** 2)) * (1 + np.sqrt(across**2 + beside**2 + up**2))


def specular_frame(incidence, azimuth, radial):
    """theta_o and phi (rad) of an azimuth and a radial angle, by turning vectors one after the other."""
    a, r, tilt = np.radians(azimuth), np.radians(radial), np.radians(incidence)
    x, y, z = np.sin(r) * np.cos(a), np.sin(r) * np.sin(a), np.cos(r)  # z along the specular direction, x to the normal
    back, up = np.cos(tilt) * x - np.sin(tilt) * z, np.sin(tilt) * x + np.cos(tilt) * z
    return np.arccos(up), np.arctan2(y, back)


def rows(factor=1.0, azimuths=AZIMUTHS):
    """What Zemax' file holds of every incidence: values by azimuth and radial angle, 0 below the horizon."""
    for incidence in INCIDENCES:
        theta_o, phi = specular_frame(incidence, azimuths[:, None], RADIALS)
        values = np.where(theta_o < np.pi / 2, factor * brdf(np.radians(incidence), theta_o, phi), 0.0)
        yield f"TIS {factor * 0.1:g}\n" + "\n".join("\t".join(f"{x:.6e}" for x in row) for row in values)


def zemax(path, spectra=(("Monochrome", 1.0),), azimuths=AZIMUTHS, **words):
    """Write such a file."""
    known = {
        "Source": "Measured",
        "Symmetry": "PlaneSymmetrical",
        "SpectralContent": "Monochrome",
        "ScatterType": "BRDF",
    }
    text = "# a laser (633 nm, 3 mm)\n" + "".join(f"{name}\t{x}\n" for name, x in {**known, **words}.items())
    text += "SampleRotation 1\n0\n"
    for name, angles in (("AngleOfIncidence", INCIDENCES), ("ScatterAzimuth", azimuths), ("ScatterRadial", RADIALS)):
        text += f"{name}\t{len(angles)}\n" + "\t".join(f"{x:g}" for x in angles) + "\n"
    for name, factor in spectra:
        text += f"\n{name}\nDataBegin\n" + "\n".join(rows(factor, azimuths)) + "\nDataEnd\n"
    path.write_text(text)
    return path


def fred(path, azimuth=0.0):
    """Write FRED's file of the same material; 0 is the specular side."""
    text = "type bsdf_data\nformat angles=deg bsdf=value scale=2\n"
    for incidence in INCIDENCES:
        text += f"{incidence:g}\t{azimuth:g}\n"
        for theta_o, phi in ((0, 0), (20, 0), (20, 90), (incidence, 0), (incidence, 180), (60, 45), (80, 180)):
            value = brdf(*np.radians([incidence, theta_o, 180.0 - phi]))
            text += f"{theta_o:g}\t{phi + azimuth:g}\t{value / 2:.8e}\n"
    path.write_text(text)
    return path


def alta(path, coordinates, *header):
    """Write ALTA's file of the same material.

    Args:
        coordinates: of theta_i, theta_o and phi (rad). header: more lines.
    """
    theta_i, theta_o, phi = PAIRS
    columns = np.array(coordinates(theta_i, theta_o, phi))
    values = brdf(theta_i, theta_o, phi)
    text = "\n".join(["#SAMPLE made up", f"#DIM {len(columns)} 1", *header, ""])
    text += "\n".join(" ".join(f"{x:.12e}" for x in row) for row in np.vstack([columns, values]).T)
    path.write_text(text)
    return path


PAIRS = np.array([[0.2, 0.2, np.pi], [0.5, 0.4, 2.0], [0.9, 0.1, 1.0], [0.3, 0.8, 0.0], [0.7, 0.7, 0.1]]).T
ISOTROPIC = "#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI", "#PARAM_OUT INV_STERADIAN"


def agrees(found, rtol=1e-5):
    """Whether all samples hold the made-up material."""
    np.testing.assert_allclose(found.values[0], brdf(found.theta_i, found.theta_o, found.phi), rtol)


def reflected(measured, incidence):
    """Share of the light that one incidence reflects, by the shares of its samples (which are a grid's)."""
    theta_i = np.unique(measured.theta_i)
    k = int(np.argmin(np.abs(theta_i - np.radians(incidence))))
    here = measured.theta_i == theta_i[k]
    return measured.values[0, here] @ (measured.share * np.cos(measured.theta_o))[here] / cosine_shares(theta_i)[k]


def refusal(path, text=None):
    """The line that a file is refused with."""
    if text is not None:
        path.write_text(text)
    with pytest.raises(MerlError) as error:
        inputs.read(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    return str(error.value)


# --- Zemax


def test_zemax_angles_are_about_the_specular_direction(tmp_path):
    found = inputs.read(zemax(tmp_path / "made.bsdf"))
    assert found.format == "Zemax"
    assert found.bands.names == ("633nm",)
    assert found.stated_tis == tuple((pytest.approx(np.radians(i)), 0.1) for i in INCIDENCES)
    agrees(found)
    mirrored = (np.abs(found.theta_o - found.theta_i) < 1e-9) & (np.abs(np.abs(found.phi) - np.pi) < 1e-9)
    assert mirrored.sum() == len(INCIDENCES), "one sample, not one for every azimuth"
    assert found.theta_o.max() < np.pi / 2
    assert any("at the largest radial angles" in note for note in found.notes) is False, "all of them are below"
    turned = brdf(found.theta_i, found.theta_o, np.pi - found.phi)
    assert np.abs(found.values[0] / turned - 1).max() > 1, "azimuth 0 is not away from the normal"


def test_zemax_shares_are_solid_angles(tmp_path):
    fine = np.linspace(0, np.pi / 2, 2000)[:, None], np.linspace(0, np.pi, 500)
    found = inputs.read(zemax(tmp_path / "made.bsdf"))
    whole = inputs.read(zemax(tmp_path / "whole.bsdf", azimuths=np.arange(0.0, 360.0, 15.0), Symmetry="Asymmetrical"))
    for incidence in INCIDENCES:
        light = brdf(np.radians(incidence), *fine) * np.cos(fine[0]) * np.sin(fine[0])
        expected = 2 * np.trapezoid(np.trapezoid(light, fine[1]), fine[0][:, 0])
        assert reflected(found, incidence) == pytest.approx(expected, rel=0.06)
        assert reflected(whole, incidence) == pytest.approx(reflected(found, incidence), rel=1e-9)


def test_zemax_xyz_is_read_as_linear_srgb(tmp_path):
    names = [f"Tristimulus{name}" for name in "XYZ"]
    colour = np.array([0.9, 0.5, 0.1])
    path = zemax(tmp_path / "colour.bsdf", tuple(zip(names, XYZ @ colour, strict=True)), SpectralContent="XYZ")
    found = inputs.read(path)
    assert found.bands.names == ("R", "G", "B")
    expected = np.outer(colour, brdf(found.theta_i, found.theta_o, found.phi))
    np.testing.assert_allclose(found.values, expected, 1e-4)
    assert found.stated_tis[0][1] == pytest.approx(0.1 * XYZ[1] @ colour, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("ScatterType\tBRDF", "ScatterType\tBTDF", "line 5: ScatterType is 'BTDF': light that passes through"),
        ("PlaneSymmetrical", "ASymmetrical4D", "line 3: Symmetry is 'ASymmetrical4D': an anisotropic material"),
        ("Monochrome", "Spectral", "SpectralContent is 'Spectral': known: Monochrome, XYZ"),
        ("SampleRotation 1\n0", "SampleRotation 2\n0 90", "is anisotropic: it has 2 angles of SampleRotation"),
        ("Symmetry\tPlaneSymmetrical\n", "", "has no Symmetry before its data"),
        ("0\t15\t30", "0\t15\t15", "the angles of ScatterAzimuth do not rise from 0 or more to 360"),
        ("0\t15\t30", "0\t15\tx", "is not a row of numbers"),
        ("TIS 0.1", "TIS 0.1 nobody", "stands where TIS or DataEnd should"),
        ("DataEnd", "", "is cut off: it has no DataEnd after Monochrome"),
        ("AngleOfIncidence\t2\n10\t40", "AngleOfIncidence\t3\n10\t40\t60", "has 2 blocks, and there are 3 angles"),
        ("AngleOfIncidence\t2\n10\t40", "AngleOfIncidence\t1\n10\t40", "is followed by 2 numbers, not 1"),
        ("DataBegin", "", "has no DataBegin after Monochrome"),
        ("Source\tMeasured", "Colour\tRed", "line 2: 'Colour\\tRed' begins no part of a Zemax .bsdf file"),
    ],
)
def test_a_zemax_file_that_is_not_read_is_refused(old, new, words, tmp_path):
    text = zemax(tmp_path / "made.bsdf").read_text()
    assert old in text
    assert words in refusal(tmp_path / "bad.bsdf", text.replace(old, new, 1 if old != "DataEnd" else -1))


# --- FRED


@pytest.mark.parametrize("azimuth", [0.0, 90.0])
def test_fred_has_the_specular_side_at_the_azimuth_of_the_incidence(azimuth, tmp_path):
    found = inputs.read(fred(tmp_path / "made_1064nm.txt", azimuth))
    assert (found.format, found.bands.names, found.notes) == ("FRED", ("1064nm",), ())
    agrees(found)


def test_a_wavelength_that_nobody_states_is_told(tmp_path):
    (note,) = inputs.read(fred(tmp_path / "made.txt")).notes
    assert "states no wavelength: 550 nm is taken" in note
    assert "made_633nm.txt" in note


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("type bsdf_data", "theta_i_deg,theta_o_deg", "rename it .csv"),
        ("angles=deg", "angles=dircos", "is not read, only 'format angles=deg bsdf=value scale=NUMBER'"),
        ("scale=2", "scale=0", "is not read, only"),
        ("40\t0\n", "40\t30\n", "is anisotropic: its incidences have several azimuths"),
        ("20\t90\t", "20\t90\t0\t", "line 6 has 4 numbers"),
        ("20\t90\t", "120\t90\t", "line 6: its angle of scatter, 120, is no angle of reflected light"),
        ("20\t90\t", "20\tx\t", "line 6: '20"),
    ],
)
def test_a_fred_file_that_is_not_read_is_refused(old, new, words, tmp_path):
    text = fred(tmp_path / "made.txt").read_text()
    assert old in text
    assert words in refusal(tmp_path / "bad.txt", text.replace(old, new, 1))


def test_a_fred_file_without_samples_is_refused(tmp_path):
    assert "has no samples" in refusal(tmp_path / "bad.txt", "type bsdf_data\nformat angles=deg bsdf=value scale=1\n")


# --- ALTA


def unit(theta, phi):
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


PARAMETRIZATIONS = {
    "ISOTROPIC_TL_TV_PROJ_DPHI": lambda i, o, phi: (i, o * np.cos(phi), o * np.sin(phi)),
    "ISOTROPIC_TV_TL_DPHI": lambda i, o, phi: (o, i, -phi),
    "SPHERICAL_TL_PL_TV_PV": lambda i, o, phi: (i, 0.3 + 0 * i, o, 0.3 + phi),
    "RUSIN_TH_TD_PD": half_difference,
    "RUSIN_TH_PH_TD_PD": lambda i, o, phi: np.insert(half_difference(i, o, phi), 1, 0.3, 0),
    "CARTESIAN": lambda i, o, phi: (*unit(o, 0.3 + phi), *unit(i, 0.3)),
}


@pytest.mark.parametrize("name", PARAMETRIZATIONS)
def test_alta_parametrizations(name, tmp_path):
    path = alta(tmp_path / "made_633nm.alta", PARAMETRIZATIONS[name], f"#PARAM_IN {name}", "#PARAM_OUT INV_STERADIAN")
    found = inputs.read(path)
    assert (found.format, found.bands.names, found.notes) == ("ALTA", ("633nm",), ())
    agrees(found)
    whole = [np.stack(half_difference(*x)) for x in (PAIRS, (found.theta_i, found.theta_o, found.phi))]
    np.testing.assert_allclose(*whole, atol=1e-6)


def test_alta_values_times_the_cosine_are_divided_by_it(tmp_path):
    path = alta(tmp_path / "made.dat", PARAMETRIZATIONS["CARTESIAN"], "#PARAM_IN CARTESIAN")
    plain = inputs.read(path)
    assert any("does not say what its values are" in note for note in plain.notes)
    path.write_text("#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n" + path.read_text())
    found = inputs.read(path)
    np.testing.assert_allclose(found.values * np.cos(found.theta_o), plain.values)


def test_alta_intervals_and_colours(tmp_path):
    rows = "#PARAM_OUT RGB_COLOR\n#PARAM_IN RUSIN_TH_TD_PD\n#DIM 3 3\n#VS 2 0 1\n0.1 0.2 0.3 1 2 3 9 9 9\n"
    (tmp_path / "made.dat").write_text(rows)
    found = inputs.read(tmp_path / "made.dat")
    assert found.bands.names == ("R", "G", "B")
    np.testing.assert_array_equal(found.values[:, 0], [1, 2, 3])
    assert found.notes == ("the intervals of its values are not read",)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("#DIM 3 1\n", "", "is no ALTA file: it has no line #DIM"),
        ("TL_TV_PROJ_DPHI", "TV_TL", "#PARAM_IN ISOTROPIC_TV_TL is not read, only ISOTROPIC_TL_TV_PROJ_DPHI, "),
        ("INV_STERADIAN", "ENERGY", "#PARAM_OUT ENERGY is not read, only INV_STERADIAN, "),
        ("#DIM 3 1", "#DIM 4 1", "#DIM 4 1 does not fit ISOTROPIC_TL_TV_PROJ_DPHI"),
        ("#DIM 3 1", "#DIM 3 1\n#VS 3", "#VS 3 is not read"),
        ("#DIM 3 1", "#DIM 3 1\n#FORMAT binary", "#FORMAT binary is not read"),
        ("2.000000000000e-01", "2.0 0", "line 5 has 5 numbers, and by the header there are 4"),
        ("2.000000000000e-01", "nan", "line 5: its coordinates are no angles (rad) or unit vectors"),
    ],
)
def test_an_alta_file_that_is_not_read_is_refused(old, new, words, tmp_path):
    text = alta(tmp_path / "made.dat", PARAMETRIZATIONS["ISOTROPIC_TL_TV_PROJ_DPHI"], *ISOTROPIC).read_text()
    assert old in text
    assert words in refusal(tmp_path / "bad.dat", text.replace(old, new, 1))


# --- NVIDIA


def mbsdf(path, *parts, remarks=""):
    """Write a file of parts: the line that names one, and values (T, T, P, C)."""
    with path.open("wb") as file:
        file.write(f"NVIDIA ARC MBSDF V1\n{remarks}".encode())
        for name, values in parts:
            thetas, _, phis, channels = values.shape
            file.write(f"{name}=\n".encode() + np.array([channels == 3, thetas, phis], "<u4").tobytes())
            file.write(values.astype("<f4").tobytes())
    return path


def cells(thetas, phis):
    """The made-up material in the middles of cells, (T, T, P, 1)."""
    theta = (np.arange(thetas) + 0.5) * np.pi / 2 / thetas
    return brdf(theta[:, None, None], theta[:, None], (np.arange(phis) + 0.5) * np.pi / phis)[..., None]


def test_mbsdf_values_lie_in_the_middles_of_cells(tmp_path):
    values = cells(30, 36)
    found = inputs.read(mbsdf(tmp_path / "made.mbsdf", ("MBSDF_DATA", values), remarks='LASER="1064 nm"\n'))
    assert (found.format, found.bands.names, found.notes) == ("MBSDF", ("1064nm",), ())
    agrees(found, 1e-4)
    assert found.share.sum() == pytest.approx(2 * np.pi), "a hemisphere, times the integral of the cosine"
    matte = inputs.read(mbsdf(tmp_path / "matte_500nm.mbsdf", ("MBSDF_DATA", np.full((9, 9, 9, 1), 1 / np.pi))))
    assert reflected(matte, 85) == pytest.approx(1, rel=0.01)


def test_mbsdf_colours_order_and_copies(tmp_path):
    values = np.arange(5 * 5 * 4 * 3.0).reshape(5, 5, 4, 3) - 3
    values[3:], values[:, 4] = values[2], values[:, 3]
    reflection, other = ("MBSDF_DATA_REFLECTION", values), ("MBSDF_DATA_TRANSMISSION", values)
    found = inputs.read(mbsdf(tmp_path / "made.mbsdf", reflection, other))
    assert found.bands.names == ("R", "G", "B")
    np.testing.assert_array_equal(found.values.T.reshape(3, 4, 4, 3), values[:3, :4])
    assert found.values.min() == -3, "a negative value is a datum"
    assert [round(float(np.degrees(x.max()))) for x in (found.theta_i, found.theta_o)] == [45, 63]
    assert [note.split(" it ")[0] for note in found.notes] == [
        "from theta_i 54 degrees on", "from theta_o 72 degrees on", "its transmission is not read"
    ]  # fmt: skip


def test_an_mbsdf_file_that_is_not_read_is_refused(tmp_path):
    path, values = tmp_path / "bad.mbsdf", np.ones((2, 2, 2, 1))
    assert "is no MBSDF file: its first line is not" in refusal(path, "NVIDIA\n")
    assert "has no MBSDF_DATA" in refusal(mbsdf(path))
    assert "holds transmission alone" in refusal(mbsdf(path, ("MBSDF_DATA_TRANSMISSION", values)))
    whole = mbsdf(path, ("MBSDF_DATA", values)).read_bytes()
    for length, words in ((-1, "is cut off: it has"), (-40, "is cut off in its header")):
        path.write_bytes(whole[:length])
        assert words in refusal(path)
    path.write_bytes(whole.replace(b"=\n\0", b"=\n\2"))
    assert "has values of type 2 (0 or 1)" in refusal(path)


# --- declared quantities


def test_what_values_are_may_be_declared_of_tables(tmp_path):
    angles = {f"{name}_deg": np.degrees(x) for name, x in zip(("theta_i", "theta_o", "phi"), PAIRS, strict=True)}
    table = {**angles, "wavelengths_um": [0.55], "values": brdf(*PAIRS)[:, None]}
    for quantity, factor in (("brdf_cos", np.cos(PAIRS[1])), ("reflectance_factor", np.pi)):
        found = inputs.read({**table, "values": table["values"] * np.reshape(factor, (-1, 1))}, quantity=quantity)
        agrees(found)
        assert found.quantity == quantity
    path = fred(tmp_path / "made_633nm.txt")
    np.testing.assert_allclose(
        inputs.read(path, quantity="reflectance_factor").values * np.pi, inputs.read(path).values
    )


def test_formats_that_say_what_their_values_are_refuse_to_be_told(tmp_path):
    made = (
        zemax(tmp_path / "made.bsdf"), mbsdf(tmp_path / "made.mbsdf", ("MBSDF_DATA", cells(3, 3))),
        alta(tmp_path / "made.dat", PARAMETRIZATIONS["CARTESIAN"], "#PARAM_IN CARTESIAN"),
    )  # fmt: skip
    for path in made:
        with pytest.raises(
            MerlError, match=r"files say themselves.* leave out --quantity brdf_cos, which is for tables"
        ):
            inputs.read(path, quantity="brdf_cos")


# --- genuine measurements


@pytest.fixture(scope="module")
def genuine():
    """The path of a genuine file by its name."""
    folder = Path(__file__).parents[2] / ".." / "shared" / "data" / "measured"
    if not folder.is_dir():
        (pytest.fail if os.environ.get("CI") else pytest.skip)("needs ../shared/data/measured")
    return lambda name: folder / name


@pytest.mark.parametrize("name", ["AnoBlackEC1onAlum", "AnoBlackNiTEonSteel"])
def test_zemax_and_fred_hold_one_measurement(name, genuine):
    """The Zemax file was interpolated to its angles by those who measured, differently above either side of the plane.

    So the two agree where they have directions in common: in the plane of incidence, more than 20 degrees from the
    highlight, within 3 %; turned around, they do not.
    """
    zemax, fred = inputs.read(genuine(f"ua/{name}.bsdf")), inputs.read(genuine(f"ua/{name}.txt"))
    assert zemax.bands.names == ("650nm",)
    away, turned = [], []
    for incidence in np.radians([10, 30, 50, 70]):
        ours, theirs = (np.abs(m.theta_i - incidence) < 1e-6 for m in (zemax, fred))
        one, other = vectors_of(zemax)[1][ours], vectors_of(fred)[1][theirs]
        for there, ratios in ((other, away), (other * [-1, 1, 1], turned)):
            cosine = one @ there.T
            common = cosine.max(1) > 1 - 1e-9
            ratio = zemax.values[0, ours] / fred.values[0, theirs][cosine.argmax(1)]
            specular = np.abs(np.arccos(one @ [-np.sin(incidence), 0, np.cos(incidence)])) < np.radians(20)
            ratios.append(ratio[common & ~specular])
    away, turned = np.concatenate(away), np.concatenate(turned)
    assert len(away) > 30
    assert np.median(np.abs(away - 1)) < 0.03
    assert np.median(np.abs(turned - 1)) > 0.3


@pytest.mark.parametrize("name", ["EC1onAlum", "NiTEonSteel"])
def test_what_a_zemax_file_states_is_half_the_integral_without_the_cosine(name, genuine):
    """Right of a matte material alone: 0.7 to 1.4 times what its own numbers reflect."""
    path = genuine(f"ua/AnoBlack{name}.bsdf")
    found = inputs.read(path)
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    azimuth, radial = (np.radians(np.fromstring(lines[k], sep=" ")) for k in (9, 11))
    rows = np.array([np.fromstring(line, sep=" ") for line in lines[14:-1] if not line.startswith("TIS")])
    values = rows.reshape(-1, len(azimuth), len(radial))
    cells = (values[:, 1:, 1:] + values[:, 1:, :-1] + values[:, :-1, 1:] + values[:, :-1, :-1]) / 4
    sines = (np.sin(radial[1:]) + np.sin(radial[:-1])) / 2
    half = np.sum(cells * (sines * np.diff(radial)) * np.diff(azimuth)[:, None], (1, 2))  # of azimuths 0 to 180 alone
    stated = np.array([tis for _, tis in found.stated_tis])
    np.testing.assert_allclose(half, stated, rtol=3e-4)
    ours = np.array([reflected(found, incidence) for incidence in (10, 30, 50, 70)])
    assert ours[0] > 1.3 * stated[0]
    assert ours[-1] < 0.77 * stated[-1]


def test_a_genuine_alta_file_tells_its_cosine_and_its_side(genuine, tmp_path):
    path = genuine("retro/retro-gray-tape.dat")
    found = inputs.read(path)
    assert len(found.phi) == 7405 - 86, "without the horizon"
    assert np.degrees(np.unique(found.theta_i)) == pytest.approx([15, 30, 60])
    k = int(np.argmax(found.values[0]))
    assert np.abs(found.phi[k]) < 1e-6, "a retro-reflector"
    assert found.theta_o[k] == pytest.approx(found.theta_i[k])
    assert any("look like a BRDF times cos theta_o" in line for line in inputs.remarks(found))
    divided = tmp_path / "tape_633nm.dat"
    divided.write_text("#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n" + path.read_text())
    again = inputs.read(divided)
    assert again.bands.names == ("633nm",)
    assert not any("cos theta_o" in line for line in inputs.remarks(again))


def test_a_genuine_mbsdf_file_has_its_highlight_on_the_mirrors_side(genuine):
    found = inputs.read(genuine("nvidia/carpaint_red.mbsdf"))
    assert found.bands.names == ("R", "G", "B")
    assert len(found.phi) == 34 * 41 * 90, "without the copies at grazing angles"
    assert (found.values < 0).any()
    k = int(np.argmax(found.values[0]))
    assert np.degrees([found.theta_i[k], found.theta_o[k], found.phi[k]]) == pytest.approx([61, 59, 179])


ASTM = (
    "SAMPLE_NAME plate\nWAVELENGTH 650nm\nTHETA_I 30\nNUM_POINTS 3\nVARS theta_s,CCBRDF\n-20,0.0121\n0\t0.05\n30 1.52\n"
)


def test_a_scan_after_astm_has_its_mirror_direction_at_a_positive_angle(tmp_path):
    path = tmp_path / "plate.astm"
    path.write_text(ASTM)
    found = inputs.read(path)
    assert found.format == "ASTM"
    assert found.bands.names == ("650nm",)
    theta_h, _, _ = half_difference(found.theta_i, found.theta_o, found.phi)
    np.testing.assert_allclose(np.degrees(theta_h), [25, 15, 0], atol=1e-9)
    np.testing.assert_allclose(found.values[0], [0.0121, 0.05, 1.52] / np.cos(np.radians([20, 0, 30])))
    path.write_text(ASTM.replace("CCBRDF", "BRDF"))
    np.testing.assert_allclose(inputs.read(path).values[0], [0.0121, 0.05, 1.52])
    path.write_text("VARS theta_i,phi_i,theta_s,phi_s,450nm,0.55um\n30,90,30,270,1,2\n30,90,30,90,3,4\n")
    found = inputs.read(path)
    assert found.bands.wavelengths_um == (0.45, 0.55)
    np.testing.assert_allclose(
        np.degrees(half_difference(found.theta_i, found.theta_o, found.phi)[0]), [0, 30], atol=1e-6
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("VARS", "COLUMNS", "no line begins with VARS"),
        ("THETA_I 30\n", "", "VARS names no theta_i: add the column, or a line such as THETA_I 30 before VARS"),
        ("THETA_I 30", "THETA_I thirty", "THETA_I is 'thirty', not an angle"),
        ("CCBRDF", "reflectance", "column 'reflectance' of VARS is none of theta_i"),
        ("30 1.52", "30", "line 8 has 1 cells, and VARS names 2 columns"),
        ("30 1.52", "95 1.52", "line 8: theta_o_deg 95 is not in (-90, 90)"),
        ("30 1.52", "30 x", "line 8: '30 x' is not a row of numbers"),
    ],
)
def test_an_astm_file_that_cannot_be_read_says_why(tmp_path, old, new, said):
    assert said in refusal(tmp_path / "plate.astm", ASTM.replace(old, new))


def test_a_table_of_a_scan_is_told_how_to_be_read(tmp_path):
    said = refusal(tmp_path / "scan.csv", "theta_i,theta_s,650nm\n30,30,1.5\n")
    assert "a scan in the plane of incidence has phi_deg 180, or the ending .astm" in said
