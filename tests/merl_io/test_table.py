"""Tables of scattered directions: what is read from CSV and NPZ, and what is refused in which words."""

import io
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from merlfit.fitting.commands.checked import row_of_directions
from merlfit.merl_io import inputs
from merlfit.merl_io.bands import Bands
from merlfit.merl_io.binary import MerlError
from merlfit.merl_io.hints import hints
from merlfit.merl_io.outliers import hot
from merlfit.merl_io.scattered import ScatteredMeasurement, half_difference
from merlfit.merl_io.table import ANGLES

HEAD = "theta_i_deg,theta_o_deg,phi_deg,450nm,0.55um,650.5nm"
ROWS = ["0,30,0,1,2,3", "30, 30, 180, 10, 20, 30", "60,10,90,0.5,-1,0.25"]
TEXT = "\n".join(["# a remark", HEAD, *ROWS]) + "\n"


@pytest.fixture
def file(tmp_path):
    target = tmp_path / "made.csv"
    target.write_text(TEXT)
    return target


def archive(path, **changed):
    known = {
        "theta_i_deg": np.array([0.0, 30, 60]), "theta_o_deg": np.array([30.0, 30, 10]),
        "phi_deg": np.array([0.0, 180, 90]), "wavelengths_um": np.array([0.45, 0.55, 0.6505]),
        "values": np.array([[1.0, 2, 3], [10, 20, 30], [0.5, -1, 0.25]]),
    }  # fmt: skip
    np.savez(path, **{name: x for name, x in {**known, **changed}.items() if x is not None})
    return path


