"""The trust region's parts against what defines them, and the whole on problems with known ends."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from merlfit.fitting.fit.trust_region import FIRST_RADIUS, BoundedStep, Radius, TrustRegion


def linear(residual, jacobian):
    """A linear model as optimistix hands it over."""
    return SimpleNamespace(
        residual=jnp.asarray(residual),
        jac=lx.MatrixLinearOperator(jnp.asarray(jacobian)),
        as_min=lambda: jnp.sum(jnp.asarray(residual) ** 2) / 2,
    )


@jax.jit
def _step(residual, jacobian, radius):
    descent = BoundedStep()
    state = descent.init(jnp.zeros(jacobian.shape[1]), None)
    found, result = descent.step(radius, descent.query(None, linear(residual, jacobian), state))
    return found, result == optx.RESULTS.successful


def step(residual, jacobian, radius):
    found, successful = _step(residual, jacobian, radius)
    assert successful
    return np.asarray(found)


@pytest.mark.parametrize("radius", [1e-6, 1e-2, 1.0, 100.0])
@pytest.mark.parametrize("condition", [1.0, 1e4, 1e9])
def test_a_step_is_the_best_one_of_the_ball(radius, condition):
    rng = np.random.default_rng(3)
    jacobian = rng.standard_normal((9, 6)) @ np.diag(np.geomspace(1, 1 / condition, 6))
    residual = rng.standard_normal(9)
    found = step(residual, jacobian, radius)
    newton = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    if np.linalg.norm(newton) <= radius:
        np.testing.assert_allclose(found, newton, rtol=1e-6, atol=1e-9 * np.linalg.norm(newton))
        return
    assert np.linalg.norm(found) == pytest.approx(radius, rel=1e-6)
    gradient = jacobian.T @ (residual + jacobian @ found)  # must point straight into the ball: -mu times the step
    mu = -gradient @ found / radius**2
    assert mu > 0
    np.testing.assert_allclose(gradient, -mu * found, atol=1e-5 * mu * radius)


def test_directions_without_effect_are_not_gone_along():
    jacobian = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(step(np.array([3.0, 1.0, 0.0]), jacobian, 100.0), [-3.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(step(np.array([0.0, 1.0, 0.0]), jacobian, 1.0), [0.0, 0.0])


@pytest.mark.parametrize(
    ("gained", "radius", "accepted"),
    [(0.9, 2.0, True), (0.5, 1.0, True), (0.1, 0.5, True), (-0.1, 0.25, False), (-np.inf, 0.25, False)],
)
def test_the_radius_follows_what_was_gained_of_what_was_promised(gained, radius, accepted):
    assert float(Radius().init(jnp.zeros(1), None)) == FIRST_RADIUS
    length, yes, state = _radius(False, 1.0, 0.5 - gained / 2)
    assert (float(length), float(state), bool(yes)) == (radius, radius, accepted)
    length, yes, _ = _radius(True, 0.0, 0.5)
    assert (float(length), bool(yes)) == (FIRST_RADIUS, True)


@jax.jit
def _radius(first, went, cost):
    """Length, whether the step is taken, and state after a step of which all of the cost, 1/2, was promised."""
    before = linear([1.0], [[-1.0]])
    after = SimpleNamespace(as_min=lambda: jnp.asarray(cost))
    search, at = Radius(), jnp.zeros(1)
    length, yes, _, state = search.step(first, at, at + went, before, after, search.init(at, None))
    return length, yes, state


def rosenbrock(z, scale):
    return jnp.array([scale * (z[1] - z[0] ** 2), 1 - z[0]])


@pytest.mark.parametrize(("scale", "most"), [(10.0, 30), (1000.0, 600)])
def test_a_curved_valley_is_followed_to_its_end(scale, most):
    found = optx.least_squares(
        rosenbrock, TrustRegion(1e-10, 1e-10), jnp.array([-1.2, 1.0]), args=scale, max_steps=most
    )
    np.testing.assert_allclose(found.value, [1.0, 1.0], rtol=1e-6)


def test_a_wall_of_not_a_number_is_backed_away_from():
    def residual(z, _):
        return jnp.array([jnp.where(z[0] < 3.0, z[0] - 2.9, jnp.nan), 0.1 * z[0]])

    found = optx.least_squares(residual, TrustRegion(1e-8, 1e-8), jnp.array([-5.0]), max_steps=60)
    assert found.value[0] == pytest.approx(2.9 / 1.01, rel=1e-5)
