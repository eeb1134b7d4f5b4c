"""What stays of a posterior when its sampler, or the file of its chain, fails."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.posterior import sampling
from merlfit.fitting.posterior.chain import ChainError
from merlfit.fitting.posterior.importance import Posterior
from merlfit.fitting.results.schema_material import Model
from merlfit.fitting.support.terminal import FAILED_FIT
from merlfit.merl_io.bands import Bands
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.support.command import call
from tests.support.made_results import DEFAULTS, put_result


def test_quantiles_stay_when_only_the_chain_cannot_be_written(tmp_path, monkeypatch):
    layout = layout_of(TwoScale("none", "off"))
    draws = np.zeros((4, layout.size))
    none = np.zeros(4)
    chain = SimpleNamespace(arrays=dict)
    found = Posterior(chain, draws, none + 0.25, none, none, 0.1, None, none, True, "long enough")
    monkeypatch.setattr(sampling, "draw", lambda *_: found)
    monkeypatch.setattr(sampling, "physical", lambda layout, draws: (draws + 1, {}))
    fitted = SimpleNamespace(layout=layout, solution=SimpleNamespace(z=np.zeros(layout.size)))
    path = tmp_path / "missing" / "x.chain.npz"
    sampled = sampling.sample(fitted, None, 10, 0, path)
    assert sampled.posterior.sufficient
    assert np.all(sampled.values == 1)
    assert sampled.posterior.message == (
        f"long enough; the chain is not kept: {path}: cannot be written (No such file or directory)"
    )


def test_a_chain_of_other_settings_or_wavelengths_is_refused_though_its_coordinates_are_the_same(tmp_path):
    path, bands = tmp_path / "x.chain.npz", Bands(("R", "G", "B"), (0.65, 0.55, 0.45))
    layout = layout_of(Measured(TwoScale("none")))
    np.savez(path, **sampling._names(layout))
    told = Model.of(layout.model, DEFAULTS, layout.bands).model_dump_json()
    sampling.refuse_other_model(path, layout_of(Model.model_validate_json(told).measured))
    for other in (layout_of(Measured(TwoScale("none", masking="none"))), layout_of(layout.model, bands=bands)):
        assert other.names == layout.names
        with pytest.raises(ChainError, match="of a fit with other settings or wavelengths, or of another version"):
            sampling.refuse_other_model(path, other)
    np.savez(path, names=layout.names)
    with pytest.raises(ChainError, match="of a fit with other settings or wavelengths, or of another version"):
        sampling.refuse_other_model(path, layout)


def test_a_sampler_that_fails_is_said_in_a_line(tmp_path, monkeypatch):
    def fail(*_):
        raise KeyError("x")

    monkeypatch.setattr(sampling, "_sampled", fail)
    with pytest.raises(RuntimeError, match="the sampler: KeyError: 'x'"):
        sampling.sample(None, None, 10, 0, tmp_path / "x.chain.npz")
    put_result(tmp_path)
    before = (tmp_path / "nickel.json").read_bytes()
    monkeypatch.setattr(
        "merlfit.fitting.commands.sample.resample", lambda *_: sampling.sample(None, None, 10, 0, Path("x"))
    )
    shown = call("sample", tmp_path / "nickel.json")
    assert shown.exit_code == FAILED_FIT
    assert "the sampler: KeyError: 'x'; " in shown.output.replace("\n", " ")
    assert "Traceback" not in shown.output
    assert "in fail\n" in (tmp_path / "logs" / "nickel.log").read_text(), "where it failed"
    assert (tmp_path / "nickel.json").read_bytes() == before


def test_draws_stay_while_their_chain_is_continued(tmp_path):
    """The result names them until there are new ones."""
    drawn = {name: np.ones(3) for name in (*sampling.DRAWN, "derived_f0")}
    np.savez(tmp_path / "nickel.chain.npz", names=np.array(["beta"]), chain_free=np.zeros((5, 2, 1)), **drawn)
    assert sampling._drawn(tmp_path / "nickel.chain.npz").keys() == drawn.keys()
    np.savez(tmp_path / "unfinished.npz", names=np.array(["beta"]), chain_free=np.zeros((5, 2, 1)))
    assert sampling._drawn(tmp_path / "unfinished.npz") == {}