def test_csv_and_npz_hold_the_same(file, tmp_path):
    one, other = inputs.read(file), inputs.read(archive(tmp_path / "made.npz"))
    assert one.bands.names == other.bands.names == ("450nm", "550nm", "650.5nm")
    np.testing.assert_allclose(one.bands.wavelengths_um, (0.45, 0.55, 0.6505))
    for name in ("theta_i", "theta_o", "phi", "values", "share"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.values[1, 2] == -1, "a negative number is a datum: noise is on both sides of zero"
    assert one.valid.sum() == 9
    assert one.name == "made"
    assert one.colour_space == "none: a channel is a wavelength"


@pytest.mark.parametrize("cell", ["", " ", "nan", "NaN"])
def test_a_blank_cell_is_no_datum_and_the_others_count(cell, tmp_path):
    target = tmp_path / "gaps.csv"
    target.write_text(TEXT.replace("0.25", cell))
    values = np.array([[1.0, 2, 3], [10, 20, 30], [0.5, -1, np.nan]])
    np.testing.assert_array_equal(inputs.read(target).values, values.T)
    np.testing.assert_array_equal(inputs.read(archive(tmp_path / "gaps.npz", values=values)).values, values.T)


@pytest.mark.parametrize(
    "names", ["sigma_550nm,u_650nm", "550nm_std,650nm uncertainty", "unc(0.55um),SD [650nm]"], ids=lambda names: names
)
def test_uncertainties_stand_beside_their_values(names, tmp_path):
    """Blank and zero are none given, in CSV and NPZ; another quantity divides them, too."""
    target, head = tmp_path / "plate.csv", "theta_i_deg,theta_o_deg,phi_deg,650nm,550nm,"
    target.write_text(f"{head}{names}\n0,30,0,1,2,0.2,0.1\n0,40,0,3,4,,0.3\n0,50,0,5,,0.6,0\n")
    found, expected = inputs.read(target), [[0.1, 0.3, np.nan], [0.2, np.nan, np.nan]]
    assert found.bands.names == ("650nm", "550nm")
    np.testing.assert_array_equal(found.uncertainty, expected)
    assert found.fraction_uncertain == 3 / 5
    assert row_of_directions(found)[3].endswith("with uncertainties")
    factor = inputs.read(target, quantity="reflectance_factor")
    np.testing.assert_allclose(factor.uncertainty, np.array(expected) / np.pi)
    three = np.array([[0.1, 0.2, 0], [0.3, 0, np.nan], [0, 0.2, 0.1]])
    stated = inputs.read(archive(tmp_path / "made.npz", uncertainty=three)).uncertainty
    np.testing.assert_array_equal(stated, np.where(three > 0, three, np.nan).T)
    nothing = inputs.read(archive(tmp_path / "nothing.npz", uncertainty=np.zeros((3, 3))))
    assert nothing.uncertainty is None
    assert "its uncertainties are all blank or 0" in nothing.notes[0]


def test_one_value_needs_no_name_for_its_uncertainty(tmp_path):
    target = tmp_path / "one.csv"
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,633nm,sigma\n0,30,0,1,0.1\n0,40,0,1,0.2\n")
    np.testing.assert_array_equal(inputs.read(target).uncertainty, [[0.1, 0.2]])


def test_rgb_and_weights(tmp_path):
    target = tmp_path / "rgb.csv"
    target.write_text("weight,theta_i_deg,theta_o_deg,phi_deg,R,G,B\n2,0,30,0,1,2,3\n0.5,10,20,0,1,2,3\n")
    found = inputs.read(target)
    assert found.bands.names == ("R", "G", "B")
    np.testing.assert_array_equal(found.share, [2, 0.5])
    assert found.colour_space == "linear RGB, as stored"


def test_colours_in_any_order(tmp_path):
    target = tmp_path / "colours.csv"
    target.write_text("theta_i_deg,B,theta_o_deg,G,phi_deg,R\n10,0.3,20,0.2,30,0.1\n")
    found = inputs.read(target)
    assert found.bands.names == ("R", "G", "B")
    np.testing.assert_array_equal(found.values[:, 0], [0.1, 0.2, 0.3])
    assert np.degrees(found.theta_o[0]) == pytest.approx(20)


def test_what_check_says(file):
    row = row_of_directions(inputs.read(file))
    most = np.degrees(half_difference(*np.radians([[60], [10], [90]]))[0][0])
    assert row[1:4] == ("table", "3", "3: 450nm to 650.5nm")
    assert row[7:9] == (f"0.0 {most:.1f}", "30")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT.replace("10, 20", "10"), "line 4 has 5 cells, and there are 6 columns"),
        (TEXT[:-9], "line 5 has 4 cells, and there are 6 columns"),
        (TEXT.replace("0.25", "inf"), "line 5: 650.5nm is 'inf', not a finite number"),
        (TEXT.replace("30, 30,", "30, ,"), "line 4: theta_o_deg is '', not a finite number"),
        (
            TEXT.replace("0.25", "much"),
            "'much', not a finite number; leave the cell of a missing value blank",
        ),
        (TEXT.replace(",", "|"), "with commas between"),
        (TEXT.replace("10, 20", "10").replace("0.25", "x"), "line 4 has 5 cells, and there are 6 columns; line 5: "),
        (TEXT.replace("450nm", "blue").replace("phi_deg", "turn"), "no column phi_deg;"),
        (TEXT.replace("phi_deg", "turn"), "(found: theta_i_deg, theta_o_deg, turn, 450nm, 0.55um, 650.5nm)"),
        (HEAD + ",\n", "column 7 has no name"),
        ("theta_i_deg,theta_o_deg,phi_deg,R,B\n0,10,0,1,1\n", "has no column G: R, G and B stand together"),
        ("theta_i_deg,theta_o_deg,phi_deg,500nm\n0,10,0,1e200\n", "holds no datum"),
        (TEXT.replace("theta_o_deg", "theta_x"), "names no column theta_o_deg"),
        (TEXT.replace("450nm", "blue"), "column 'blue' is none of"),
        (TEXT.replace("450nm", "550nm"), "wavelength 550nm is there twice"),
        (TEXT.replace("450nm", "450um"), "wavelength 450 um is not between 0.001 and 100"),
        (TEXT.replace("450nm", "theta_i_deg"), "column 'theta_i_deg' is there twice"),
        (TEXT.replace("30, 30,", "30, 95,"), "line 4: theta_o_deg 95 is not in"),
        (TEXT.replace("60,10", "-90,10"), "line 5: theta_i_deg -90 is not in"),
        ("theta_i_deg,theta_o_deg,phi_deg,weight,500nm\n0,10,0,-1,1\n", "line 2: weight -1 is negative"),
        ("theta_i_deg,theta_o_deg,phi_deg,500nm\n0,10,0,nan\n", "holds no datum"),
        (
            "theta_i_deg,theta_o_deg,phi_deg,500nm,sigma\n0,10,0,1,-1\n",
            "line 2: the uncertainty of 500nm, -1, is negative; leave it blank where none is known",
        ),
        (TEXT.replace("650.5nm", "sigma_550nm").replace("0.25", "x"), "sigma_550nm is 'x', not a finite number; leave"),
        (TEXT.replace("650.5nm", "sigma"), "column 'sigma' does not say of which value: name it such as sigma_450nm"),
        (TEXT.replace("650.5nm", "u_R"), "column 'u_R' is an uncertainty of R, and there are no values of that"),
        (
            "theta_i_deg,theta_o_deg,phi_deg,500nm,sigma,500nm_std\n0,10,0,1,1,1\n",
            "one value has two columns of uncertainties",
        ),
        ("theta_i_deg,theta_o_deg,phi_deg\n0,10,0\n", "has no column of values"),
        (HEAD + "\n", "it has no lines of numbers"),
        ("", "it has no line of names"),
        (b"\xff\xfe\x00", "it is no UTF-8 text"),
    ],
)
def test_a_bad_table_gets_one_line_that_names_it(text, words, tmp_path):
    target = tmp_path / "bad.csv"
    target.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(MerlError) as error:
        inputs.read(target)
    assert words in str(error.value)
    assert str(target) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"values": None}, "has no array values"),
        ({"values": np.ones((2, 3))}, "array values has shape (2, 3), not (3, 3)"),
        ({"values": np.full((3, 3), np.nan)}, "holds no datum"),
        ({"values": np.full((3, 3), np.inf)}, "array values is not a finite number at (0, 0)"),
        ({"phi_deg": np.array([0.0, np.nan, 9])}, "array phi_deg is not a finite number at (1,)"),
        ({"phi_deg": np.array([0.0, "x", None], object)}, "not a readable NPZ archive"),
        ({"values": np.ones((3, 3), complex)}, "array values holds no real numbers"),
        ({"wavelengths_um": np.array([0.5, 0.5, 0.6])}, "wavelength 500nm is there twice"),
        ({"weight": np.array([1.0, 2.0])}, "array weight has shape (2,), not (3,)"),
        ({"uncertainty": np.ones(3)}, "array uncertainty has shape (3,), not (3, 3)"),
        ({"uncertainty": -np.ones((3, 3))}, "sample 1: the uncertainty of 450nm, -1, is negative"),
        ({"theta_i_deg": np.array([0.0, 90, 3])}, "sample 2: theta_i_deg 90 is not in (-90, 90)"),
    ],
)
def test_a_bad_archive_gets_one_line_that_names_it(changed, words, tmp_path):
    target = archive(tmp_path / "bad.npz", **changed)
    with pytest.raises(MerlError) as error:
        inputs.read(target)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"theta_in": [1.0]}, "gold.npz: no array of a table is called theta_in: theta_i_deg, theta_o_deg, phi_deg, "),
        ({"phi_deg": "east"}, "gold.npz: holds what is no number"),
        ({"phi_deg": [10**400, 0, 0]}, "gold.npz: holds what is no number"),
        ({"values": np.ones((3, 3), complex)}, "gold.npz: array values holds complex numbers"),
        ({"phi_deg": [180.0]}, r"gold.npz: array phi_deg has shape \(1,\), not "),
    ],
)
def test_arrays_that_are_no_table_get_one_line_that_names_them(changed, words, tmp_path):
    with np.load(archive(tmp_path / "made.npz")) as made:
        arrays = dict(made)
    found = inputs.read(arrays, name="gold")
    np.testing.assert_array_equal(found.values, inputs.read(tmp_path / "made.npz").values)
    assert found.name == "gold"
    bright = np.where(arrays["values"] > 0, arrays["values"], 1e20)
    assert np.isnan(inputs.read({**arrays, "values": bright}).values).sum() == 1
    assert bright.max() == 1e20, "arrays are the caller's"
    masked = np.ma.masked_less(arrays["values"], 0)
    np.testing.assert_array_equal(np.isnan(inputs.read({**arrays, "values": masked}).values), masked.mask.T)
    with pytest.raises(MerlError, match=words):
        inputs.read({**arrays, **changed}, name="gold")


