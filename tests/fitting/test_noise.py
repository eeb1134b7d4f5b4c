"""The precision that residuals leave, against what many draws of noise of a known covariance do to a linear fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from merlfit.fitting.fit import noise
from merlfit.fitting.fit.noise import noise_of, precision_of
from merlfit.fitting.fit.problem import energy
from merlfit.fitting.fit.scattered_errors import effective_count
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.scattered import ScatteredSamples, half_difference, order
from scipy.linalg import toeplitz

SHAPE = (3, 40, 12, 6)  # channels, and bins of three axes
LENGTHS = (3.0, 4.0, 20.0)  # of correlations, in bins
ALIKE = 0.8  # correlation of channels
ROOTS = [
    np.linalg.cholesky(toeplitz(0.5 ** (np.arange(n) / length))) for n, length in zip(SHAPE[1:], LENGTHS, strict=True)
]


def draw(rng, alike=ALIKE):
    """Noise of variance 1 that correlates along the axes and over the channels."""
    white = rng.normal(size=(4, *SHAPE[1:]))
    white = np.sqrt(alike) * white[3] + np.sqrt(1 - alike) * white[:3]
    return np.einsum("ha,db,pc,kabc->khdp", *ROOTS, white, optimize=True)


def rates():
    """Of a coordinate that all channels share, one of a narrow peak in all, and one of each channel, (5, ...)."""
    h, d, p = np.meshgrid(*(np.linspace(0, 1, n) for n in SHAPE[1:]), indexing="ij")
    found = np.zeros((5, *SHAPE))
    found[0] = 1 + h + 0 * p
    found[1] = np.exp(-((h / 0.05) ** 2)) * (1 + d)
    for channel in range(3):
        found[2 + channel, channel] = np.cos(2 * d)
    return found


def errors_of(jacobian, noises):
    """Of the least-squares fit of every noise, (N, P); and what it leaves of it."""
    flat = jacobian.reshape(len(jacobian), -1)
    found = np.linalg.lstsq(flat.T, np.stack(noises).reshape(len(noises), -1).T, rcond=None)[0].T
    return found, [noise - np.tensordot(error, jacobian, 1) for noise, error in zip(noises, found, strict=True)]


def test_deviations_of_shared_local_and_single_coordinates_are_those_of_many_fits():
    rng, jacobian = np.random.default_rng(1), rates()
    errors, left = errors_of(jacobian, [draw(rng) for _ in range(300)])
    known = [np.linalg.inv(precision_of(jacobian, r, np.ones(SHAPE, bool), np.inf)) for r in left[:30]]
    said = np.sqrt(np.median([np.diag(x) for x in known], 0))
    np.testing.assert_allclose(said, errors.std(0), rtol=0.2)
    equal = [np.sum(r**2) / r.size * np.linalg.inv(np.tensordot(jacobian, jacobian, [range(1, 5)] * 2)) for r in left]
    assert errors.std(0)[0] / np.sqrt(np.median(equal, 0)[0, 0]) > 4, "as if the bins were independent"


@pytest.mark.parametrize(
    ("count", "scans", "least"),
    [(3000, 0, 0.7), (304, 4, 0.8), (800, 0, 0.8), (300, 0, 0.7), (151, 1, 0.45)],
    ids=["hemisphere", "four scans", "larger cells", "largest cells", "one scan"],
)
def test_in_scattered_directions_deviations_are_those_of_many_fits_or_too_small_by_a_known_part(count, scans, least):
    """Noise is smooth over directions. Of few it is hardly seen to be (docs/statistics.md says so)."""
    rng = np.random.default_rng(6)
    if scans:  # in the plane of incidence
        theta_i = np.repeat(np.radians(np.linspace(20, 60, scans)), count // scans)
        turn = np.tile(np.radians(np.linspace(-75, 75, count // scans)), scans)
        theta_o, phi = np.abs(turn) + 1e-6, np.where(turn > 0, np.pi, 0.0)
    else:
        (theta_i, theta_o), phi = np.arccos(rng.uniform(0.3, 1, (2, count))), rng.uniform(0, np.pi, count)
    theta_h, theta_d, phi_d = half_difference(theta_i, theta_o, phi)
    rows = order(np.stack([np.sqrt(theta_h), theta_d, phi_d]))
    theta_i, theta_o, phi, theta_h, theta_d = (x[rows] for x in (theta_i, theta_o, phi, theta_h, theta_d))
    ones = np.ones((3, count))
    whole = ScatteredSamples(theta_h, theta_d, np.cos(theta_i), np.cos(theta_o), ones, ones, ones[0], MERL)
    alone = [np.cos(2 * theta_d) * (np.arange(3) == k)[:, None] for k in range(3)]
    jacobian = np.stack([(1 + theta_h) * ones, np.exp(-theta_h / 0.3) * ones, *alone])
    points, said = np.stack([theta_i, np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi)]), []
    errors, left = errors_of(jacobian, [0.1 * waves(rng, points / 0.2) for _ in range(60)])
    for one in left[:20]:
        samples = replace(whole, value=ones + one)
        unit = energy(samples)
        system = np.concatenate([jacobian, one[None]]).reshape(6, -1) / np.sqrt(unit)
        solution = SimpleNamespace(z=np.zeros(5), normal=(system @ system.T)[None], cost=np.sum(one**2) / unit)
        known = effective_count(samples, ones)
        found = noise_of(samples, ones, solution, known, lambda z, _: 1 + np.tensordot(z, jacobian, 1))
        said.append(np.diag(np.linalg.inv(found.precision)))
    times = np.sqrt(np.median(said, 0) / np.mean(errors**2, 0))
    assert np.all((times > least) & (times < 1.25)), times


def waves(rng, points):
    """A Gaussian field of variance 1 at points (3, N) whose unit is its length, alike in all channels, (3, N)."""
    at = np.einsum("kwa,an->kwn", rng.normal(size=(4, 100, 3)), points) + rng.uniform(0, 2 * np.pi, (4, 100, 1))
    fields = np.sqrt(2 / 100) * np.cos(at).sum(1)
    return np.sqrt(ALIKE) * fields[3] + np.sqrt(1 - ALIKE) * fields[:3]


def test_what_few_residuals_show_is_held_by_student_s_t_and_what_the_file_states():
    rng, jacobian, all_of_them = np.random.default_rng(2), rates(), np.ones(SHAPE, bool)
    _, (left,) = errors_of(jacobian, [draw(rng)])
    sure = precision_of(jacobian, left, all_of_them, np.inf)
    assert precision_of(jacobian, left, all_of_them, 10.0) == pytest.approx(sure / (1.8125 / 1.6449) ** 2, rel=1e-3)
    hessian = np.tensordot(jacobian, jacobian, [range(1, 5)] * 2)
    stated = precision_of(jacobian, 1e-6 * left, all_of_them, np.inf, floor=0.5)
    np.testing.assert_allclose(stated, hessian / 0.5, rtol=1e-6, atol=1e-6)


def test_a_coordinate_on_which_nothing_depends_is_the_prior_s_however_little_a_fit_leaves():
    rng, jacobian = np.random.default_rng(4), rates()
    jacobian[1] = 0
    _, (left,) = errors_of(jacobian[[0, 2, 3, 4]], [draw(rng)])
    for size in (1.0, 1e-8):
        precision = precision_of(jacobian, size * left, np.ones(SHAPE, bool), 20.0)
        assert np.all(precision[1] == 0)
        assert np.linalg.inv(precision + np.eye(5))[1, 1] == pytest.approx(1)


def test_few_large_residuals_widen_by_as_many_times_as_they_are_fewer(monkeypatch):
    """And no more: what a fit took from its noise is not found larger for them, until all is as wide as the prior."""
    rng = np.random.default_rng(5)
    h = np.linspace(0, np.pi, SHAPE[1])[:, None, None]
    jacobian = np.concatenate([rates(), [np.cos(k * h) * np.ones(SHAPE) for k in range(3, 12)]])
    spots = np.where(rng.uniform(size=SHAPE) < 0.01, 30.0, 1.0)
    _, (left,) = errors_of(jacobian, [spots * draw(rng)])
    squares = left**2
    fewer = squares.size * np.sum(squares**2) / (3 * squares.sum() ** 2)
    assert fewer > 5
    widened = np.linalg.inv(precision_of(jacobian, left, np.ones(SHAPE, bool), np.inf))
    monkeypatch.setattr(noise, "_concentration", lambda _: 1.0)
    plain = np.linalg.inv(precision_of(jacobian, left, np.ones(SHAPE, bool), np.inf))
    np.testing.assert_allclose(np.diag(widened) / np.diag(plain), fewer, rtol=1e-6)


def test_bins_that_do_not_count_say_nothing():
    rng, jacobian = np.random.default_rng(3), rates()
    _, (left,) = errors_of(jacobian, [draw(rng)])
    used = np.ones(SHAPE, bool)
    used[:, :, 6:] = False
    spoiled = np.where(used, left, 1e6)
    np.testing.assert_allclose(
        precision_of(np.where(used, jacobian, 1e6), spoiled, used, 20.0),
        precision_of(jacobian[:, :, :, :6], left[:, :, :6], used[:, :, :6], 20.0), rtol=0.02,
    )  # fmt: skip


def test_what_is_no_number_leaves_none():
    residual = np.full(SHAPE, np.nan)
    assert np.isnan(precision_of(rates(), residual, np.ones(SHAPE, bool), 10.0)).all()


def test_a_fit_that_leaves_nothing_is_certain():
    jacobian = rates()
    precision = precision_of(jacobian, np.zeros(SHAPE), np.ones(SHAPE, bool), 10.0)
    assert np.isfinite(precision).all()
    assert np.diag(precision).min() > 1e9
