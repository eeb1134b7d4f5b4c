"""The benchmarks' own parts: the plain NumPy model, the residuals given to scipy, processes watched, the writer."""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import compress
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.convolution import convolve
from merlfit.model.geometry import Geometry
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.bench import plain_numpy, processes, record
from tests.bench.against_scipy import Whole
from tests.support.compiled import two_scale
from tests.support.lobes import ANGLES, draw

pytestmark = pytest.mark.usefixtures("compiled_quickly")
METAL = {
    "beta": 0.12, "p": 0.6, "b": 4.8, "c": 2.2, "sigma_s": 0.027, "grazing_exponent": 0.35,
    "grazing_exponent_diffracted": 0.15,
    "n": np.array([1.9, 1.7, 1.6]), "k": np.array([3.5, 3.2, 2.4]),
}  # fmt: skip
SHARP = {**METAL, "beta": 0.0166, "p": 0.42, "b": 20.0, "c": 1.6, "sigma_s": 0.047}


@pytest.mark.parametrize("values", [METAL, SHARP], ids=["wide", "sharp"])
def test_the_plain_model_is_the_same_model(values):
    grid = merl_grid()
    theta_h, theta_d = grid.theta_h[2::12], grid.theta_d[4::12]
    cosines = grid.cos_i[2::12, 4::12, 4:90:12], grid.cos_o[2::12, 4::12, 4:90:12]
    plain = plain_numpy.brdf(values, theta_h, theta_d, *cosines)
    where = Geometry(*map(jnp.asarray, (theta_h[:, None, None], theta_d[:, None], *cosines)))

    def differs(**changed):
        loss = changed.pop("grazing_loss", "free")
        model = Measured(TwoScale(**{"order": 64, **changed}), loss)
        ours = np.asarray(two_scale(values, where, model))
        np.testing.assert_array_equal(plain > 0, ours > 0)
        return np.max(np.abs(plain - ours)[ours > 0] / ours[ours > 0])

    assert differs() < 1e-3
    others = [{"colour": "fresnel"}, {"renormalised": False}, {"masking": "height_correlated"}, {"grazing_loss": 0.3}]
    for changed in others:
        assert differs(**changed) > 1e-2, changed


def test_its_lobes_within_the_bounds_of_the_fit():
    blurred = jax.jit(convolve, static_argnums=5)
    lobes, angles = draw(200, (0.01, 1.01, 1e-3, 0.2), (900, 6, 1, 5)), ANGLES[4::9]
    truth = np.array([np.asarray(blurred(angles, *lobe, 64)) for lobe in lobes])

    def error(**rule):
        plain = lambda t, B, *lobe: plain_numpy.blurred(float(t), np.array(B), *lobe, **rule)  # noqa: E731
        found = np.array([[plain(t, *lobe) for t in angles] for lobe in lobes])
        return np.quantile(np.abs(found - truth)[truth > 1e-200] / truth[truth > 1e-200], [0.5, 0.95])

    assert np.all(error() < [1e-5, 2e-2]), error()
    assert error(radii=24, azimuths=10)[1] > 8e-2


def test_scipy_is_given_the_same_problem():
    grid, layout = merl_grid(), layout_of(Measured(TwoScale("lambert", "off")))
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    samples = thin(fold(grid, 0.3 + 0 * weight, weight), (10, 10, 45))
    z = np.random.default_rng(1).normal(size=layout.size) / 2
    whole = Whole(layout, samples)
    residuals, slope = whole.residuals(z), whole.slope(z)
    ours = compress(z, Objective(layout, make_problem(samples)).normal_equations(z))
    np.testing.assert_allclose(slope.T @ slope, ours.slope.T @ ours.slope, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(slope.T @ residuals, ours.slope.T @ ours.value, rtol=1e-8, atol=1e-12)
    assert whole.objective(z) == pytest.approx(float(ours.value @ ours.value), rel=1e-9)
    left = np.sum(samples.weight * (samples.value - predict_samples(layout, z, samples)) ** 2)
    assert whole.cost(z) == pytest.approx(left / np.sum(samples.weight * samples.value**2), rel=1e-9)


def test_processes_are_watched():
    hold = "import time; x = bytearray({} * 2**20); time.sleep(0.3); print(len(x))"
    small, large = ([sys.executable, "-c", hold.format(mib)] for mib in (1, 200))
    done = processes.watch(small, large)
    assert done.outputs == [f"{2**20}\n", f"{200 * 2**20}\n"]
    assert 195 < done.peaks_mib[1] - done.peaks_mib[0] < 205
    started = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"
    of_child = processes.watch([sys.executable, "-c", started, large[-1]])
    assert abs(of_child.peaks_mib[0] - done.peaks_mib[1]) < 5
    assert of_child.sums_mib[0] > of_child.peaks_mib[0] + 2
    assert 0.3 < done.seconds < 20
    with pytest.raises(RuntimeError, match="exit code 3: said"):
        processes.watch([sys.executable, "-c", "print('said'); raise SystemExit(3)"])
    assert processes.watch([sys.executable, "-c", "raise SystemExit(1)"], codes=(0, 1)).outputs == [""]


def test_a_record_says_what_was_asked_and_measured(tmp_path, capsys):
    targets = {"time": record.Target("a fit", 5, "s"), "ratio": record.Target("faster", 10, "times", True)}
    made = record.Record("some", "Some", "synthetic: ones", ["A note."], targets, folder=tmp_path)
    made.add({"files": 1, "seconds": 2.0, "of": "one"}, {"runs": [1.0, 3.0]})
    made.add({"files": 4, "seconds": np.float64(16.0), "of": "two"})
    assert "seconds 16" in capsys.readouterr().out
    assert made.column("seconds", of="two") == [16.0]
    assert record.exponent(made.column("files"), made.column("seconds")) == pytest.approx(1.5)
    made.set("time", 4.0)
    read = json.loads((tmp_path / "some.json").read_text())
    assert not read["finished"]
    assert "Unfinished" in (tmp_path / "some.md").read_text()
    made.set("ratio", 9.0)
    made.finish()
    read, table = json.loads((tmp_path / "some.json").read_text()), (tmp_path / "some.md").read_text()
    assert [read["targets"][name]["met"] for name in ("time", "ratio")] == [True, False]
    assert read["rows"][0] == {"files": 1, "seconds": 2.0, "of": "one", "details": {"runs": [1.0, 3.0]}}
    assert {"cores", "processor", "memory_gib", "python", "jax", "date"} <= set(read["machine"])
    for line in ("| a fit | 4 s | <= 5 s | yes |", "| faster | 9 times | >= 10 times | **no** |", "| 4 | 16 | two |"):
        assert line in table
    assert "Unfinished" not in table
    record.summary(tmp_path)
    assert "| faster | 9 times | >= 10 times | **no** | [some](some.md) |" in (tmp_path / "README.md").read_text()


def test_what_is_not_measured_is_not_met():
    for at_least in (False, True):
        assert not record.Target("x", 1, "s", at_least).met
        assert not record.Target("x", 1, "s", at_least, float("nan")).met
