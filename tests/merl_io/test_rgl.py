"""RGL's files: samples as Mitsuba's own plugin and a slow oracle evaluate the same file, and what is refused.

Synthetic ones of a known material, and RGL's own, genuine measurements.
"""

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from merlfit.merl_io import inputs, rgl
from merlfit.merl_io.binary import MerlError
from merlfit.merl_io.scattered import half_difference
from merlfit.merl_io.tensor import tensors

from tests.oracles import rgl as oracle
from tests.support import rgl_files

NM = np.array([360.0, 450, 550, 660.5, 1000])
CASES = {
    "rgb": {"nm": None}, "spectral": {"nm": NM}, "two azimuths of light": {"nm": NM, "phi_i": (0.0, 2.0)},
    "without the factor of normals": {"nm": NM, "jacobian": 0},
}  # fmt: skip
# Mitsuba 3.9.1 does not set `m_reduction` of isotropic files: whether it turns light and viewer by 180 degrees is
# chance, which matters with two azimuths of light
DETERMINED = [name for name, case in CASES.items() if "phi_i" not in case]
INCIDENCES = (0, 10, 30, 55, 75, 90)


def brdf(theta_i, theta_o, phi, channels=5):
    """A made-up one with a highlight, reciprocal, of channels that differ."""
    theta_h, theta_d, _ = half_difference(theta_i, theta_o, phi)
    width = 0.2 + 0.05 * np.arange(channels)[:, None]
    return 0.05 + np.exp(-((np.tan(theta_h) / width) ** 2)) * (1 + theta_d) / width


def fields_of(nm=None, phi_i=(0.0,), jacobian=1, nodes=10):
    where = rgl_files.parameterization(0.35, INCIDENCES, resolution=24, nodes=nodes)
    count = len(phi_i)
    where |= {name: np.repeat(where[name], count, 0) for name in ("vndf", "luminance")}
    where["vndf"] = where["vndf"] * np.linspace(1, 2, 24 * count, dtype=np.float32).reshape(count, 1, 24, 1)
    where |= {"phi_i": np.float32(phi_i), "jacobian": np.array([jacobian], np.uint8)}
    return rgl_files.made(where, lambda *x: brdf(*x, 3 if nm is None else len(nm)), nm)


@pytest.fixture(scope="module", params=CASES, ids=str)
def made(request, tmp_path_factory):
    """Name of the case, fields, and the file."""
    fields = fields_of(**CASES[request.param])
    path = tmp_path_factory.mktemp("rgl") / "made.bsdf"
    return request.param, fields, rgl_files.write(path, fields)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return rgl_files.write(tmp_path_factory.mktemp("rgl") / "known.bsdf", fields_of(nm=NM))


def vectors(theta_i, theta_o, phi, phi_i=0.0):
    phi = phi + phi_i
    i = np.stack([np.sin(theta_i) * np.cos(phi_i), np.sin(theta_i) * np.sin(phi_i), np.cos(theta_i)], -1)
    o = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], -1)
    return i, o


def directions_in(fields, found):
    """Of the samples, in the frame of the file: incidences come in their order for each azimuth of the light."""
    azimuth = np.cumsum(np.diff(found.theta_i, prepend=0) < 0)
    assert azimuth[-1] == len(fields["phi_i"]) - 1
    return vectors(found.theta_i, found.theta_o, found.phi, fields["phi_i"][azimuth].astype(float))


