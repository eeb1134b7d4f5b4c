"""``import merlfit``: a whole analysis from Python."""

import dataclasses
import re
import subprocess
import sys

import merlfit
import numpy as np
import pytest
from merlfit.fitting import api
from merlfit.fitting.fit import error_metrics
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.draws import chain_file, chain_of
from merlfit.fitting.pipeline.place import claimed
from merlfit.fitting.posterior import importance
from merlfit.fitting.results.schema_posterior import sha1_of_draws
from merlfit.fitting.results.storage import read_result, write_result
from merlfit.fitting.show.subject import subject_of
from merlfit.merl_io.grid import merl_grid

from tests.support.made_results import made, put_result

QUICK = {
    "effects": {"body": "none", "diffraction": "off"}, "fit": {"starts": 1, "grid": "coarse"},
    "posterior": {"max_steps": 20},
}  # fmt: skip
PICTURES = "lobes", "spheres", "errors", "isolines", "corner", "trace"


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Of a posterior: a thirtieth of a second each."""
    monkeypatch.setattr(importance, "DRAWS", 40)
    monkeypatch.setattr(importance, "MOST_DRAWS", 60)


WITHOUT_JAX = f"""
import sys
seen = lambda *names: [name for name in names if name in sys.modules]
import merlfit
assert not seen("jax", "matplotlib", "pydantic", "numpy")
print("nothing")
assert set(dir(merlfit)) == {set(merlfit.__all__)}
from merlfit.fitting.commands import cli
assert not seen("jax", "equinox", "matplotlib", "pydantic", "numpy")
from merlfit.fitting.commands import settings
from merlfit.fitting.settings import choice, config
assert config.load({{"fit": {{"weights": "adaptive"}}}}).for_scattered.has_lobes
from merlfit.fitting.commands import checked
from merlfit.merl_io import inputs
assert not seen("jax", "equinox", "matplotlib", "scipy")
try:
    config.load({{"effects": {{"boddy": "plastic"}}}})
except config.ConfigError as error:
    assert "effects.body" in str(error)