def test_a_truncated_archive_gets_one_line(tmp_path):
    target = archive(tmp_path / "cut.npz")
    target.write_bytes(target.read_bytes()[:-30])
    with pytest.raises(MerlError, match=r"cut\.npz: is not a readable NPZ archive"):
        inputs.read(target)


def test_an_array_that_says_to_be_larger_than_it_is_takes_no_memory(tmp_path):
    target, header = archive(tmp_path / "large.npz", values=None), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 3)})
    with zipfile.ZipFile(target, "a") as file:
        file.writestr("values.npy", header.getvalue())
    tracemalloc.start()
    with pytest.raises(MerlError, match="array values says to be larger than it is"):
        inputs.read(target)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def test_memory_is_three_times_that_of_the_file(tmp_path):
    target = tmp_path / "large.csv"
    rows = np.random.default_rng(0).random((3000, 34))
    head = ",".join(["theta_i_deg", "theta_o_deg", "phi_deg", *(f"{400 + k}nm" for k in range(31))])
    target.write_text("\n".join([head, *(",".join(f"{x:.8f}" for x in row) for row in rows)]))
    tracemalloc.start()
    found = inputs.read(target)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * target.stat().st_size + 2**20
    np.testing.assert_allclose(found.values, rows[:, 3:].T, atol=1e-8)


