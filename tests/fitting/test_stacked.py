"""A batch of materials ends where each of them ends by itself; on the last of JAX's devices, whatever that is."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import typer
from merlfit.fitting.batch.gpu import Gpu
from merlfit.fitting.batch.here import Here
from merlfit.fitting.batch.unit import Unit, fit_unit
from merlfit.fitting.commands.fit import device_of
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.stacked import Start, joined, solve_stacked, stack
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import run, search, together
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.results.manifest import Ending
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.settings.config import parse
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.merl_io.binary import Measurement, read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import thin
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

from tests.support.command import call

pytestmark = pytest.mark.usefixtures("compiled_quickly")
LAYOUTS = [
    layout_of(Measured(TwoScale("lambert", "off"))),
    layout_of(Measured(TwoScale("lambert", "off", index="complex"))),
]
FEWER_THAN_STARTS = 2  # solves at once: the others wait


def measured(seed):
    """Synthetic: a random material of the model itself, 5 % of noise; the free coordinates it was made of."""
    grid, rng, layout = merl_grid(), np.random.default_rng(seed), LAYOUTS[0]
    blank = Measurement(Path("synthetic"), np.ones((3, *grid.above.shape)), grid.above, 0, 0, 0, "", "")
    z = rng.normal(size=layout.size) / 2
    half = run.predict_samples(layout, z, weighted_samples(blank))
    values = np.concatenate([half, half[..., ::-1]], -1)
    values = values * np.exp(0.05 * rng.normal(size=values.shape))
    return replace(blank, values=np.where(grid.above, values, 0.0)), z


def stacked(problems):
    return stack([joined(q) for q in problems], jax.devices()[-1])


@pytest.fixture(scope="module")
def three():
    """Problems of three materials, and starts: near the truth, farther, far from it, and of another kind."""
    made = [measured(seed) for seed in (1, 2, 3)]
    problems = [make_problem(thin(weighted_samples(m), (10, 10, 18))) for m, _ in made]
    starts = [Start(0, k, z + away) for k, ((_, z), away) in enumerate(zip(made, (0.01, 0.3, 1.0), strict=True))]
    return problems, [*starts, *(Start(1, k, np.zeros(LAYOUTS[1].size)) for k in (2, 0))]


def test_each_ends_where_it_ends_by_itself(three):
    problems, starts = three
    held = stacked(problems)
    together = solve_stacked(LAYOUTS, held, starts, 60, at_once=FEWER_THAN_STARTS * held.size)
    alone = [solve(Objective(LAYOUTS[s.kind], problems[s.material]), s.z, 60) for s in starts]
    assert held.root.devices() == {jax.devices()[-1]}
    for one, other in zip(together, alone, strict=True):
        assert one.cost == pytest.approx(other.cost, rel=1e-6)
        np.testing.assert_allclose(one.z, other.z, atol=1e-5)
        np.testing.assert_allclose(one.normal, other.normal, rtol=1e-5, atol=1e-9)
        assert (one.steps, one.converged) == (other.steps, other.converged)
        assert one.offset == pytest.approx(other.offset, abs=1e-5)
    assert len({s.steps for s in together}) > 2
    assert {s.z.shape for s in together} == {(LAYOUTS[0].size,), (LAYOUTS[1].size,)}


def test_a_step_limit_holds_for_each(three):
    problems, starts = three
    held, limit = stacked(problems), 5
    whole = solve_stacked(LAYOUTS, held, starts, 60, at_once=FEWER_THAN_STARTS * held.size)
    stopped = solve_stacked(LAYOUTS, held, starts, limit, at_once=FEWER_THAN_STARTS * held.size)
    assert [s.steps for s in stopped] == [min(limit, s.steps) for s in whole]
    assert [s.converged for s in stopped] == [s.steps <= limit for s in whole]
    assert any(s.converged for s in stopped)
    for k in (k for k, s in enumerate(stopped) if s.converged):
        np.testing.assert_array_equal(stopped[k].z, whole[k].z)
        np.testing.assert_array_equal(stopped[k].normal, whole[k].normal)


def test_one_that_is_not_finite_does_not_spoil_the_others(three):
    problems, starts = three
    spoiled = stacked([problems[0], eqx.tree_at(lambda q: q.rest, problems[1], jnp.full(3, jnp.nan)), problems[2]])
    found = solve_stacked(LAYOUTS, spoiled, starts, 60, at_once=FEWER_THAN_STARTS * spoiled.size)
    whole = solve_stacked(LAYOUTS, stacked(problems), starts, 60, at_once=FEWER_THAN_STARTS * spoiled.size)
    assert np.isnan(found[1].cost)
    assert (found[1].converged, found[1].steps) == (False, 1)
    np.testing.assert_array_equal(found[1].z, starts[1].z)
    others = [k for k in range(len(starts)) if k != 1]
    assert [found[k].cost for k in others] == pytest.approx([whole[k].cost for k in others], rel=1e-9)


def test_materials_must_share_their_directions(three):
    problems, _ = three
    other = make_problem(thin(weighted_samples(measured(1)[0]), (10, 5, 18)))
    with pytest.raises(ValueError, match="share their directions"):
        stacked([problems[0], other])


def test_kinds_must_share_what_is_compiled(three):
    problems, starts = three
    other = layout_of(Measured(TwoScale("lambert", "off", masking="none")))
    with pytest.raises(ValueError, match="one general model"):
        solve_stacked([LAYOUTS[0], other], stacked(problems), starts)


def quick():
    """Settings of a fit of a second: two kinds, few bins."""
    settings = {"grid": "coarse", "azimuths": 4, "starts": 2, "coarse_steps": 40}
    effects = {"preset": "microfacet", "body": "lambert"}
    return parse({"fit": settings, "effects": effects, "posterior": {"enabled": False}}, "test")


def test_whole_fits_are_those_of_single_files():
    config = quick()
    files = [weighted_samples(measured(seed)[0]) for seed in (4, 5)]
    layouts = [layout_for(config, model) for model in candidates(config)]
    assert len(layouts) == 2
    ready = [together.prepare(samples, config) for samples in files]
    found = together.fit_together(ready, config, jax.devices()[-1], 1)
    for samples, each in zip(files, found, strict=True):
        rough = [search.searched_for(layout) for layout in layouts]
        coarse = search.fit_coarse(rough, start_hints(samples), *search.make_coarse(samples), config)
        tried = [*map(search.Searched, layouts, rough, coarse)]
        compared, chosen = run.compare(tried, search.thinned(samples, search.COARSE))
        problem = make_problem(thin(samples, search.COARSE), 4)
        alone = solve(Objective(layouts[chosen], problem), coarse[chosen].z, config.fit.max_steps)
        assert each.layout == layouts[chosen]
        assert [c.cost for c in each.candidates] == pytest.approx([c.cost for c in compared], rel=1e-6)
        assert (each.solution.steps, each.solution.converged) == (alone.steps, alone.converged)
        assert each.solution.cost == pytest.approx(alone.cost, rel=1e-6)
        np.testing.assert_allclose(each.solution.z, alone.z, atol=1e-4)


def test_results_are_those_of_single_files(tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")  # which `Gpu` sets for its workers
    paths = [tmp_path / f"{name}.binary" for name in ("four", "none", "five")]
    for path, seed in ((paths[0], 4), (paths[2], 5)):
        write(path, measured(seed)[0].values)
    paths[1].write_bytes(b"none")
    for folder in ("out", "alone"):
        (tmp_path / folder).mkdir()
    units = [Unit(path, tmp_path / "out", quick()) for path in paths]
    told = []
    executor = Gpu(jax.devices()[-1], Here(), at_once=1)
    found = dict(executor.ended(units, lambda k, stage: told.append((k, stage))))
    assert sorted(found) == [0, 1, 2]
    assert (found[1].kind, found[1].result) == (Ending.BAD_INPUT, None)
    assert str(paths[1]) in found[1].error
    assert any(k == 2 and stage.startswith("together with 1 others") for k, stage in told)
    for k in (0, 2):
        one, other = found[k].result, fit_unit(replace(units[k], out=tmp_path / "alone")).result
        assert read_result(tmp_path / "out" / f"{paths[k].stem}.json").fit == one.fit
        assert "together" in one.seconds
        assert "coarse" not in one.seconds
        assert one.seconds["total"] >= one.seconds["together"]
        assert (one.fit.status, one.fit.steps) == (other.fit.status, other.fit.steps)
        assert one.model.settings == other.model.settings
        assert one.fit.cost == pytest.approx(other.fit.cost, rel=1e-6)
        assert [c.variant for c in one.fit.candidates] == [c.variant for c in other.fit.candidates]
        assert [p.value for p in one.parameters] == pytest.approx([p.value for p in other.parameters], rel=1e-5)


def test_a_fit_of_another_file_is_ignored(tmp_path):
    path = tmp_path / "five.binary"
    write(path, measured(5)[0].values)
    config = quick()
    material = together.prepare(weighted_samples(read(path)), config, read(path).sha1)
    (found,) = together.fit_together([material], config, jax.devices()[-1], 1)
    other = fit_unit(Unit(path, tmp_path, config, found=found._replace(sha1="0" * 40))).result
    assert "coarse" in other.seconds


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--device", "gpu"], "JAX finds no GPU here, only cpu"),
        (["--device", "tpu"], "is neither gpu nor cpu"),
    ],
)
def test_a_device_that_is_not_there_is_named(tmp_path, words, said):
    ended = call("fit", tmp_path / "none.binary", *words)
    assert ended.exit_code == BAD_INPUT
    assert said in ended.output


@pytest.mark.parametrize(
    ("settings", "others", "said"),
    [
        ({"model": {"name": "auto"}}, [], "model auto"),
        ({"fit": {"weights": "log"}}, [], "weights log"),
        ({}, ["--accuracy"], "--accuracy"),
    ],
)
def test_what_is_not_offered_together_is_said(settings, others, said, monkeypatch, capsys):
    monkeypatch.setattr(jax, "devices", lambda asked=None: [None])
    with pytest.raises(typer.Exit):
        device_of("gpu", parse(settings, "test"), *others)
    assert f"not offered with {said}" in " ".join(capsys.readouterr().err.split())
