"""Files of RGL's kind that are written: what the reader, a slow oracle and Mitsuba's own plugin find in them."""

import numpy as np
import pytest
from merlfit.merl_io import inputs, rgl_writer
from merlfit.merl_io.tensor import tensors

from tests.oracles import rgl as oracle


def brdf(i, o):
    """A made-up one in three channels: reciprocal, with a highlight on a diffuse base that grows to the horizon."""
    h = i + o
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    tangent2 = 1 / h[:, 2] ** 2 - 1
    fresnel = 0.04 + 0.96 * (1 - np.sum(h * i, -1)) ** 5
    lobe = fresnel * np.exp(-tangent2 / np.array([[0.09], [0.1], [0.12]])) / 0.3
    return np.array([[0.1], [0.05], [0.2]]) + lobe / np.maximum(i[:, 2], o[:, 2])


@pytest.fixture(scope="module")
def parts():
    return rgl_writer.fields(brdf)


@pytest.fixture(scope="module")
def file(parts, tmp_path_factory):
    path = tmp_path_factory.mktemp("rgl") / "made_rgb.bsdf"
    rgl_writer.write(path, parts, rgl_writer.coloured(parts, np.eye(3)), "made, é")
    return path


@pytest.fixture(scope="module")
def pairs():
    """Random directions, and those near the mirror's."""
    rng = np.random.default_rng(0)
    cos, phi = rng.uniform(0.1, 1, (2, 60)), rng.uniform(0, 2 * np.pi, (2, 60))
    sin = np.sqrt(1 - cos**2)
    i, o = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], -1)
    o[30:] = [-1, -1, 1] * i[30:] + 0.1 * rng.standard_normal((30, 3)) * i[30:, 2:]
    return i, o / np.linalg.norm(o, axis=-1, keepdims=True)


def test_samples_that_are_read_are_the_brdf(tmp_path, monkeypatch):
    monkeypatch.setattr(rgl_writer, "NODES", 16)
    monkeypatch.setattr(rgl_writer, "THETA_I", np.radians([0, 30, 60, 75, 90]))
    parts = rgl_writer.fields(brdf)
    rgl_writer.write(
        tmp_path / "small_rgb.bsdf", parts, rgl_writer.coloured(parts, np.eye(3)), "a fit, tabulated by merlfit 1"
    )
    found = inputs.read(tmp_path / "small_rgb.bsdf")
    assert found.notes[-1] == "not measured: its description says 'a fit, tabulated by merlfit 1'"
    expected = brdf(*_vectors(found))
    assert found.values.shape[1] > 0.7 * 16 * 16 * 4
    shown = found.theta_o < np.radians(89)  # beyond, it is asked for a little higher
    np.testing.assert_allclose(found.values[:, shown], expected[:, shown], rtol=1e-3)


def test_the_oracle_draws_the_brdf_between_the_nodes(file, pairs):
    """A file whose facets are twice as many is drawn twice as bright, and is told from it."""
    data = tensors(file, file.read_bytes())
    arrays = {name: data.array(name, _kind(shape), len(shape[2])) for name, shape in data.fields.items()}
    assert bytes(arrays["description"]).decode() == "made, é"

    def off(fields):
        drawn = [
            [oracle.evaluate(fields, *pair, channel=c) / pair[1][2] for c in range(3)]
            for pair in zip(*pairs, strict=True)
        ]
        return np.abs(np.array(drawn).T / brdf(*pairs) - 1)

    assert np.median(off(arrays)) < 2e-3
    assert np.quantile(off(arrays), 0.95) < 0.1
    assert np.median(off(arrays | {"ndf": 2 * arrays["ndf"]})) > 0.9


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral"])
def test_mitsubas_own_plugin_draws_the_brdf(variant, parts, file, pairs, tmp_path):
    mi = pytest.importorskip("mitsuba", reason="needs merlfit[mitsuba]")
    mi.set_variant(variant)
    path = file
    if variant == "scalar_spectral":
        path = tmp_path / "made_spec.bsdf"
        rgl_writer.write(path, parts, rgl_writer.coloured(parts, np.eye(3)), "made", np.array([450.0, 550.0, 650.0]))
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    at, context = mi.SurfaceInteraction3f(), mi.BSDFContext()
    at.wavelengths = [450.0, 550.0, 650.0, 500.0][: len(at.wavelengths)]
    found = []
    for i, o in zip(*pairs, strict=True):
        at.wi = mi.Vector3f(*i)
        found.append(np.array(bsdf.eval(context, at, mi.Vector3f(*o))) / o[2])
    off = np.abs(np.array(found).T[:3] / brdf(*pairs) - 1)
    assert np.median(off) < 2e-3
    assert np.quantile(off, 0.95) < 0.1


def _kind(field):
    return {1: "uint8", 10: "float32"}[field[0]]


def _vectors(found):
    i = np.stack([np.sin(found.theta_i), 0 * found.theta_i, np.cos(found.theta_i)], -1)
    sin = np.sin(found.theta_o)
    return i, np.stack([sin * np.cos(found.phi), sin * np.sin(found.phi), np.cos(found.theta_o)], -1)
