"""The commands do with a rival what they do with the two-scale model."""

import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.fitting.results.storage import read_result
from merlfit.merl_io.binary import read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.model.measured import Measured
from merlfit.model.reflectance import evaluate
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.oren_nayar_qualitative import OrenNayarQualitative
from typer.testing import CliRunner

TRUTH = {
    GGX(): {"alpha": 0.15, "F0": np.array([0.9, 0.6, 0.3]), "albedo": np.array([0.02, 0.1, 0.3])},
    OrenNayarQualitative(): {"roughness": 0.5, "albedo": np.array([0.7, 0.4, 0.1])},
}


@pytest.mark.parametrize("model", TRUTH, ids=lambda m: m.name)
def test_the_commands_do_with_a_rival_what_they_do_with_the_two_scale_model(model, tmp_path):
    """Fitted among all models, sampled, inspected, tabulated; every number comes back."""
    truth, exponents = TRUTH[model], {"grazing_exponent": 0.3} if model.lobes else {}
    seen = Measured(model)
    values = tabulate(lambda g: evaluate(seen, truth | exponents, g))
    path, rng = tmp_path / "made.binary", np.random.default_rng(0)
    write(path, values * np.exp(0.05 * rng.standard_normal(values.shape)))

    def call(*words):
        shown = CliRunner().invoke(cli.app, [str(word) for word in words], env={"COLUMNS": "120"})
        assert shown.exit_code == 0, shown.output
        return " ".join(shown.output.split())

    others = [word for m in TRUTH for word in ("--model", m.name)]
    said = call("fit", path, *others, "--posterior", "-o", tmp_path)
    assert f"made {model.name} CONVERGED" in said
    result = read_result(tmp_path / "made.json")
    assert result.model.measured == seen
    assert {c.model for c in result.fit.candidates} == {m.name for m in TRUTH}
    for name, value in result.values().items():
        np.testing.assert_allclose(value, (truth | exponents)[name], rtol=0.05, err_msg=name)
        quantiles = [q.quantiles for q in result.parameters if q.parameter == name]
        assert all(q.q05 < q.q50 < q.q95 for q in quantiles)
        np.testing.assert_allclose([q.q50 for q in quantiles], (truth | exponents)[name], rtol=0.01, err_msg=name)
    assert f"{model.name}, grazing exponent" in call("inspect", tmp_path / "made.json") or not model.lobes
    assert {f"made.{model.name}.{picture}.png" for picture in ("lobes", "corner")} <= {
        p.name for p in tmp_path.iterdir()
    }
    loss = ["--with-grazing-loss"] if model.lobes else []
    assert f"from the {model.name} fit of made" in call(
        "synth", tmp_path / "made.json", "-o", tmp_path / "again.binary", *loss
    )
    again, valid = read(tmp_path / "again.binary"), merl_grid().above
    np.testing.assert_allclose(again.values[:, valid], values[:, valid], rtol=0.05)