def test_missing_folder_or_another_file(file, tmp_path):
    for path, words in ((tmp_path / "none.csv", "no such file"), (tmp_path / "folder.npz", "is a directory")):
        (tmp_path / "folder.npz").mkdir(exist_ok=True)
        with pytest.raises(MerlError, match=words):
            inputs.read(path)
    with pytest.raises(MerlError, match="is not the name of a file"):
        inputs.read(tmp_path / "a\0b.csv")
    assert inputs.read(file, inputs.read(file).sha1).name == "made"
    with pytest.raises(MerlError, match="is not the file that was fitted"):
        inputs.read(file, "0" * 40)


ALIKE = {
    "semicolons, decimal commas": "AOI;theta_s [deg];Azimuth;405\n30;-45,5;0;1,5\n10;20;30;2\n",
    "tabs": "theta_i\ttheta_r\tphi\t405nm\n30\t-45.5\t0\t1.5\n10\t20\t30\t2\n",
    "blanks": "thetai  theta_out  dphi  0.405um\n 30   45.5   180  1.5\n10 20 30 2\n",
    "names behind #": "# made today\n# theta_i_deg,theta_o_deg,phi_deg,405nm\n30,45.5,180,1.5\n10,20,30,2\n",
    "radians": "theta_i_rad,theta_o[rad],phi (rad),405nm\n0.5235987755982988,0.7941248096574199,3.141592653589793,1.5\n"
               "0.17453292519943295,0.3490658503988659,0.5235987755982988,2\n",
}  # fmt: skip


@pytest.mark.parametrize("text", ALIKE.values(), ids=ALIKE)
def test_tables_as_other_programs_write_them(text, tmp_path):
    target = tmp_path / "other.csv"
    target.write_text(text)
    found = inputs.read(target)
    np.testing.assert_allclose(np.degrees([found.theta_i, found.theta_o, found.phi]), [[30, 10], [45.5, 20], [180, 30]])
    np.testing.assert_array_equal(found.values, [[1.5, 2]])
    assert found.bands.names == ("405nm",)


def test_names_behind_a_sharp_sign_and_wavelengths_far_from_the_visible(cases):
    assert inputs.read(cases / "11" / "savetxt.csv").values.tolist() == [[2.4, 0.3]]
    assert inputs.read(cases / "13" / "euv.csv").bands.wavelengths_um == (0.0135,)
    assert inputs.read(cases / "13" / "co2.csv").bands.wavelengths_um == (10.6,)