def pairs(count, seed=0):
    """Directions anywhere above the horizon."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(0.05, 1, (2, count)))
    return theta[0], theta[1], rng.uniform(-np.pi, np.pi, count)


def test_samples_are_the_known_material(made):
    """At the directions that were read, to the precision of the stored numbers."""
    _, _, path = made
    found = inputs.read(path)
    expected = brdf(found.theta_i, found.theta_o, found.phi, len(found.bands))
    np.testing.assert_allclose(found.values, expected, rtol=2e-6)
    assert len(np.unique(found.theta_i)) == 5, "light at 90 degrees is none"
    assert found.theta_o.max() < np.pi / 2


def test_samples_are_what_the_oracle_looks_up(made):
    _, fields, path = made
    found = inputs.read(path)
    at = np.random.default_rng(1).choice(len(found.phi), 60, replace=False)
    i, o = (x[at] for x in directions_in(fields, found))
    expected = [[looked_up(fields, a, b, c) for a, b in zip(i, o, strict=True)] for c in range(len(found.bands))]
    np.testing.assert_allclose(found.values[:, at] * o[:, 2], expected, rtol=1e-6)


def looked_up(fields, i, o, channel):
    nm = None if "rgb" in fields else float(fields["wavelengths"][channel])
    return oracle.evaluate(fields, i, o, channel, nm)


# --- Mitsuba


def mitsuba(variant):
    plugin = pytest.importorskip("merlfit.scene.mitsuba", reason="needs merlfit[mitsuba]", exc_type=ImportError)
    if variant.startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("needs LLVM: Debian's libllvm19")
    plugin.mi.set_variant(variant)
    return plugin.mi, plugin.dr


def rendered(variant, path, i, o, nm):
    """What the plugin `measured` returns, f cos theta_o: (N, C); of a spectral file at four wavelengths (nm)."""
    mi, dr = mitsuba(variant)
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})

    def of(i, o):
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(i)
        if nm is not None:
            si.wavelengths = mi.Spectrum(nm)
        return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(o)))

    if variant.startswith("llvm"):
        return of(*(x.T.astype(np.float32) for x in (i, o))).T
    return np.array([of(a.tolist(), b.tolist()) for a, b in zip(i, o, strict=True)])


@pytest.mark.parametrize("made", DETERMINED, indirect=True)
@pytest.mark.parametrize("kind", ["scalar", "llvm_ad"])
def test_samples_are_what_mitsuba_evaluates(made, kind):
    name, fields, path = made
    found = inputs.read(path)
    nm = None if name == "rgb" else [float(x) for x in fields["wavelengths"][:4]]
    i, o = directions_in(fields, found)
    there = rendered(f"{kind}_{'rgb' if nm is None else 'spectral'}", path, i, o, nm)
    error = np.abs(found.values[: there.shape[1]] * o[:, 2] / there.T - 1)
    assert np.quantile(error, 0.99) < 2e-5
    assert error.max() < 5e-4  # where many nodes lie close together: Mitsuba computes in float32, turned by chance
    wrong = np.abs(found.values[: there.shape[1]] / there.T - 1)
    assert np.median(wrong) > 0.1, "a BRDF without the cosine is told apart"


@pytest.mark.parametrize("made", DETERMINED, indirect=True)
@pytest.mark.parametrize("kind", ["scalar", "llvm_ad"])
def test_the_oracle_is_mitsuba_between_the_nodes(made, kind):
    name, fields, path = made
    i, o = vectors(*pairs(150))
    nm = None if name == "rgb" else [370.0, 500.0, 640.0, 999.0]
    there = rendered(f"{kind}_{'rgb' if nm is None else 'spectral'}", path, i, o, nm)
    expected = np.array([
        [oracle.evaluate(fields, a, b, c, None if nm is None else nm[c]) for c in range(there.shape[1])]
        for a, b in zip(i, o, strict=True)
    ])  # fmt: skip
    error = np.abs(there / expected - 1)
    assert np.quantile(error, 0.95) < 1e-5
    assert error.max() < 1e-4
    wrong = {**fields, "vndf": fields["vndf"].swapaxes(2, 3)}
    expected = [oracle.evaluate(wrong, a, b, 0, None if nm is None else nm[0]) for a, b in zip(i, o, strict=True)]
    assert np.median(np.abs(expected / there[:, 0] - 1)) > 1e-3, "exchanged axes are told apart"


@pytest.mark.parametrize("made", DETERMINED, indirect=True)
def test_between_the_nodes_pictures_have_what_the_oracle_has(made):
    """Where all nodes around are samples; at the horizon the measured ones stand for all."""
    _, fields, path = made
    found = inputs.read(path)
    theta_i, theta_o, phi = (x[pairs(300)[0] < np.radians(75)] for x in pairs(300))
    i, o = vectors(theta_i, theta_o, phi)
    normal = np.array([oracle.angles(m) for m in i + o]).T
    drawn = found.between(found.values, theta_i, np.cos(theta_o), *normal)
    expected = [[looked_up(fields, a, b, c) / b[2] for a, b in zip(i, o, strict=True)] for c in range(len(drawn))]
    error = np.abs(drawn / np.array(expected) - 1)
    assert np.mean(error < 1e-5) > 0.8
    assert np.isfinite(drawn).mean() > 0.98
    wrong = found.between(found.values, theta_i, np.cos(theta_o), normal[0], -normal[1])
    assert np.nanmedian(np.abs(wrong / drawn - 1)) > 1e-6, (
        "a mirrored azimuth is told apart: densities here are oblique"
    )


# --- shares and wavelengths


def test_shares_are_how_much_light_the_file_reflects_of_each_node(file):
    """Of directions drawn evenly, each looks its value up among the measured nodes around it."""
    fields = fields_of(nm=NM)
    found = inputs.read(file)
    incidence = 3
    density = fields["vndf"][0, incidence].astype(float)
    nodes = fields["luminance"].shape[-1]
    kept = fields["luminance"][0, incidence] > 0
    drawn = 20_000
    rng = np.random.default_rng(0)
    theta_o, phi = np.arccos(rng.random(drawn)), rng.uniform(-np.pi, np.pi, drawn)
    theta_i = float(fields["theta_i"][incidence])
    i, o = vectors(np.full(drawn, theta_i), theta_o, phi)
    counted, solid = np.zeros((nodes, nodes)), np.zeros((nodes, nodes))
    for m in i + o:
        u = oracle.to_square(*oracle.angles(m))
        s, t = oracle.back(density, *u)
        near = {(r, c): a * b for r, a in corners(t, nodes) for c, b in corners(s, nodes) if kept[r, c]}
        for node, hat in near.items():
            solid[node] += hat / sum(near.values())
            counted[node] += hat / sum(near.values()) * oracle.bilinear(fields["ndf"].astype(float), *u)
    own = np.array([[ndf_at(fields, density, r, c, nodes) for c in range(nodes)] for r in range(nodes)])
    expected, alone = (
        one_of_the_mirrors(x / drawn * 2 * np.pi * cosine_integral(fields["theta_i"], incidence), kept)
        for x in (counted / own, solid)
    )
    shares = found.share[found.theta_i == theta_i]
    assert shares.sum() == pytest.approx(expected.sum(), rel=0.01)
    often = expected > 100 / drawn * 2 * np.pi * cosine_integral(fields["theta_i"], incidence)
    assert often.sum() > 20
    error = np.abs(shares[often] / expected[often] - 1)
    assert np.median(error) < 0.05
    assert error.max() < 0.3
    wrong = np.abs(alone[often] / expected[often] - 1)
    assert np.linalg.norm(wrong) > 1.5 * np.linalg.norm(error), "solid angles alone are told apart"


def corners(x, nodes):
    k = min(int(x * (nodes - 1)), nodes - 2)
    return [(k, 1 - (x * (nodes - 1) - k)), (k + 1, x * (nodes - 1) - k)]


def ndf_at(fields, density, row, column, nodes):
    u = oracle.forth(density, column / (nodes - 1), row / (nodes - 1))
    return oracle.bilinear(fields["ndf"].astype(float), *u)


def one_of_the_mirrors(x, kept):
    """Of the nodes in order, those at theta_m = 0 taken together where the first of them is."""
    x, kept = x.copy(), kept.copy()
    x[np.argmax(kept[:, 0]), 0] = x[kept[:, 0], 0].sum()
    kept[:, 0] = np.arange(len(kept)) == np.argmax(kept[:, 0])
    return x[kept]


def cosine_integral(theta_i, k):
    edges = np.concatenate([[0], (theta_i[1:] + theta_i[:-1]) / 2, [np.pi / 2]]).astype(float)
    return np.sin(edges[k + 1]) - np.sin(edges[k])


def test_shares_integrate_the_cosine(tmp_path):
    """The more nodes, the nearer all shares are to Eq. 56's 2 pi."""
    where = rgl_files.parameterization(0.6, np.linspace(0, 85, 18), resolution=64, nodes=32)
    path = rgl_files.write(tmp_path / "matte.bsdf", {**where, "rgb": np.ones((1, 18, 3, 32, 32), np.float32)})
    assert inputs.read(path).share.sum() == pytest.approx(2 * np.pi, rel=0.06)


