"""MERL files: what is stored where, what is masked, and what is refused in which words."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from merlfit.merl_io import binary, grid, inputs, source
from merlfit.merl_io.binary import DIMS, HEADER, SCALES, MerlError, dims_of, file_bytes, read, write
from merlfit.merl_io.samples import fold, runs_for, thin


@pytest.fixture(scope="module")
def values():
    return np.random.default_rng(0).uniform(0.1, 5.0, (3, *DIMS))


@pytest.fixture(scope="module")
def path(values, tmp_path_factory):
    target = tmp_path_factory.mktemp("merl") / "sample.binary"
    write(target, values)
    return target


def test_numbers_stand_where_matusik_puts_them(path, values):
    raw = path.read_bytes()
    assert len(raw) == file_bytes(DIMS) == 34992012
    assert struct.unpack_from("<3i", raw) == DIMS
    for channel, scale in enumerate((1 / 1500, 1.15 / 1500, 1.66 / 1500)):
        for h, d, p in ((0, 0, 0), (3, 80, 179), (89, 1, 7)):
            index = p + 180 * (d + 90 * (h + 90 * channel))
            (number,) = struct.unpack_from("<d", raw, 12 + 8 * index)
            assert number * scale == pytest.approx(values[channel, h, d, p], rel=1e-15)
            (interleaved,) = struct.unpack_from("<d", raw, 12 + 8 * (3 * (p + 180 * (d + 90 * h)) + channel))
            assert (h, d, p, channel) == (0, 0, 0, 0) or interleaved * scale != values[channel, h, d, p]


def test_round_trip_to_one_unit_in_the_last_place(path, values):
    back = read(path)
    assert back.valid.all()
    assert back.name == "sample"
    np.testing.assert_array_max_ulp(back.values, values, 2)


def test_invalid_numbers_become_a_mask_and_never_zero(tmp_path, values):
    target = tmp_path / "bad.binary"
    write(target, values)
    stored = np.memmap(target, "<f8", "r+", 12, (3, *DIMS))
    stored[0, 1, 2, 3], stored[1, 4, 5, 6], stored[2, 7, 8, 9], stored[0, 0, 0, 0] = -2.0, np.nan, np.inf, 0.0
    stored[0, 3, 2, 1], stored[0, 3, 2, 2] = 1.6e18, 1.4e18  # 1.07e15/sr is no measurement, 0.93e15/sr might be
    stored.flush()
    found = read(target)
    assert (found.negative, found.nan, found.inf) == (1, 1, 2)
    assert (~found.valid).sum() == 4
    assert np.isnan(found.values[:, ~found.valid]).all()
    assert found.values[0, 0, 0, 0] == 0
    assert found.valid[0, 0, 0]
    assert found.valid[3, 2, 2]
    assert found.valid.mean() == pytest.approx(1 - 4 / np.prod(DIMS))
    assert found.genuine is None


def test_outliers_are_what_is_far_brighter_than_its_row(tmp_path):
    steep = 1e-3 * np.geomspace(1e9, 1, 90)[:, None, None] * np.ones(DIMS)  # a sharp lobe has none
    values = np.broadcast_to(steep, (3, *DIMS)).copy()
    values[:, 50, 50, ::3] = np.nan
    assert measured(values, tmp_path).outliers == 0
    values[1, 2, 10, 90] *= 1e5
    values[:, 80, 10, [3, 4]] = 1e7
    values[0, 80, 20, 7] *= 1e2  # bright beside its row, but not beside the whole
    assert measured(values, tmp_path).outliers == 3


def measured(values, tmp_path):
    write(tmp_path / "made.binary", values)
    return read(tmp_path / "made.binary")


def broken(name, tmp_path, path):
    target = tmp_path / f"{name}.binary"
    raw = path.read_bytes()
    match name:
        case "missing":
            pass
        case "directory":
            target.mkdir()
        case "empty":
            target.write_bytes(b"")
        case "truncated":
            target.write_bytes(raw[:-8])
        case "too long":
            target.write_bytes(raw + b"\0")
        case "dims":
            target.write_bytes(struct.pack("<3i", 90, 90, 360) + raw[12:])
        case "big-endian":
            target.write_bytes(struct.pack(">3i", 90, 90, 180) + raw[12:])
        case "picture":
            target.write_bytes(b"\x89PNG\r\n\x1a\n" + raw[8:1000])
        case "text":
            target.write_bytes(b"theta_h theta_d\n" * 10)
        case "short text":
            target.write_bytes(b"hello\n")
        case "all invalid":
            target.write_bytes(raw[:12] + np.full(3 * np.prod(DIMS), -1.0).tobytes())
    return target


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing", "no such file"), ("directory", "is a directory"), ("empty", "truncated"),
        ("truncated", "truncated"),
        ("too long", "too long"), ("dims", "90x90x360"), ("big-endian", "big-endian"), ("picture", "PNG picture"),
        ("text", "not a MERL"), ("short text", "not a MERL .binary file: it has 6 bytes"),
        ("all invalid", "no valid bin"),
    ],
)  # fmt: skip
def test_bad_files_get_one_line_that_names_them(name, words, tmp_path, path):
    target = broken(name, tmp_path, path)
    with pytest.raises(MerlError) as error:
        read(target)
    assert words in str(error.value)
    assert str(target) in str(error.value)
    assert "\n" not in str(error.value)


def test_no_permission_is_said(path, monkeypatch):
    def refuse(*args, **kwargs):
        raise PermissionError

    monkeypatch.setattr(source, "open", refuse, raising=False)
    with pytest.raises(MerlError, match="no permission"):
        read(path)


@given(header=st.binary(min_size=12, max_size=12))
@settings(derandomize=True, max_examples=100, deadline=None, database=None)
def test_no_other_header_is_accepted(header):
    if struct.unpack("<3i", header) != DIMS:
        with pytest.raises(MerlError):
            binary._dims_in(Path("x"), header, file_bytes(DIMS), (DIMS,))


# --- other numbers of bins

OTHER = (45, 45, 90)


@pytest.fixture(scope="module")
def coarser(tmp_path_factory):
    target = tmp_path_factory.mktemp("merl") / "coarser.binary"
    write(target, np.random.default_rng(3).uniform(0.1, 5.0, (3, *OTHER)), dims=OTHER)
    return target


def test_other_dims_are_read_only_where_they_are_allowed(coarser, path):
    with pytest.raises(MerlError, match=r"coarser\.binary: its dimensions are 45x45x90.*--dims 45x45x90 allows them"):
        read(coarser)
    with pytest.raises(MerlError, match="its dimensions are 45x45x90, those of MERL"):
        read(coarser, dims=(30, 30, 60))
    found = read(coarser, dims=OTHER)
    assert found.dims == OTHER
    assert found.values.shape == (3, *OTHER)
    assert read(path, dims=OTHER).dims == DIMS, "MERL's own are always allowed"


def test_a_damaged_file_of_other_dims_gets_one_line(coarser, tmp_path):
    for content, words in ((coarser.read_bytes()[:-8], "truncated"), (coarser.read_bytes() + b"1", "too long")):
        target = tmp_path / "damaged.binary"
        target.write_bytes(content)
        with pytest.raises(MerlError, match=rf"damaged\.binary: {words}"):
            read(target, dims=OTHER)


def test_dims_are_three_numbers():
    assert dims_of("45x30x90") == (45, 30, 90)
    for text in ("45x45", "45x45x91", "5x45x90", "45x45x9000", "axbxc", "45X45x90", "-45x45x90", ""):
        with pytest.raises(ValueError, match="should be three numbers of bins like 45x45x90"):
            dims_of(text)


def test_dims_that_cannot_be_folded_are_refused(tmp_path):
    """Before the file is looked at, which may have them."""
    write(tmp_path / "odd.binary", np.ones((3, 6, 6, 7)), dims=(6, 6, 7))
    with pytest.raises(MerlError, match=r"odd\.binary: dims 6x6x7 are not read: .* phi_d even"):
        read(tmp_path / "odd.binary", dims=(6, 6, 7))


def test_a_mask_of_another_shape_is_refused(tmp_path):
    for shape in (OTHER, (3, *OTHER[:2], 1), ()):
        with pytest.raises(MerlError, match=r"x\.binary: which bins are valid has the shape \(6, 6, 8\), not"):
            write(tmp_path / "x.binary", np.ones((3, 6, 6, 8)), np.ones(shape, bool), dims=(6, 6, 8))
    assert list(tmp_path.iterdir()) == []


def test_weights_of_other_bins_add_up_to_the_same_measure():
    for dims in (OTHER, (30, 60, 120)):
        assert grid.merl_grid(dims).weight.sum() == pytest.approx(np.pi, rel=1e-3)
    fine, coarse = grid.merl_grid(), grid.merl_grid(OTHER)
    np.testing.assert_allclose(coarse.edges[0], fine.edges[0][::2])
    inside = coarse.weight[:20, :20, 10:30]
    parts = fine.weight[:40, :40, 20:60].reshape(20, 2, 20, 2, 20, 2).sum((1, 3, 5))
    np.testing.assert_allclose(inside, parts, rtol=2e-2)


@pytest.mark.parametrize("dims", [OTHER, (180, 90, 180), (7, 6, 6), (30, 120, 360)])
def test_runs_fill_other_grids_too(dims):
    g = grid.merl_grid(dims)
    ones = np.ones((1, *dims))
    samples = fold(g, ones, ones)
    for runs in (((*(1,) * 6, 3, 3, *(6,) * 13), 5, 1), (1, 10, 1), (1, 1, 1)):
        found = runs_for(samples, runs)
        thinned = thin(samples, found)
        assert thinned.weight.sum() == pytest.approx(samples.weight.sum())
        if not isinstance(runs[0], int):
            assert len(thinned.theta_h) <= len(runs[0]) + 6
            np.testing.assert_array_equal(thinned.theta_h[:6], g.theta_h[:6])
    merl = fold(grid.merl_grid(), np.ones((1, *DIMS)), np.ones((1, *DIMS)))
    assert runs_for(merl, (5, 5, 10)) == (5, 5, 10)


def test_write_is_atomic(tmp_path, values, monkeypatch):
    target = tmp_path / "kept.binary"
    target.write_bytes(b"old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(binary.os, "replace", fail)
    with pytest.raises(MerlError, match="No space left"):
        write(target, values)
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["kept.binary"]


def test_the_hundred_genuine_files_are_known():
    names = binary.genuine_names()
    assert len(names) == 100
    assert "nickel" in names.values()
    assert all(len(key) == 40 for key in names)


# --- the grid


def test_angles_against_explicit_vectors():
    g = grid.merl_grid()
    rng = np.random.default_rng(0)
    for h, d, p in rng.integers(0, (90, 90, 180), (50, 3)):
        th, td, pd = g.theta_h[h], g.theta_d[d], g.phi_d[p]
        half = np.array([np.sin(th), 0, np.cos(th)])
        diff = np.array([np.sin(td) * np.cos(pd), np.sin(td) * np.sin(pd), np.cos(td)])
        light = np.array(
            [np.cos(th) * diff[0] + np.sin(th) * diff[2], diff[1], np.cos(th) * diff[2] - np.sin(th) * diff[0]]
        )
        viewer = 2 * (light @ half) * half - light
        assert g.cos_i[h, d, p] == pytest.approx(light[2], abs=1e-14)
        assert g.cos_o[h, d, p] == pytest.approx(viewer[2], abs=1e-14)


def test_weights_add_up_to_the_measure_of_the_hemispheres():
    g = grid.merl_grid()
    # Int domega_o Int cos_i dtheta_i = 2 pi over both halves of phi_d
    assert g.weight.sum() == pytest.approx(np.pi, rel=2e-4)
    without_cos_d = g.weight / np.maximum(np.cos(g.theta_d)[None, :, None], 1e-9)
    assert without_cos_d.sum() != pytest.approx(np.pi, rel=1e-2)


# of the weights: degrees of theta_i from, to; median and largest error
STATED = [(1, 5, 1e-8, 0.02), (5, 20, 1e-4, 0.0125), (20, 60, 4e-4, 0.01), (60, 85, 4e-4, 0.03)]


def subcells(g, bins, count):
    """Weights of bins cut into count^3, with four nodes an axis in each."""
    cells, found = np.array(list(np.ndindex(count, count, count))), []
    for each in bins:
        edges = tuple(np.linspace(e[k], e[k + 1], count + 1) for e, k in zip(g.edges, each, strict=True))
        found.append(grid._integrate(edges, cells, 4).sum())
    return np.array(found)


def test_weights_of_single_bins_against_many_subcells():
    """As `merl_grid` says; the worst bins are named, so that no seed decides whether they are looked at."""
    g = grid.merl_grid()
    theta_i = np.degrees(np.arccos(np.clip(g.cos_i, -1, 1)))
    inside = (np.minimum(g.cos_i, g.cos_o) > 0.1) & (g.weight > 0)
    for low, high, median, largest in STATED:
        bins = np.argwhere(inside & (theta_i >= low) & (theta_i < high))[::97]
        error = np.abs(g.weight[tuple(bins.T)] / grid._integrate(g.edges, bins, 8) - 1)
        assert np.median(error) < median, low
        assert error.max() < largest, low
    near = np.argwhere(inside & (theta_i < 1))[::12]
    assert 0.1 < np.mean(np.abs(g.weight[tuple(near.T)] / subcells(g, near, 4) - 1) > 1e-2) < 0.2
    worst = np.array([[4, 0, 177], [4, 0, 178], [4, 0, 179]])
    error = g.weight[tuple(worst.T)] / subcells(g, worst, 8) - 1
    assert np.all((error > 0.4) & (error < 1.1))
    centre = grid.bin_volume(g.edges) * np.maximum(g.cos_i, 0) / np.sqrt(np.maximum(1 - g.cos_i**2, 1e-24))
    near = np.argwhere(g.cos_i > np.cos(0.03))[:200]
    assert np.max(np.abs(centre[tuple(near.T)] / grid._integrate(g.edges, near, 16) - 1)) > 0.05


def test_folding_keeps_the_sum_of_squares():
    g = grid.merl_grid()
    rng = np.random.default_rng(2)
    value, weight = rng.uniform(0, 1, (2, 3, *DIMS))
    weight[rng.uniform(size=weight.shape) < 0.3] = 0
    folded = fold(g, value, weight)
    prediction = rng.uniform(0, 1, folded.value.shape)
    whole = np.concatenate([prediction, prediction[..., ::-1]], -1)
    expected = np.sum(weight * (value - whole) ** 2)
    found = np.sum(folded.weight * (folded.value - prediction) ** 2) + folded.scatter
    assert found == pytest.approx(expected, rel=1e-12)
    assert found - folded.scatter != pytest.approx(expected, rel=1e-2)
    np.testing.assert_allclose(g.cos_i[..., :90], g.cos_o[..., :89:-1], atol=1e-14)


def test_thinning_keeps_middle_rows_which_stand_for_their_runs():
    g = grid.merl_grid()
    ones = np.ones((3, *DIMS))
    folded = fold(g, ones, ones)
    assert thin(folded, (5, 5, 10)).value.shape == (3, 18, 18, 9)
    runs = (1, 1, 3, *(5,) * 17)
    thinned = thin(folded, (runs, 90, 45))
    np.testing.assert_array_equal(thinned.theta_h, g.theta_h[[0, 1, 3, *range(7, 90, 5)]])
    np.testing.assert_array_equal(thinned.cos_o[4, 0], folded.cos_o[12, 45, [22, 67]])
    np.testing.assert_allclose(thinned.weight[:, :, 0, 0], 2 * 90 * 45 * np.broadcast_to(runs, (3, 20)))
    with pytest.raises(ValueError, match="must fill"):
        thin(folded, (7, 5, 10))
    with pytest.raises(ValueError, match="must fill"):
        thin(folded, ((30, 30, 31), 5, 10))


@pytest.fixture
def ones(tmp_path):
    """A file to spoil."""
    target = tmp_path / "ones.binary"
    write(target, np.ones((3, *DIMS)))
    return target


def test_signalling_nans_are_counted_without_a_warning(ones):
    stored = np.memmap(ones, "<u8", "r+", HEADER.size, (3, *DIMS))
    stored[1, 2, 3, 4] = 0x7FF0000000000001
    stored.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(ones).nan == 1


def test_a_file_without_a_valid_bin_says_which_channels_are_bad(ones):
    stored = np.memmap(ones, "<f8", "r+", HEADER.size, (3, *DIMS))
    stored[0] = -1
    stored[2, :9] = np.nan
    stored.flush()
    with pytest.raises(MerlError, match=r"no valid bin.*\(red 100%, green 0%, blue 10% of the bins\)"):
        read(ones)


def test_what_cannot_be_written_is_named(tmp_path):
    target = tmp_path / "missing" / "x.binary"
    with pytest.raises(MerlError, match=r"x\.binary: cannot be written"):
        write(target, np.ones((3, *DIMS)))


def test_a_name_as_long_as_a_name_may_be_can_be_written(tmp_path):
    target = Path(tmp_path / ("x" * 248 + ".binary"))
    write(target, np.ones((3, *DIMS)))
    assert read(target).valid.all()


def test_channels_of_zeros_are_told_and_left_out(tmp_path):
    """One channel filled: the others are no black material's, and would spoil what all channels share."""
    dims = (6, 6, 12)
    values = np.zeros((3, *dims))
    values[0] = 0.2
    write(tmp_path / "red.binary", values, dims=dims)
    found = read(tmp_path / "red.binary", dims=dims)
    assert found.bands.names == ("R",)
    assert found.bands.wavelengths_um == (0.645,)
    assert found.notes == ("channels G, B are zero everywhere or blank, and left out",)
    np.testing.assert_allclose(found.values, values[:1])


def test_an_unscaled_file_is_told(tmp_path):
    """Its numbers are a BRDF, not divided by MERL's scale: it is read 1500 times too dark."""
    dims = (6, 6, 12)
    values = np.full((3, *dims), 0.3)
    write(tmp_path / "scaled.binary", values, dims=dims)
    write(tmp_path / "unscaled.binary", values * SCALES[:, None, None, None], dims=dims)
    assert inputs.remarks(read(tmp_path / "scaled.binary", dims=dims)) == []
    (said,) = inputs.remarks(read(tmp_path / "unscaled.binary", dims=dims))
    assert "were not divided by MERL's scale" in said
