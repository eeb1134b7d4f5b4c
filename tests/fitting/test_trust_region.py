"""The trust region's parts against what defines them, and the whole on problems with known ends."""

import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import PRIOR, solve_many
from merlfit.fitting.fit.trust_region import Linear, at_rest, bounded_step, next_radius


def step(residual, jacobian, radius):
    return bounded_step(Linear(residual, jacobian), np.array(radius))


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


def test_solves_side_by_side_are_those_by_themselves():
    rng = np.random.default_rng(5)
    residual, jacobian, radius = rng.normal(size=(3, 7)), rng.normal(size=(3, 7, 4)), np.array([0.01, 1.0, 100.0])
    together = bounded_step(Linear(residual, jacobian), radius)
    alone = [step(*each) for each in zip(residual, jacobian, radius, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


@pytest.mark.parametrize(
    ("gained", "radius", "taken"),
    [(0.9, 2.0, True), (0.5, 1.0, True), (0.1, 0.5, True), (-0.1, 0.25, False), (-np.inf, 0.25, False)],
)
def test_the_radius_follows_what_was_gained_of_what_was_promised(gained, radius, taken):
    """After a step of which all of the cost, 1/2, was promised."""
    before = Linear(np.array([1.0]), np.array([[-1.0]]))
    found, yes = next_radius(np.array(1.0), np.array([1.0]), before, np.array(0.5 - gained / 2))
    assert (float(found), bool(yes)) == (radius, taken)


def test_at_rest_is_what_moves_by_less_than_the_tolerance():
    near, far = (Linear(np.array([1.0, x]), np.zeros((2, 1))) for x in (2.0, 2.0 + 4e-5))
    for z, moved, after, still in ((9.0, 9e-5, near, True), (9.0, 2e-4, near, False), (0.0, 9e-5, near, False)):
        assert at_rest(np.array([z]), np.array([moved]), near, after, 1e-5) == still
    assert not at_rest(np.array([0.0]), np.array([0.0]), near, far, 1e-5)


def solved(residual, jacobian, z, **limits):
    """The solve of one problem, weak prior included."""

    def equations(points):
        both = np.concatenate([-jacobian(points[0]), residual(points[0])[:, None]], 1)
        return (both.T @ both)[None, None]

    return solve_many(equations, np.array([z]), **limits)[0]


@pytest.mark.parametrize(("scale", "most"), [(10.0, 30), (1000.0, 600)])
def test_a_curved_valley_is_followed_to_its_end(scale, most):
    found = solved(
        lambda z: np.array([scale * (z[1] - z[0] ** 2), 1 - z[0]]),
        lambda z: np.array([[-2 * scale * z[0], scale], [-1.0, 0.0]]),
        [-1.2, 1.0], max_steps=most, rtol=1e-10, offset=1e-9,
    )  # fmt: skip
    assert found.converged
    np.testing.assert_allclose(found.z, [1.0, 1.0], rtol=1e-6)


def test_a_wall_of_not_a_number_is_backed_away_from():
    def residual(z):
        return np.array([z[0] - 2.9 if z[0] < 3.0 else np.nan, 0.1 * z[0]])

    found = solved(residual, lambda _: np.array([[1.0], [0.1]]), [-5.0], max_steps=60, rtol=1e-8)
    # of ((z - 2.9)^2 + 0.01 z^2) (1 + PRIOR z^2) the derivative, 2.02 z - 5.8 and 2 PRIOR z the two factors' own
    polynomial = np.polyadd(
        np.polymul([2.02, -5.8], [PRIOR, 0.0, 1.0]), np.polymul([1.01, -5.8, 2.9**2], [2 * PRIOR, 0.0])
    )
    lowest = next(r.real for r in np.roots(polynomial) if abs(r.imag) < 1e-12)
    assert found.z[0] == pytest.approx(lowest, rel=1e-5)


def test_one_that_goes_nowhere_hinders_no_other():
    """Not finite at its start, with equations of no squares, and two that end after different numbers of steps."""
    slope, targets = np.array([[1.0], [0.1]]), np.array([5.0, 1e-3])

    def equations(points):
        found = []
        for k, z in enumerate(points):
            both = np.concatenate([slope, (np.array([targets[k % 2], 0.1]) - slope @ z)[:, None]], 1)
            found.append([[both.T @ both], [-np.eye(2)], [np.full((2, 2), np.nan)]][max(k - 1, 0)])
        return np.array(found)

    found = solve_many(equations, np.zeros((4, 1)), rtol=1e-8)
    alone = [
        solve_many(lambda p, k=k: equations(np.repeat(p, 2, 0))[k : k + 1], np.zeros((1, 1)), rtol=1e-8)[0]
        for k in (0, 1)
    ]
    assert [each.converged for each in found] == [True, True, False, False]
    assert [each.steps for each in found[2:]] == [1, 1]
    for one, other in zip(found, alone, strict=False):
        assert (one.steps, one.cost) == (other.steps, other.cost)
        np.testing.assert_array_equal(one.z, other.z)
    assert found[0].steps > found[1].steps