def test_some_of_many_wavelengths_are_read(tmp_path):
    where = rgl_files.parameterization(0.5, (0, 40), resolution=8, nodes=4)
    nm = np.linspace(360, 1000, 195)
    values = np.random.default_rng(0).uniform(1, 2, (1, 2, 195, 4, 4)).astype(np.float32)
    path = rgl_files.write(tmp_path / "many.bsdf", {**where, "spectra": values, "wavelengths": np.float32(nm)})
    found, all_ = inputs.read(path), rgl.read(path, most=195)
    assert len(found.bands) == 31
    assert found.left_out == 164
    assert found.bands.names[0] == "360nm"
    assert found.bands.names[-1] == "1000nm"
    np.testing.assert_array_equal(found.values, all_.values[np.isin(all_.bands.names, found.bands.names)])
    assert found.format == "RGL"
    assert found.colour_space == "none: a channel is a wavelength"


def test_what_was_not_measured_is_no_sample(tmp_path):
    fields = fields_of(nodes=6)
    before = inputs.read(rgl_files.write(tmp_path / "all.bsdf", fields))
    luminance, values = fields["luminance"].copy(), fields["rgb"].copy()
    row, column = np.argwhere(luminance[0, 2] > 0)[3]
    luminance[0, 2, row, column] = 0
    row, column = np.argwhere(luminance[0, 1] > 0)[3]
    values[0, 1, :, row, column] = -1, np.nan, 1
    after = inputs.read(rgl_files.write(tmp_path / "some.bsdf", {**fields, "luminance": luminance, "rgb": values}))
    assert len(after.phi) == len(before.phi) - 1
    np.testing.assert_array_equal((~after.valid).sum(1), [0, 1, 0])
    assert after.values[0].min() < 0, "a negative value is a datum"


