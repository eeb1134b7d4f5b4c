"""Gauss-Newton steps no longer than a radius in which the linear model has proved itself.

Moré 1978, "The Levenberg-Marquardt algorithm: implementation and theory"; Conn, Gould & Toint 2000, "Trust-region
methods", chapters 6 and 7. Tests: ``tests/fitting/test_trust_region.py``.

Free coordinates are scaled by what is known of each parameter beforehand, so that a length in them means something and
the radius is one number. Parts for optimistix: the descent finds the best point of the ball, the search says how large
the ball may be. optimistix' own Levenberg-Marquardt lengthens its steps only where the linear model is right to 1 %,
and creeps; so do its ``IndirectDampedNewtonDescent`` and ``ClassicalTrustRegion`` with our thresholds, which need at
least 1.2 to 8 times as many evaluations. ``results/bench/solver.md`` compares them.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

Linear = optx.FunctionInfo.ResidualJac  # residuals and Jacobian at a point
FIRST_RADIUS = 1.0
GOOD, POOR = 0.75, 0.25  # of the promised decrease: more than this lengthens the radius, less than that shortens it
LONGER, SHORTER, MUCH_SHORTER = 2.0, 0.5, 0.25  # times the step; the last where a step led upwards
NEWTON_STEPS = 30  # for the damping that makes a step as long as the radius: monotone, quadratic at the end


class _Decomposition(eqx.Module):
    """Singular value decomposition of the Jacobian, and the residuals along its left vectors."""

    singular_values: Array
    right: Array
    along: Array


class BoundedStep(optx.AbstractDescent):
    """argmin |r + J d| over |d| <= radius: d = -(J^T J + mu)^-1 J^T r with the least mu >= 0 that makes it so short.

    Accuracy: length 1e-6 of the radius, gradient 1e-5, for condition numbers of J up to 1e9.
    """

    def init(self, y: Array, f_info_struct: Linear) -> _Decomposition:
        """Nothing yet."""
        size = y.shape[0]
        return _Decomposition(jnp.ones(size, y.dtype), jnp.zeros((size, size), y.dtype), jnp.zeros(size, y.dtype))

    def query(self, y: Array, f_info: Linear, state: _Decomposition) -> _Decomposition:
        """Decompose the Jacobian at an accepted point."""
        left, singular_values, right = jnp.linalg.svd(f_info.jac.as_matrix(), full_matrices=False)
        return _Decomposition(singular_values, right, left.T @ f_info.residual)

    def step(self, step_size: Array, state: _Decomposition) -> tuple[Array, optx.RESULTS]:
        """The step of that radius."""
        squares, gradient = state.singular_values**2, state.singular_values * state.along

        def lengthened(mu: Array) -> tuple[Array, Array]:
            """Coordinates of the step along the right vectors, and how its squared length falls with mu, halved."""
            d = gradient / jnp.maximum(squares + mu, 1e-300)
            return d, jnp.sum(d * d / jnp.maximum(squares + mu, 1e-300))

        def newton(_: int, mu: Array) -> Array:
            # 1/|d| is concave in mu: from the left its tangent never overshoots the root of 1/|d| = 1/radius
            d, fall = lengthened(mu)
            length = jnp.linalg.norm(d)
            ahead = (length / step_size - 1) * length**2 / jnp.maximum(fall, 1e-300)
            return mu + jnp.maximum(ahead, 0.0)

        d, _ = lengthened(jax.lax.fori_loop(0, NEWTON_STEPS, newton, jnp.zeros_like(step_size)))
        d = d * jnp.minimum(1.0, step_size / jnp.maximum(jnp.linalg.norm(d), 1e-300))
        return -(state.right.T @ d), optx.RESULTS.successful


class Radius(optx.AbstractSearch):
    """How far the linear model is trusted: accepts whatever does not raise the cost."""

    def init(self, y: Array, f_info_struct: Linear) -> Array:
        """The radius to begin with."""
        return jnp.asarray(FIRST_RADIUS, y.dtype)

    def step(
        self,
        first_step: Array,
        y: Array,
        y_eval: Array,
        f_info: Linear,
        f_eval_info: Linear,
        state: Array,
    ) -> tuple[Array, Array, optx.RESULTS, Array]:
        """Radius of the next step, and whether the last one is accepted."""
        change = y_eval - y
        length = jnp.linalg.norm(change)
        before = f_info.as_min()
        promised = before - jnp.sum((f_info.residual + f_info.jac.mv(change)) ** 2) / 2
        gained = before - f_eval_info.as_min()
        radius = jnp.where(gained > GOOD * promised, jnp.maximum(state, LONGER * length), state)
        shorter = jnp.where(gained >= 0, SHORTER, MUCH_SHORTER) * length
        radius = jnp.where(gained >= POOR * promised, radius, shorter)  # a gain that is not a number is none
        radius = jnp.where(first_step, state, radius)
        return radius, first_step | (gained >= 0), optx.RESULTS.successful, radius


class TrustRegion(optx.AbstractGaussNewton):
    """Gauss-Newton with :class:`BoundedStep` and :class:`Radius`, in optimistix' interface.

    Ends as optimistix' own solvers do, by the tolerances on point and residuals of accepted steps. Who drives it step
    by step sees the radius in ``search_state`` and can end where that has shrunk to nothing.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Array] = optx.max_norm
    descent: optx.AbstractDescent = BoundedStep()
    search: optx.AbstractSearch = Radius()
    verbose: Callable[..., None] = lambda **_: None
