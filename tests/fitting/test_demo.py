"""The demo: a file of known parameters that does not get in the way of others, and what is said of its fit."""

import numpy as np
import pytest
from merlfit.fitting.batch import unit
from merlfit.fitting.commands import cli, demo
from merlfit.fitting.pipeline.models import candidates
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.binary import genuine_names, read, write
from merlfit.model.measured import Measured
from typer.testing import CliRunner

from tests.support.made_results import made, quantiles


@pytest.fixture
def stand_in(monkeypatch, own_cache):
    """A short way to the BRDF and to the fit."""
    monkeypatch.setattr(demo, "values", lambda: np.full((3, 90, 90, 180), 0.5))

    def fit(path, out, settings, *_):
        result = made(path.stem, str(path), model=demo.EFFECTS)
        true = [x for q in demo.EFFECTS.parameters for x in np.ravel(demo.TRUTH[q.name])]
        for k, (q, x) in enumerate(zip(result.parameters, true, strict=True)):
            q.value, q.quantiles = float(x), quantiles(float(x) if k else 2 * float(x))
        write_result(out / f"{path.stem}.json", result)
        return result

    monkeypatch.setattr(unit, "fit_file", fit)


def run(*words):
    return CliRunner().invoke(cli.app, ["demo", *map(str, words)])


def test_the_demo_tells_the_truth_and_may_be_repeated(stand_in, tmp_path):
    out = tmp_path / "demo-out"
    for _ in range(2):
        shown = run("-o", out)
        assert shown.exit_code == 0, shown.output
        assert "a red plastic, computed from known parameters" in shown.stdout
        assert "10 of 11 true values lie in their 90 % intervals" in shown.stdout
        assert "true" in shown.stdout
    assert not list(out.glob(".merlfit-*"))


def test_the_demo_does_not_overwrite_another_file(stand_in, tmp_path):
    path, mine = tmp_path / f"{demo.NAME}.binary", np.ones((3, 90, 90, 180))
    write(path, mine)
    refused = run("-o", tmp_path)
    assert refused.exit_code == BAD_INPUT
    assert "was not made by this demo; --force overwrites it" in refused.stderr
    assert read(path).values.max() == pytest.approx(1.0)
    assert run("-o", tmp_path, "--force").exit_code == 0
    assert read(path).values.max() == pytest.approx(0.5)


def test_its_name_is_none_of_merl():
    assert demo.NAME not in genuine_names().values()


def test_no_apparatus_is_fitted_to_a_synthetic_material():
    settings = demo.settings(3)
    assert settings.seed == 3
    assert candidates(settings) == [Measured(demo.EFFECTS, "off")]


def test_a_seed_that_is_none_is_refused_before_anything_is_made(tmp_path):
    shown = CliRunner().invoke(cli.app, ["demo", "--seed", "-1", "-o", str(tmp_path / "out")])
    assert shown.exit_code == 2
    assert "--seed" in shown.output
    assert not (tmp_path / "out").exists()


def test_without_intervals_the_verdict_says_so():
    assert "no intervals" in demo.verdict(made(model=demo.EFFECTS))