# --- genuine measurements


@pytest.mark.parametrize("name", ["cc_green_malachite", "chm_mint", "vch_golden_yellow", "satin_purple", "cardboard"])
def test_a_genuine_file_reflects_what_it_reflects_when_it_is_drawn(name, genuine):
    """Light over the hemisphere by the shares, against the interpolant that renderers draw, on an even lattice of m."""
    path = genuine(f"{name}_rgb.bsdf")
    found, file = inputs.read(path), tensors(path, path.read_bytes())
    fields = {n: file.array(n, "float32", len(file.fields[n][2])) for n in ("theta_i", "vndf", "ndf", "sigma", "rgb")}
    incidence = 4
    here = found.theta_i == np.unique(found.theta_i)[incidence]
    cosine = cosine_integral(fields["theta_i"].astype(float), incidence)
    ours = found.values[:, here] @ (found.share * np.cos(found.theta_o))[here] / cosine
    expected = drawn_albedo(fields, incidence)
    np.testing.assert_allclose(ours, expected, atol=0.01 * expected.max())


def drawn_albedo(fields, incidence, count=400):
    """int f cos theta_o d omega_o of the interpolant, (C,), on a lattice of normals that are denser near the mirror."""
    theta_i = float(fields["theta_i"][incidence])
    density, rgb = fields["vndf"][0, incidence].astype(float), fields["rgb"][0, incidence].astype(float)
    u = ((np.arange(count) + 0.5) / count) ** 2
    v = (np.arange(count // 4) + 0.5) / (count // 4)
    rows = np.trapezoid(density, axis=1)
    total = np.zeros(3)
    for y in v:
        t, line = oracle.share_up_to(rows, y), oracle.lerp(density, y)
        below = np.append(0, np.cumsum((line[1:] + line[:-1]) / 2)) / np.trapezoid(line)
        k = np.minimum((u * (len(line) - 1)).astype(int), len(line) - 2)
        inside = u * (len(line) - 1) - k
        s = below[k] + (line[k] * inside + (line[k + 1] - line[k]) * inside**2 / 2) / np.trapezoid(line)
        theta_m, phi_m = u**2 * np.pi / 2, (2 * y - 1) * np.pi
        m = np.stack([np.sin(theta_m) * np.cos(phi_m), np.sin(theta_m) * np.sin(phi_m), np.cos(theta_m)], -1)
        cosine = m @ np.array([np.sin(theta_i), 0, np.cos(theta_i)])
        above = (cosine > 0) & (2 * cosine * m[:, 2] - np.cos(theta_i) > 0)
        d = np.interp(u, np.linspace(0, 1, fields["ndf"].shape[1]), fields["ndf"][0].astype(float))
        # d omega_o = 4 (i.m) d omega_m, d omega_m = 2 pi^2 u sin(theta_m) du dv, du = 2 sqrt(u) / count
        weight = above * d * cosine * 2 * np.pi**2 * u * np.sin(theta_m) * 2 * np.sqrt(u) / count / len(v)
        total += [weight @ np.interp(s, np.linspace(0, 1, plane.shape[1]), oracle.lerp(plane, t)) for plane in rgb]
    return total / oracle.bilinear(fields["sigma"].astype(float), *oracle.to_square(theta_i, 0.0))


def test_light_at_90_degrees_is_none_however_it_is_rounded(genuine):
    """Its slice is a copy of the one before it; the angle is stored 7.5e-8 below pi/2."""
    found = inputs.read(genuine("paper_white_rgb.bsdf"))
    assert np.degrees(found.theta_i.max()) == pytest.approx(78.5, abs=0.1)
    assert np.nanmax(found.values) < 10


def test_negative_values_of_saturated_colours_are_data(genuine):
    found = inputs.read(genuine("chm_mint_rgb.bsdf"))
    assert found.valid.all()
    assert 0.6 < np.mean(found.values[0] < 0) < 0.8
    incidence = np.unique(found.theta_i)[1]
    here = found.theta_i == incidence
    edges = np.unique(found.theta_i)[:3]
    cosine = np.sin((edges[1] + edges[2]) / 2) - np.sin((edges[0] + edges[1]) / 2)
    red = found.values[0, here] @ (found.share * np.cos(found.theta_o))[here] / cosine
    assert 0.01 < red < 0.05, "0.11 without them"


def test_the_mirror_direction_is_one_sample(genuine):
    found = inputs.read(genuine("satin_purple_rgb.bsdf"))
    mirrored = (np.abs(found.theta_o - found.theta_i) < 1e-9) & (np.abs(np.abs(found.phi) - np.pi) < 1e-9)
    np.testing.assert_array_equal(np.sum(mirrored & (found.theta_i > 0)), len(np.unique(found.theta_i)) - 1)


@pytest.fixture(scope="module")
def genuine():
    """The path of one of RGL's files by its name."""
    folder = Path(__file__).parents[2] / ".." / "shared" / "data" / "measured" / "rgl"
    if not folder.is_dir():
        (pytest.fail if os.environ.get("CI") else pytest.skip)("needs RGL's files in ../shared/data/measured")
    return lambda name: folder / name


# --- what is refused


def changed(**other):
    return lambda fields: {name: x for name, x in {**fields, **other}.items() if x is not None}


REFUSED = [
    (changed(vndf=None), "has no field vndf"),
    (changed(jacobian=None), "has no field jacobian"),
    (changed(rgb=None), "has neither spectra and wavelengths nor rgb"),
    (changed(theta_i=np.array([0.0, 1.0])), "field theta_i is float64, not float32"),
    (changed(jacobian=np.ones(1, np.float32)), "field jacobian is float32, not uint8"),
    (changed(ndf=np.ones(4, np.float32)), "field ndf has shape (4,), not 2 sizes above 0"),
    (changed(sigma=np.ones((0, 4), np.float32)), "field sigma has shape (0, 4), not 2 sizes above 0"),
    (changed(sigma=np.ones((1, 4), np.float32)), "field sigma has shape (1, 4), without two nodes along each side"),
    (changed(phi_i=np.linspace(0, 3, 8, dtype=np.float32)), "is anisotropic: it has 8 azimuths of light"),
    (changed(theta_i=np.float32([0, 1])), "field vndf has shape (1, 6, 24, 24), which does not fit 1 phi_i, 2 theta_i"),
    (
        changed(luminance=np.ones((1, 6, 6, 7), np.float32)),
        "field luminance has shape (1, 6, 6, 7), which does not fit",
    ),
    (changed(rgb=np.ones((1, 6, 4, 6, 6), np.float32)), "field rgb has shape (1, 6, 4, 6, 6), not (1, 6, 3, 6, 6)"),
    (changed(wavelengths=np.float32([500])), "has neither spectra and wavelengths nor rgb"),
    (changed(spectra=np.ones((1, 6, 2, 6, 6), np.float32), wavelengths=np.float32([500, 500])), "500nm is there twice"),
    (
        changed(spectra=np.ones((1, 6, 1, 6, 6), np.float32), wavelengths=np.float32([0.5])),
        "wavelength 0.0005 um is not",
    ),
    (changed(ndf=np.float32([[1, np.nan], [1, 1]])), "field ndf holds a number that is negative or not finite"),
    (changed(vndf=np.zeros((1, 6, 4, 4), np.float32)), "field vndf holds no normal that light sees"),
    (changed(theta_i=np.float32(np.zeros(6))), "the angles theta_i do not rise"),
    (changed(rgb=np.full((1, 6, 3, 6, 6), np.nan, np.float32)), "holds no datum: every value is not finite"),
    (changed(luminance=np.zeros((1, 6, 6, 6), np.float32)), "holds no datum"),
]


@pytest.fixture(scope="module")
def plain():
    return fields_of(nodes=6)


@pytest.mark.parametrize(("change", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_a_bad_file_gets_one_line_that_names_it(plain, change, words, tmp_path):
    said = refusal(rgl_files.write(tmp_path / "bad.bsdf", change(plain)))
    assert words in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data[:10], "truncated in its header, at byte 10"),
        (lambda data: data[:60], "truncated in its header, at byte 60"),
        (lambda data: data[:-100], "truncated: field rgb ends at byte"),
        (lambda _: b"", "truncated in its header, at byte 0"),
        (lambda data: b"\x89PNG" + data, "is a PNG picture, not a tensor file"),
        (lambda data: b"<xml>" + data, "is not a tensor file: it does not begin with 'tensor_file'"),
        (lambda data: data[:12] + b"\2" + data[13:], "is a tensor file of version 2.0; 1.0 is read"),
        (lambda data: data[:14] + b"\xff" * 4 + data[18:], "is damaged: its header tells of 4294967295 fields"),
        (lambda data: data.replace(b"phi_i", b"a\nb\0c"), "has no field phi_i"),
    ],
)
def test_a_damaged_file_gets_one_line_that_names_it(plain, change, words, tmp_path):
    path = rgl_files.write(tmp_path / "bad.bsdf", plain)
    path.write_bytes(change(path.read_bytes()))
    assert words in refusal(path)


def refusal(path):
    with pytest.raises(MerlError) as error:
        inputs.read(path)
    said = str(error.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    return said


def test_missing_folder_or_another_file(file, tmp_path):
    assert "no such file" in refusal(tmp_path / "none.bsdf")
    (tmp_path / "folder.bsdf").mkdir()
    assert "is a directory" in refusal(tmp_path / "folder.bsdf")
    assert inputs.read(file, inputs.read(file).sha1).name == "known"
    with pytest.raises(MerlError, match="is not the file that was fitted"):
        inputs.read(file, "0" * 40)


@pytest.mark.parametrize("channels", [3, 31, 195])
def test_memory_is_three_times_that_of_the_file_and_a_few_mib(channels, tmp_path):
    """In RGL's layout: 8 incidences, 32 nodes along each side."""
    where = rgl_files.parameterization(resolution=128)
    values = np.ones((1, 8, channels, 32, 32), np.float32)
    nm = np.linspace(360, 1000, channels, dtype=np.float32)
    whole = {"rgb": values} if channels == 3 else {"spectra": values, "wavelengths": nm}
    path = rgl_files.write(tmp_path / "large.bsdf", {**where, **whole})
    inputs.read(path)
    tracemalloc.start()
    inputs.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * path.stat().st_size + 2**22
