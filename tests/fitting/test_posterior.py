"""The sampler's parts against what is known of them in closed form."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.posterior import chain as sampler
from merlfit.fitting.posterior import diagnosis, sampling
from merlfit.fitting.posterior.chain import (
    WALKERS,
    Chain,
    ChainError,
    begin,
    extend,
    read_chain,
    spread_over,
    write_chain,
)
from merlfit.fitting.posterior.diagnosis import ENOUGH, SHORTEST, diagnose
from merlfit.fitting.posterior.emulator import Emulator, coordinates_of, log_posterior
from merlfit.fitting.posterior.hamiltonian import SOFTENED, Hamiltonian, leapfrog
from merlfit.model.measured import Measured
from merlfit.model.registry import made as made_model
from scipy.optimize import minimize

from tests.support.stand_ins import LAYOUT, banana, gentle, trained, uncorrelated

LOOK = 25  # steps between looks, where only that counts what is done at them
NOBODY = np.random.RandomState(0).get_state()[1:]


def silent(*_):
    """Progress of no interest."""


def test_directions_without_data_are_held_by_the_prior():
    normal = np.zeros((2, 3, 3))
    normal[0, 0, 0] = 4.0
    covariance = uncorrelated(normal, 0.5, 10.0).covariance
    assert covariance[0, 0] == pytest.approx(1 / (10 * 4.0 / 0.5 + 1))
    assert covariance[1, 1] == pytest.approx(1)


def moments(log_density):
    """Mean and covariance of a density in two coordinates, by quadrature."""
    axis = np.linspace(-5, 8, 521)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    found = log_density(points)
    weight = np.exp(found - found.max())
    weight /= weight.sum()
    mean = weight @ points
    return mean, (points - mean).T @ ((points - mean) * weight[:, None])


def rough():
    """An emulator of `banana` that learnt from too few points, seen through noise."""
    few, rng = banana(), np.random.default_rng(1)
    noisy = dataclasses.replace(few, weighed=lambda z: few.weighed(z) + 0.2 * rng.normal(size=(len(z), 2)))
    return trained(noisy, [np.arange(2)], rng.normal(size=(30, 2)) * [1.0, 1.5])


ROOT = np.array([[0.8, 0.0], [0.3, 1.1]])


def emulated(emulator, temperature=1.0):
    """Its log posterior."""
    return lambda z: log_posterior(z, emulator.channels, emulator.scale / temperature)


@pytest.mark.slow
def test_led_moves_leave_the_target_as_it_is_however_rough_the_emulator():
    few, emulator = banana(), rough()
    mean, covariance = moments(few.log_posterior)
    misled, _ = moments(lambda z: np.asarray(emulated(emulator)(jnp.asarray(z))))
    assert np.max(np.abs(misled - mean)) > 0.1  # what the emulator alone would make of it
    rng = np.random.default_rng(2)
    move = emcee.moves.MHMove(Hamiltonian(emulator, np.linalg.cholesky(covariance), 0.2))
    walkers = emcee.EnsembleSampler(WALKERS, 2, few.log_posterior, moves=move, vectorize=True)
    walkers.random_state = np.random.RandomState(3).get_state()
    walkers.run_mcmc(rng.multivariate_normal(mean, covariance, size=WALKERS), 8000)
    found = walkers.get_chain(discard=200, flat=True)
    assert 0.2 < walkers.acceptance_fraction.mean() < 0.95  # some are refused: the ratio is at work
    deviation = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(found.mean(0) - mean) < 0.04 * deviation)
    np.testing.assert_allclose(found.std(0), deviation, rtol=0.04)
    assert np.cov(found.T)[0, 1] == pytest.approx(covariance[0, 1], abs=0.04 * np.prod(deviation))


def test_a_led_walker_that_turns_comes_back():
    density, rng = emulated(rough()), np.random.default_rng(4)
    points, momenta = jnp.asarray(rng.normal(size=(2, 20, 2)))
    there, turned = leapfrog(density, jnp.asarray(ROOT), points, momenta, 7, 0.15)
    assert np.all(np.linalg.norm(there - points, axis=1) > 1e-2)
    back, again = leapfrog(density, jnp.asarray(ROOT), there, -turned, 7, 0.15)
    np.testing.assert_allclose(back, points, atol=1e-8)
    np.testing.assert_allclose(-again, momenta, atol=1e-8)


def test_led_moves_keep_volumes():
    """In coordinates and momenta together, so that only their densities decide."""
    density = emulated(rough())

    def move(x):
        z, p = leapfrog(density, jnp.asarray(ROOT), x[None, :2], x[None, 2:], 7, 0.15)
        return jnp.concatenate([z[0], p[0]])

    for x in np.random.default_rng(5).normal(size=(5, 4)):
        assert abs(np.linalg.det(jax.jacfwd(move)(jnp.asarray(x)))) == pytest.approx(1, abs=1e-8)


def test_led_moves_of_a_good_emulator_are_accepted_and_go_far():
    emulator, rng = trained(banana(), [np.arange(2)], np.random.default_rng(1).normal(size=(40, 2))), None
    few, rng = banana(), np.random.default_rng(6)
    mean, covariance = moments(few.log_posterior)
    points = rng.multivariate_normal(mean, covariance / 4, size=500)
    new, log_ratio = Hamiltonian(emulator, np.linalg.cholesky(covariance), 0.2)(points, np.random.RandomState(7))
    accepted = np.minimum(np.exp(few.log_posterior(new) - few.log_posterior(points) + log_ratio), 1)
    assert accepted.mean() > 0.8
    assert np.mean(np.any(new != points, axis=1)) > 0.8
    assert np.median(np.linalg.norm((new - points) / np.sqrt(np.diag(covariance)), axis=1)) > 0.5


def test_the_ratio_of_a_led_move_is_that_of_the_posterior_that_leads_it():
    emulator, rng = rough(), np.random.default_rng(9)
    points = rng.normal(size=(20, 2))
    new, log_ratio = Hamiltonian(emulator, ROOT, 0.15, temperature=2.0)(points, np.random.RandomState(10))
    density = emulated(emulator, temperature=2 * SOFTENED)
    np.testing.assert_allclose(log_ratio, density(jnp.asarray(points)) - density(jnp.asarray(new)), atol=1e-8)
    assert np.any(log_ratio != 0)


def test_walkers_led_astray_stay_where_they_are():
    few = banana()
    emulator = trained(few, [np.arange(2)], np.random.default_rng(1).normal(size=(40, 2)))
    points = np.array([[0.0, 0.0], [1e200, 0.0]])
    new, log_ratio = Hamiltonian(emulator, np.eye(2), 0.15)(points, np.random.RandomState(8))
    assert np.isfinite(log_ratio[0])
    assert log_ratio[1] == -np.inf
    np.testing.assert_array_equal(new[1], points[1])


def independent(steps, size=3, seed=0):
    """A chain of independent draws from the normal distribution."""
    states = np.random.default_rng(seed).normal(size=(steps, WALKERS, size))
    return Chain(states, -np.sum(states**2, -1) / 2, 0.0, np.eye(size), 0.15, states[0], NOBODY, np.zeros(size))


def test_a_chain_of_independent_draws_is_good_enough():
    found = diagnose(independent(SHORTEST).states)
    assert found.failures() == []
    np.testing.assert_allclose(found.times, 1, atol=0.3)
    np.testing.assert_allclose(found.bulk, SHORTEST * WALKERS, rtol=0.15)


def test_what_a_chain_lacks_is_said_of_the_coordinate_that_lacks_it():
    names = ("a", "b", "c")
    assert f"{ENOUGH} are needed" in diagnose(independent(SHORTEST - 1).states).failures(names)[0]
    slow = independent(400)
    slow.states[..., 1] = np.cumsum(slow.states[..., 1], 0)  # a random walk
    said = diagnose(slow.states).failures(names)
    assert said[0].startswith("400 steps are ")
    assert said[0].endswith(f" autocorrelation times, {ENOUGH} are needed")
    assert any("R-hat of b" in x for x in said)
    assert not any("of a" in x or "of c" in x for x in said)
    apart = independent(400)
    apart.states[:, :6, 2] += 8  # walkers in a mode of their own: each looks well by itself
    assert any("R-hat of c" in x for x in diagnose(apart.states).failures(names))
    stuck = independent(400)
    stuck.states[:, 5] = 1.0  # one walker
    assert diagnose(stuck.states).failures(names)[0].startswith("400 steps are 1 autocorrelation times")


def test_places_cover_a_sequence_however_many_they_are():
    for count in (7, 50, 400):
        found = spread_over(1000, count)
        assert len(found) == count
        assert found.min() >= 0
        assert found.max() < 1000
        assert np.max(np.diff(np.sort(np.concatenate([[0], found, [1000]])))) < 3.5 * 1000 / count
    np.testing.assert_array_equal(np.concatenate([spread_over(1000, 30), spread_over(1000, 80, 30)]),
                                  spread_over(1000, 80))  # fmt: skip


@cache
def begun():
    """A stand-in, its maximum, and a chain and an emulator of it."""
    few = gentle()
    best = minimize(lambda z: -few.log_posterior(z[None])[0], np.zeros(LAYOUT.size))
    return few, best.x, *begin(few, LAYOUT, best.x, best.hess_inv, 3, silent)


def test_a_chain_begun_has_its_walkers_where_the_posterior_is(monkeypatch):
    few, fit, chain, emulator = begun()
    assert chain.states.shape == (1, WALKERS, LAYOUT.size)
    np.testing.assert_allclose(chain.log_prob[0], few.log_posterior(chain.states[0]))
    np.testing.assert_array_equal(chain.training_points, emulator.points)
    np.testing.assert_array_equal(chain.fit, fit)
    lowest = few.log_posterior(fit[None])[0]
    assert np.all(chain.log_prob[0] > lowest - 25)
    monkeypatch.setattr(diagnosis, "ENOUGH", 10)
    done = extend(chain, few, LAYOUT, emulator, 1001, silent, silent)
    assert diagnose(done.states).failures() == []
    assert 0.2 < done.acceptance < 1


def test_a_model_of_many_parameters_has_two_walkers_for_each():
    layout = layout_of(Measured(made_model("sgd", {})))
    assert layout.size > WALKERS // 2
    few = gentle(1, coordinates_of(layout, np.zeros(layout.size)))
    chain, emulator = begin(few, layout, np.zeros(layout.size), 0.05 * np.eye(layout.size), 3, silent)
    assert chain.states.shape == (1, 2 * layout.size, layout.size)
    done = extend(chain, few, layout, emulator, 21, silent, silent)
    assert np.ptp(done.states, axis=0).min() > 0


def test_a_chain_that_is_long_enough_goes_on_to_the_steps_that_are_asked_for(monkeypatch):
    few, _, chain, emulator = begun()
    monkeypatch.setattr(sampler, "CHECK_EVERY", LOOK)
    monkeypatch.setattr(diagnosis.Diagnosis, "failures", lambda self, names=(): [])
    assert len(extend(chain, few, LAYOUT, emulator, 1001, silent, silent).states) == 1
    assert len(extend(chain, few, LAYOUT, emulator, 1001, silent, silent, 1 + LOOK).states) == 1 + LOOK
    assert len(extend(chain, few, LAYOUT, emulator, LOOK, silent, silent, 1001).states) == LOOK


def test_a_chain_goes_on_while_its_weighted_draws_want_more_steps(tmp_path, monkeypatch):
    """As many as are wanted, and no more than there may be; without beginning anew."""
    asked, wanted = [], iter([500, 9000, 9000])
    whole = Chain(np.zeros((1, 2, 1)), np.zeros((1, 2)), 0.0, np.eye(1), 0.1, np.zeros((1, 1)), NOBODY, np.zeros(1), 5)

    def extended(chain, few, layout, emulator, max_steps, say, keep, least):
        asked.append((least, chain.retrainings))
        steps = min(max(least, 100), max_steps)
        return dataclasses.replace(chain, states=np.zeros((steps, 2, 1)), log_prob=np.zeros((steps, 2)))

    nothing = SimpleNamespace(log_likelihood=None)
    for name, found in {
        "stand_in": nothing, "begin": (whole, None), "make_problem": None, "likelihood_of_all": None,
    }.items():  # fmt: skip
        monkeypatch.setattr(sampling, name, lambda *_, found=found, **__: found)
    monkeypatch.setattr(sampling, "extend", extended)
    monkeypatch.setattr(sampling, "correct", lambda chain, *_: SimpleNamespace(chain=chain, wanted=next(wanted)))
    solution = SimpleNamespace(z=np.zeros(1), normal=None, cost=1.0)
    fitted = SimpleNamespace(layout=LAYOUT, solution=solution, noise=SimpleNamespace(covariance=None))
    found = sampling.draw(fitted, None, 6000, 0, tmp_path / "x.npz")
    assert asked == [(0, 5), (500, 0), (9000, 0)]
    assert len(found.chain.states) == 6000


def test_the_emulator_learns_from_farther_than_the_posterior_goes():
    few, _, chain, emulator = begun()
    flat = extend(chain, few, LAYOUT, emulator, 501, silent, silent).states.reshape(-1, LAYOUT.size)
    wider = np.cov(emulator.points.T) @ np.linalg.inv(np.cov(flat.T))
    assert np.linalg.det(wider) ** (1 / LAYOUT.size) > 2  # in the variance of a coordinate; without temperature 1.18
    held = few.log_posterior(flat) - np.asarray(emulated(emulator)(jnp.asarray(flat)))
    assert np.quantile(held - np.median(held), 0.999) < 0.3


def test_a_chain_gone_on_with_is_bit_for_bit_one_that_was_not_interrupted(tmp_path, monkeypatch):
    monkeypatch.setattr(diagnosis, "ENOUGH", np.inf)
    monkeypatch.setattr(sampler, "CHECK_EVERY", LOOK)
    few, fit, chain, emulator = begun()
    kept = []
    whole = extend(chain, few, LAYOUT, emulator, 1 + 2 * LOOK, silent, kept.append)
    assert [len(c.states) for c in kept] == [1 + LOOK, 1 + 2 * LOOK]
    half = extend(chain, few, LAYOUT, emulator, 1 + LOOK, silent, silent)
    write_chain(tmp_path / "x.npz", half.arrays())
    again = read_chain(tmp_path / "x.npz", fit)
    assert again.random[1:] == half.random[1:]
    for name, array in again.arrays().items():
        np.testing.assert_array_equal(array, half.arrays()[name])
    other = extend(again, few, LAYOUT, Emulator.of(few, LAYOUT, again.training_points), 1 + 2 * LOOK, silent, silent)
    np.testing.assert_array_equal(other.states, whole.states)
    np.testing.assert_array_equal(other.log_prob, whole.log_prob)
    assert other.accepted == pytest.approx(whole.accepted)


def test_what_a_chain_still_needs_is_told_by_the_worst_of_its_measures():
    one = np.ones(2)
    fine = diagnosis.Diagnosis(200, 3 * one, 1.01 * one, 900 * one, 800 * one)
    assert fine.needed == pytest.approx(150)  # 50 autocorrelation times of 3 steps
    assert not fine.slow
    for worse, needed in (
        ({"times": np.array([3.0, 20.0])}, 1000), ({"bulk": np.array([900.0, 50.0])}, 1600), ({"tail": 20 * one}, 4000),
        ({"r_hat": np.array([1.01, 1.2])}, 800),
    ):  # fmt: skip
        found = dataclasses.replace(fine, **worse)
        assert found.needed == pytest.approx(needed)
        assert found.slow == (needed > 200 + diagnosis.SOON)
    late = dataclasses.replace(fine, steps=2000, times=70 * one)
    assert (late.needed, late.slow) == (pytest.approx(3500), False)  # less than it has made
    for name in ("times", "r_hat", "bulk", "tail"):
        assert dataclasses.replace(fine, **{name: np.array([1.0, np.nan])}).slow


def test_a_late_chain_does_not_begin_anew(monkeypatch):
    monkeypatch.setattr(diagnosis, "ENOUGH", np.inf)
    monkeypatch.setattr(sampler, "TOO_LOW", -1e9)
    monkeypatch.setattr(sampler, "CHECK_EVERY", LOOK)
    few, _, chain, emulator = begun()
    monkeypatch.setattr(sampler, "EARLY", LOOK / (1 + 2 * LOOK))
    done = extend(chain, few, LAYOUT, emulator, 1 + 2 * LOOK, silent, silent)
    assert (len(done.states), done.retrainings) == (1 + 2 * LOOK, sampler.RETRAININGS)


def test_where_the_emulator_is_too_low_it_learns_and_the_chain_begins_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(diagnosis, "ENOUGH", np.inf)
    monkeypatch.setattr(sampler, "EARLY", 1.0)
    monkeypatch.setattr(sampler, "TOO_LOW", 1.0)
    monkeypatch.setattr(sampler, "CHECK_EVERY", LOOK)
    few, fit, chain, emulator = begun()
    of, kept = Emulator.of, []

    def sharp(*arguments):  # tails too low, whatever it learns
        return dataclasses.replace(of(*arguments), scale=3 * few.scale)

    def go_on(chain, steps, keep=silent):
        with np.errstate(invalid="ignore"):  # a walker that stays where it is for a whole look
            return extend(chain, few, LAYOUT, sharp(few, LAYOUT, chain.training_points), steps, silent, keep)

    monkeypatch.setattr(sampler.Emulator, "of", sharp)
    done = go_on(chain, 1 + 3 * LOOK, kept.append)
    assert [len(c.states) for c in kept] == [1] * sampler.RETRAININGS + [1 + LOOK, 1 + 2 * LOOK, 1 + 3 * LOOK]
    assert not set(map(tuple, emulator.points)) >= set(map(tuple, done.training_points))
    np.testing.assert_array_equal(done.training_points, kept[sampler.RETRAININGS - 1].training_points)
    write_chain(tmp_path / "x.npz", kept[1].arrays())  # interrupted between two of them
    again = go_on(read_chain(tmp_path / "x.npz", fit), 1 + 3 * LOOK)
    np.testing.assert_array_equal(again.states, done.states)
    longer = go_on(done, 1 + 4 * LOOK)
    np.testing.assert_array_equal(longer.states[: 1 + 3 * LOOK], done.states)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # numpy leaves damaged files open
def test_the_chain_of_another_fit_and_files_that_are_none_are_refused(tmp_path):
    path, chain = tmp_path / "x.npz", independent(3)
    write_chain(path, chain.arrays())
    read_chain(path, chain.fit)
    for fit in (chain.fit + 0.1, np.zeros(4)):
        with pytest.raises(ChainError, match=r"x\.npz: is the chain of another fit"):
            read_chain(path, fit)
    whole = path.read_bytes()
    spoiled = whole[: len(whole) // 4] + bytes(200) + whole[len(whole) // 4 + 200 :]
    for bad in (whole[: len(whole) // 2], whole[:50], b"not a file of numpy", spoiled):
        path.write_bytes(bad)
        with pytest.raises(ChainError, match=r"x\.npz: cannot be continued \(.*\); delete it to start a new chain"):
            read_chain(path, chain.fit)
    for name in chain.arrays():
        write_chain(path, {k: x for k, x in chain.arrays().items() if k != name})
        with pytest.raises(ChainError, match="cannot be continued"):
            read_chain(path, chain.fit)
    with pytest.raises(ChainError, match=r"absent\.npz"):
        read_chain(tmp_path / "absent.npz", chain.fit)


@pytest.mark.parametrize(
    ("name", "array"),
    [("log_prob", np.ones((2, 2))), ("random_state", np.full(3, np.inf)), ("leap", np.ones(1)), ("root", np.eye(2)),
     ("accepted", np.array("half")), ("training_points", np.zeros((4, 3), complex))],
)  # fmt: skip
def test_a_chain_with_an_array_of_another_kind_is_refused(name, array, tmp_path):
    path, chain = tmp_path / "x.npz", independent(3)
    write_chain(path, chain.arrays() | {name: array})
    with pytest.raises(ChainError, match="it is damaged, or no chain"):
        read_chain(path, chain.fit)


def test_an_empty_file_is_refused(tmp_path):
    path = tmp_path / "x.npz"
    path.touch()
    with pytest.raises(ChainError):
        read_chain(path, np.zeros(3))