assert not seen("jax", "equinox")
print("settings")
assert merlfit.models()
assert seen("jax", "equinox") == ["jax", "equinox"]
import jax
print("jax", jax.numpy.ones(1).dtype)
"""


def test_only_what_computes_waits_for_jax():
    """merlfit itself, settings and their errors, and a look at a file load none; then float64 is on all the same."""
    done = subprocess.run([sys.executable, "-c", WITHOUT_JAX], capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()) == (0, ["nothing", "settings", "jax", "float64"]), done.stderr


def test_float64_is_switched_on_where_jax_was_there_before():
    program = "import jax; import merlfit.model; print(jax.numpy.ones(1).dtype)"
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "float64\n"


@pytest.mark.parametrize("name", merlfit.__all__)
def test_every_name_is_there_and_explained(name):
    assert getattr(merlfit, name).__doc__


def test_an_unknown_name_is_named():
    with pytest.raises(AttributeError, match="'merlfit' has no attribute 'fitt'"):
        merlfit.fitt  # noqa: B018


def test_from_a_file_to_everything_that_is_known_of_it(file, tmp_path):
    told = []
    fit = merlfit.fit(merlfit.read(file), settings=QUICK, seed=5, report=told.append)
    assert fit.succeeded
    assert told[0] == "reading"
    assert fit.result.seed == 5
    assert (fit.status, fit.cost, fit.metrics) == (fit.result.fit.status, fit.result.fit.cost, fit.result.metrics)
    assert fit.result.posterior is None
    assert "fitted parameters" in str(fit)
    assert file.stem in repr(fit)
    table = fit.table()
    assert table["value"].tolist() == [q.value for q in fit.result.parameters]
    assert table["q05"].isna().all()
    assert table.loc["beta", "fitted"] == "free"
    assert fit.parameters["n"].shape == (3,)
    lines = fit.to_latex().splitlines()
    assert lines[0] == r"\begin{tabular}{lrl}"
    assert re.match(r"\$\\beta\$ & \$0\.\d+\^\{\+0\.\d+\}_\{-0\.\d+\}\$ & ", lines[4])

    up, slanted = np.array([0.0, 0.0, 1.0]), np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    alone, measured = fit.brdf(up, slanted), fit.predict(up, slanted)
    assert alone.shape == (3, 2)
    material = fit.result.model.material
    np.testing.assert_allclose(
        alone, merlfit.two_scale(fit.parameters, merlfit.Geometry.from_vectors(up, slanted), material)
    )
    assert np.all(measured < alone)

    with pytest.raises(ValueError, match="i should be unit vectors"):
        fit.brdf([0.0, 0.0, 2.0], slanted)
    with pytest.raises(merlfit.NoPicture, match="not sampled"):
        fit.to_arviz()
    with pytest.raises(merlfit.NoPicture, match="not sampled"):
        fit.plot_trace()
    left = fit.residuals()
    assert left.shape == (3, 90, 90, 180)
    values, valid = merlfit.read(file).values, np.isfinite(left)[0]
    found = error_metrics.errors(values, values - np.nan_to_num(left), valid, merl_grid())
    assert found.rmse == pytest.approx(fit.metrics.rmse, rel=1e-4)  # tables do for all directions, to 1e-5
    unsampled, fit = fit, merlfit.sample(fit)
    assert unsampled.result.posterior is None
    assert fit.result.posterior.steps == 20
    whole = fit.to_arviz()
    found = whole.posterior
    assert whole["sample_stats"]["log_likelihood"].shape == found["beta"].shape
    assert whole["walkers"]["z"].dims == ("chain", "draw", "coordinate")
    assert whole["observed_data"]["brdf"].shape == (3, 90, 90, 180)
    assert found.attrs["r_hat"] == fit.result.posterior.r_hat
    assert found["n"].dims == ("chain", "draw", "channel")
    assert found["beta"].shape[0] == 1
    assert list(found["channel"].values) == ["R", "G", "B"]
    drawn = chain_file(fit.result, fit.path)["values"][:, 0]
    assert np.isin(found["beta"].values, drawn).all()

    for name in PICTURES:
        figure = getattr(fit, f"plot_{name}")(tmp_path / f"{name}.png")
        assert figure.axes
        assert (tmp_path / f"{name}.png").stat().st_size > 15_000, name
    again = merlfit.load(fit.save(tmp_path / "saved"))
    assert again.path == fit.path == tmp_path / "saved" / f"{file.stem}.json"
    np.testing.assert_array_equal(again.to_arviz().posterior["beta"], found["beta"])
    text = fit.to_json(tmp_path / "kept.json")
    assert read_result(tmp_path / "kept.json") == fit.result
    assert merlfit.load(tmp_path / "kept.json").result == fit.result
    assert f'"material": "{file.stem}"' in text


def test_saving_replaces_no_better_result_and_leaves_no_chain_of_another(tmp_path):
    put_result(tmp_path / "old", posterior=True, chain="the old chain")
    put_result(tmp_path / "new")
    fit = merlfit.load(tmp_path / "new" / "nickel.json")
    with pytest.warns(UserWarning, match="stays as it was"):
        assert fit.save(tmp_path / "old") == tmp_path / "old" / "nickel.2" / "nickel.json"
    assert chain_of(tmp_path / "old" / "nickel.json").read_text() == "the old chain"
    put_result(tmp_path / "failed", succeeded=False, chain="the old chain")
    assert fit.save(tmp_path / "failed") == fit.path == tmp_path / "failed" / "nickel.json"
    assert [path.name for path in (tmp_path / "failed").iterdir()] == ["nickel.json"]
    before = fit.path.read_bytes()
    assert fit.save(tmp_path / "failed") == fit.path
    assert fit.path.read_bytes() == before


def with_draws(result, values):
    told = {"draws_sha1": sha1_of_draws(values, np.full(len(values), 0.2))}
    return result.model_copy(update={"posterior": result.posterior.model_copy(update=told)})


def test_saving_into_its_own_folder_replaces_nothing_that_is_more_complete(tmp_path):
    """Somebody sampled it since, or went on with its chain."""
    draws = {"names": [q.name for q in made().parameters], "values": np.full((5, 13), 0.2), "weights": np.full(5, 0.2)}
    first, then = (with_draws(made(posterior=True), values) for values in (np.ones((5, 13)), draws["values"]))
    for name, result in (("fit", made()), ("sampled", first)):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "nickel.json"
        write_result(path, result)
        fit = merlfit.load(path)
        write_result(path, then)
        np.savez(chain_of(path), **draws)
        with pytest.warns(UserWarning, match="stays as it was"):
            assert fit.save(path.parent) == path.parent / "nickel.2" / "nickel.json"
        assert read_result(path) == then
        assert chain_file(then, path)


def test_saving_into_its_own_folder_waits_for_no_command_and_leaves_the_chain_of_the_fit_alone(tmp_path):
    put_result(tmp_path)
    fit = merlfit.load(tmp_path / "nickel.json")
    with claimed(tmp_path), pytest.raises(merlfit.WriteError, match="another merlfit is writing there"):
        fit.save(tmp_path)
    free = layout_of(fit.result.model.measured).free(fit.parameters)
    for fit_free, kept in ((free, True), (free + 1, False)):
        np.savez(chain_of(fit.path), fit_free=fit_free)
        if not kept:
            fit.path.unlink()
        assert fit.save(tmp_path) == tmp_path / "nickel.json"
        assert chain_of(fit.path).exists() == kept


def test_a_result_without_a_folder_goes_with_its_fit(file):
    fit = merlfit.fit(file, settings=QUICK)
    folder = fit.path.parent
    assert fit.path.is_file()
    del fit
    assert not folder.exists()


def test_a_better_result_is_not_replaced(file, tmp_path):
    first = merlfit.fit(file, tmp_path / "out", settings=QUICK, posterior=True)
    with pytest.warns(UserWarning, match="stays as it was"):
        second = merlfit.fit(file, tmp_path / "out", settings=QUICK)
    assert second.path != first.path
    assert second.path.is_file()


def test_what_was_read_is_what_is_fitted(file, tmp_path):
    measurement = merlfit.read(file)
    half = dataclasses.replace(measurement, values=measurement.values / 2)
    one, other = (merlfit.fit(m, tmp_path / name, settings=QUICK) for m, name in ((measurement, "a"), (half, "b")))
    assert other.result.metrics.rmse < 0.9 * one.result.metrics.rmse


def test_settings_say_whether_to_sample(file, tmp_path, monkeypatch):
    asked = []

    def fit_file(measurement, out, config, report):
        asked.append(config.posterior.enabled)
        raise merlfit.MerlError("enough")

    monkeypatch.setattr(api, "fit_file", fit_file)
    sampled, plain = {**QUICK, "posterior": {"enabled": True}}, {**QUICK, "posterior": {"enabled": False}}
    for settings, posterior in ((QUICK, None), (None, None), (sampled, None), (sampled, False), (plain, True)):
        with pytest.raises(merlfit.MerlError, match="enough"):
            merlfit.fit(file, settings=settings, posterior=posterior)
    assert asked == [False, False, True, False, True]


def test_a_folder_that_cannot_be_made_is_named(file, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(merlfit.WriteError, match="taken/out: cannot be made"):
        merlfit.fit(file, tmp_path / "taken" / "out")


def test_too_few_scattered_directions_have_no_posterior_that_was_asked_for(tmp_path):
    table = tmp_path / "x.csv"
    table.write_text("theta_i_deg,theta_o_deg,phi_deg,R,G,B\n0,30,0,1,1,1\n30,30,180,1,1,1\n")
    fit = merlfit.fit(table, tmp_path, posterior=True)
    assert (fit.result.fit.status, fit.result.posterior) == ("NO_DATA", None)
    again = merlfit.fit(table, settings={"posterior": {"enabled": True}})
    assert (again.result.fit.status, again.result.posterior) == ("NO_DATA", None)


def test_arrays_are_a_table(tmp_path):
    """Of 29 samples, one fewer than a fit wants: the result says of what it is, whatever is in the arrays."""
    directions = {"theta_i_deg": np.full(29, 30.0), "theta_o_deg": np.linspace(0, 80, 29), "phi_deg": np.full(29, 180)}
    arrays = {**directions, "wavelengths_um": [0.5], "values": np.ones((29, 1))}
    fit = merlfit.fit(arrays, model="ggx")
    assert fit.status == "NO_DATA"
    assert fit.cost is None
    assert subject_of(fit.result, fit.path, fit._measured).scattered is not None, "no file is needed"
    source = merlfit.fit(arrays, tmp_path, model="ggx", name="copper").result.source
    assert (source.material, source.format, source.sha1) == ("copper", "table", fit.result.source.sha1)
    assert merlfit.fit({**arrays, "values": np.zeros((29, 1)) + 2}).result.source.sha1 != source.sha1


def test_bad_settings_and_failed_fits_are_told(file, tmp_path):
    with pytest.raises(merlfit.ConfigError, match=r"settings: unknown key 'fit\.start'"):
        merlfit.fit(file, settings={"fit": {"start": 2}})
    with pytest.raises(TypeError, match="boby"):
        merlfit.fit(file, settings=QUICK, boby="none")
    with pytest.raises(merlfit.MerlError, match="no such file"):
        merlfit.fit(tmp_path / "missing.binary", settings=QUICK)
    with pytest.raises(merlfit.ResultError, match="no such file"):
        merlfit.load(tmp_path / "missing.json")
