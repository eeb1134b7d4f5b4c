"""Files with other numbers of bins than MERL's: asked for by `--dims`, and then fitted, found again and drawn."""

import numpy as np
import pytest
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.fitting.results.storage import read_result
from merlfit.merl_io.binary import write
from merlfit.model.measured import Measured
from merlfit.model.reflectance import evaluate
from merlfit.model.rivals.ggx import GGX
from merlfit.scene.spheres import compared, render

from tests.support.command import call

DIMS = (30, 30, 60)
TRUTH = {
    "alpha": 0.15, "F0": np.array([0.7, 0.5, 0.3]), "albedo": np.array([0.1, 0.2, 0.05]), "grazing_exponent": 0.2
}  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    target = tmp_path_factory.mktemp("dims") / "coarse.binary"
    write(target, tabulate(lambda g: evaluate(Measured(GGX()), TRUTH, g), DIMS), dims=DIMS)
    return target


def test_other_dims_are_refused_until_they_are_asked_for(file, tmp_path):
    for words in (("check", file), ("fit", file, "-o", tmp_path, "--model", "ggx", "--no-posterior")):
        refused = call(*words)
        assert refused.exit_code == 2
        assert "--dims 30x30x60 allows them" in refused.stderr
    wrong = call("check", file, "--dims", "30x30")
    assert wrong.exit_code == 2
    assert "should be three numbers of bins" in wrong.stderr
    assert "30x30x60" in call("check", file, "--dims", "30x30x60").stdout


@pytest.fixture(scope="module")
def fit(file, tmp_path_factory):
    """The command that fits the file, its folder, and its result."""
    folder = tmp_path_factory.mktemp("fits")
    words = ("fit", file, "-o", folder, "--model", "ggx", "--no-posterior", "--dims", "30x30x60", "--resume")
    assert call(*words).exit_code == 0
    return words, folder, read_result(folder / "coarse.json")


def test_they_are_fitted_found_again_and_drawn(file, fit, tmp_path):
    words, folder, result = fit
    assert result.source.dims == DIMS
    for name, found in result.values().items():
        np.testing.assert_allclose(found, TRUTH[name], rtol=2e-3, err_msg=name)
    assert result.metrics.picture < 0.1
    assert result.metrics.highlight == pytest.approx(1, abs=0.01)
    assert "done already: 1 of 1 file, " in call(*words).stdout
    assert call("inspect", folder / "coarse.json", "-o", tmp_path).exit_code == 0
    (lobes,) = tmp_path.glob(f"coarse.{result.model.name}.lobes.png")
    assert lobes.stat().st_size > 10_000
    compared = call("compare", file, "--models", "ggx", "--dims", "30x30x60", "-o", tmp_path / "compared")
    assert compared.exit_code == 0, compared.stderr
    shown = call("metrics", folder / "coarse.json", "--against", file)
    assert shown.exit_code == 0, shown.stderr


def test_spheres_of_coarser_bins_look_alike():
    """The same material on MERL's grid and on half as many rows and columns: what bins round off is what differs."""
    pixels = {}
    for dims in ((90, 90, 180), (45, 45, 90)):
        values = tabulate(lambda g: evaluate(GGX(), {**TRUTH, "alpha": 0.3}, g), dims)
        plane = np.nan_to_num(values)
        pixels[dims] = render(compared("environment", dims), (plane + plane[..., ::-1])[..., : dims[2] // 2] / 2)
    fine, coarse = pixels.values()
    assert np.median(np.abs(coarse / fine - 1)) < 0.03