def test_many_columns_take_no_time_and_a_message_stays_short(tmp_path):
    """60,000 names took 90 s; what is said of them is a line that can be read."""
    target = tmp_path / "wide.csv"
    names = [f"{400 + k / 1000:g}nm" for k in range(60_000)]
    target.write_text(",".join(["theta_i_deg", "theta_o_deg", *names]) + "\n")
    with pytest.raises(MerlError, match="no column phi_deg") as error:
        inputs.read(target)
    assert len(str(error.value)) < 1001
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,500nm\n" + "0,95,0,x\n" * 5000)
    with pytest.raises(MerlError, match="and 4988 more") as error:
        inputs.read(target)
    assert len(str(error.value)) < 1001


def test_a_hot_sample_is_named_and_left_out(cases):
    plain = inputs.read(cases / "09" / "plain.csv")
    assert plain.notes == ()
    for name in ("spike10.csv", "spike.csv"):
        found = inputs.read(cases / "09" / name)
        (said,) = found.notes
        assert said.startswith("line 313 (550nm ")
        assert np.flatnonzero(~found.valid[0]).tolist() == [311]
        np.testing.assert_array_equal(found.values[found.valid], plain.values[found.valid])


def scan(theta_i, step, values, phi=180.0):
    """A scattered measurement of one channel in the plane of incidence."""
    theta_o = np.concatenate([np.arange(0.0, 80.0, step) for _ in theta_i])
    each = np.repeat(theta_i, len(np.arange(0.0, 80.0, step)))
    return scattered_of(
        np.radians(each), np.radians(theta_o), np.full(len(each), np.radians(phi)), values(each, theta_o)
    )


def scattered_of(theta_i, theta_o, phi, *channels):
    values = np.stack(channels)
    names = tuple(f"{550 + k}nm" for k in range(len(channels)))
    bands = Bands(names, tuple(0.55 + 0.001 * k for k in range(len(channels))))
    share = np.full(len(phi), 1.0 / len(phi))
    return ScatteredMeasurement(Path("x.csv"), "table", theta_i, theta_o, phi, values, share, bands, "", "")


def test_a_highlight_beside_where_it_should_be_is_no_outlier():
    """A goniometer half a degree off, whose steps are finer than a mirror's lobe."""
    lobe = lambda i, o: 0.02 + 200 * np.exp(-(((o - i - 0.5) / 0.1) ** 2))  # noqa: E731
    assert not hot(scan([20.0, 40.0, 60.0], 0.25, lobe)).any()


def test_what_was_not_measured_is_nobodys_neighbour():
    """Two wavelengths, each blank where the other was measured."""
    coarse, fine = np.arange(0.0, 80.0, 10.0), np.arange(0.5, 80.0, 1.0)
    theta_o = np.radians(np.concatenate([coarse, fine]))
    of_coarse = np.arange(len(theta_o)) < len(coarse)
    one, other = np.where(of_coarse, 0.1, np.nan), np.where(of_coarse, np.nan, 0.1)
    found = scattered_of(np.full(len(theta_o), 0.5), theta_o, np.full(len(theta_o), np.pi), one, other)
    assert not hot(found).any()


def test_counts_of_few_photons_are_no_outliers_and_a_hot_negative_value_is_one():
    rng = np.random.default_rng(0)
    theta = np.radians(rng.uniform(5, 75, (2, 2000)))
    phi, counts = rng.uniform(0, np.pi, 2000), rng.poisson(0.1, 2000).astype(float)
    assert not hot(scattered_of(*theta, phi, counts)).any()
    even = np.full(2000, 0.1)
    even[7] = -100.0
    assert np.flatnonzero(hot(scattered_of(*theta, phi, even))).tolist() == [7]


def test_a_highlight_of_one_sample_is_no_outlier(tmp_path):
    """In one plane the mirror's direction is measured once: nothing beside it is as bright, and it counts."""
    target = tmp_path / "scan.csv"
    rows = [f"30,{t},{180 if t >= 0 else 0},{1e4 if t == 30 else 0.1}" for t in range(0, 80, 5)]
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,500nm\n" + "\n".join(rows))
    assert inputs.read(target).valid.all()


