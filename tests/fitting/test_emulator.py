"""The emulator against stand-ins in closed form."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.posterior import emulator as emulators
from merlfit.fitting.posterior.emulator import Emulator, coordinates_of

from tests.support.stand_ins import LAYOUT, OWN, banana, gentle, plain, trained

cost_at = jax.jit(emulators.cost_at)


def emulated(found, points):
    """Minus log L."""
    return found.scale * np.asarray(cost_at(points, found.channels))


def test_channels_depend_on_their_own_coordinates_and_on_the_shared_ones():
    names = LAYOUT.names
    found = [{names[i] for i in own} for own in coordinates_of(LAYOUT, np.full(LAYOUT.size, 0.3))]
    assert found[0] == {"beta", "p", "eta_R", "eta_G", "albedo_R"}  # eta is given that of the middle channel
    assert found[1] == {"beta", "p", "eta_G", "albedo_G"}


def test_it_is_exact_at_its_points_and_near_in_between():
    few, rng = gentle(), np.random.default_rng(1)
    points = rng.normal(size=(1000, LAYOUT.size))
    found = Emulator.of(few, LAYOUT, points)
    np.testing.assert_allclose(emulated(found, points), -few.log_likelihood(points), atol=0.05, rtol=1e-3)
    between = 0.7 * rng.normal(size=(1000, LAYOUT.size))
    error = emulated(found, between) + few.log_likelihood(between)
    assert np.std(error) < 0.05 * np.std(few.log_likelihood(between))
    assert np.median(np.abs(error)) < 0.2


def test_a_quadratic_polynomial_is_met_everywhere():
    few, rng = banana(), np.random.default_rng(2)
    found = trained(few, [np.arange(2)], rng.normal(size=(40, 2)))
    far = 5 * rng.normal(size=(100, 2))
    np.testing.assert_allclose(emulated(found, far), -few.log_likelihood(far), rtol=1e-4)


def test_its_gradient_is_finite_at_its_own_points():
    """Where the distance of the kernel is zero."""
    points = np.random.default_rng(3).normal(size=(60, 2))
    channels = trained(banana(), [np.arange(2)], points).channels
    slope = jax.jit(jax.grad(lambda z: jnp.sum(emulators.cost_at(z, channels))))(points)
    assert np.isfinite(slope).all()


def test_more_points_are_learnt_once_and_the_oldest_are_forgotten():
    few, rng = gentle(), np.random.default_rng(4)
    points = rng.normal(size=(100, LAYOUT.size))
    found = trained(few, OWN, points)
    assert len(found.with_points(few, points).points) == 100
    more = found.with_points(few, points[:40] + 1, 120)
    np.testing.assert_array_equal(more.points, np.concatenate([points[20:], points[:40] + 1]))
    np.testing.assert_array_equal(more.residuals.reshape(120, -1), few.weighed(more.points) - few.target)


def test_points_where_the_model_is_not_finite_are_left_out():
    few = gentle()
    hole = dataclasses.replace(few, weighed=lambda z: np.where(z[:, :1] > 1, np.nan, few.weighed(z)))
    points = np.random.default_rng(5).normal(size=(400, LAYOUT.size))
    found = Emulator.of(hole, LAYOUT, points)
    np.testing.assert_array_equal(found.points, points[points[:, 0] <= 1])
    assert np.isfinite(emulated(found, points)).all()


@pytest.mark.parametrize("count", [200, 600])
def test_idle_centres_and_components_are_idle(count, monkeypatch):
    few, rng = gentle(), np.random.default_rng(6)
    points, at = rng.normal(size=(count, LAYOUT.size)), rng.normal(size=(50, LAYOUT.size))
    padded = emulated(trained(few, OWN, points), at)
    monkeypatch.setattr(emulators, "ROUNDED", (1, 1))
    np.testing.assert_allclose(padded, emulated(trained(few, OWN, points), at), rtol=1e-9)


def test_distances_count_along_what_is_curved(monkeypatch):
    """Of five coordinates one is: an emulator that knows which errs by a fraction of one that does not."""
    rng = np.random.default_rng(7)
    few = plain(lambda z: np.stack([np.cos(2 * z[:, 0] + 0.5), z[:, 1] - z[:, 2]], 1), np.zeros(2), 2.0)
    points, at = rng.normal(size=(150, 5)), 0.7 * rng.normal(size=(300, 5))

    def error():
        return np.std(emulated(trained(few, [np.arange(5)], points), at) + few.log_likelihood(at))

    with_axes = error()
    monkeypatch.setattr(emulators, "_stretched", lambda x, known: np.eye(x.shape[1]))
    assert with_axes < error() / 2


def test_residuals_that_are_straight_have_no_axes():
    few = plain(lambda z: z @ np.array([[1.0, 0.5], [0.0, 2.0]]), np.zeros(2), 2.0)
    rng = np.random.default_rng(8)
    points, at = rng.normal(size=(2, 40, 2))
    for known in (few.weighed(points), np.ones((40, 2)), np.zeros((40, 2))):
        stretch = emulators._stretched(points, known)
        np.testing.assert_allclose(stretch @ stretch.T, emulators.STRAIGHT * np.eye(2), atol=1e-6)
    np.testing.assert_allclose(emulated(trained(few, [np.arange(2)], points), at), -few.log_likelihood(at), atol=1e-6)