def test_an_empty_channel_is_told_and_left_out(cases):
    found, alone = (inputs.read(cases / "08" / name) for name in ("rzero.csv", "ronly.csv"))
    assert found.bands == alone.bands
    np.testing.assert_array_equal(found.values, alone.values)
    assert found.notes == ("channels 526nm, 444nm are zero everywhere or blank, and left out",)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("radians.csv", "no angle exceeds 3.142: they look like radians"),
        ("tile_refl.csv", "it reflects 3 times the light that arrives"),
        ("cosine.csv", "the values look like a BRDF times cos theta_o"),
    ],
)
def test_what_the_numbers_look_like(cases, name, said):
    (line,) = inputs.remarks(inputs.read(cases / "14" / name))
    assert said in line


def test_a_brdf_in_its_unit_gets_no_hint(cases):
    for name in ("14/tile_brdf.csv", "09/plain.csv", "03/dark.csv", "01/tile.csv"):
        assert inputs.remarks(inputs.read(cases / name)) == []


def test_genuine_measurements_get_no_hint(cases):
    measured = cases.parent / "data" / "measured"
    rgl = [measured / "rgl" / f"{name}_rgb.bsdf" for name in ("cc_green_malachite", "irid_flake_paint1")]
    for file in (measured / "nist" / "ptfe_regular.csv", *rgl):
        assert inputs.remarks(inputs.read(file)) == [], file


def test_a_plane_says_nothing_of_the_hemisphere():
    """A metal's highlight, scanned through both sides of the plane of incidence."""
    theta_o = np.radians(np.arange(-80.0, 81.0, 2.0))
    phi = np.where(theta_o < 0, 0.0, np.pi)
    value = 0.02 + 12 * np.exp(-(((theta_o - np.radians(30)) / 0.2) ** 2))
    made = scattered_of(np.full(len(phi), np.radians(30)), np.abs(theta_o), phi, value)
    assert hints(made) == []


def test_radians_of_signed_angles_are_told(tmp_path):
    target = tmp_path / "signed.csv"
    rows = [f"0.5,{o:.3f},0,0.1" for o in np.linspace(-1.4, 1.4, 29)]
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,500nm\n" + "\n".join(rows))
    assert any("they look like radians" in line for line in inputs.remarks(inputs.read(target)))


def test_the_brightest_sample_on_the_lights_side_is_told(tmp_path):
    """Either azimuth 0 is the mirror's side in the file, or the material is a retro-reflector."""
    target = tmp_path / "turned.csv"
    rows = [f"{i},{o},{phi},{1e2 if (i == o and phi == 0) else 0.1}"
            for i in (30, 45, 60) for o in (15, 30, 45, 60) for phi in (0, 90, 180)]  # fmt: skip
    target.write_text("theta_i_deg,theta_o_deg,phi_deg,500nm\n" + "\n".join(rows))
    measured = inputs.read(target)
    assert row_of_directions(measured)[-1] == "30.0 30.0 0.0"
    assert any("on the light's own side, at azimuth 0" in line for line in inputs.remarks(measured))


@pytest.mark.parametrize("name", ["pipe.csv", "pipe.npz", "pipe.bsdf", "pipe.binary"])
def test_a_pipe_is_refused_at_once(name, tmp_path):
    os.mkfifo(tmp_path / name)
    with pytest.raises(MerlError, match=f"{name}: is not a regular file"):
        inputs.read(tmp_path / name)


def test_an_archive_that_unpacks_to_more_than_its_length_may_hold_takes_no_memory(tmp_path):
    """200 MiB of zeros are packed into 200 KiB."""
    path = tmp_path / "x.npz"
    np.savez_compressed(path, **{name: np.zeros(1) for name in ANGLES}, values=np.zeros((25 * 2**20, 1), np.uint8))
    with pytest.raises(MerlError, match=r"x\.npz: is not a readable NPZ .*would take 200 MiB"):
        inputs.read(path)
