"""Levenberg-Marquardt on normal equations that are summed in blocks; optimistix is the solver.

optimistix wants a residual function and differentiates it. Ours has a million residuals, so it is shown an equivalent
one with P + 1: if R is the Cholesky factor of M = (J|r)^T W (J|r), then the last column of R has the same sum of
squares as the residuals, and its other columns, as a Jacobian, the same J^T J and J^T r. Between two steps of the stock
solver M is summed at the point that it wants to see next, and the solver is given the affine function with that value
and that Jacobian. Its step is compiled once for all models, grids and files.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from ..model.effects import Effects
from .problem import Problem
from .residuals import normal_equations

Backend = Literal["optimistix", "scipy", "jaxopt"]
# Costs are relative to the energy of the measurement; as optimistix starts with a damping of 1, residuals are scaled so
# that this is a light one.
RESIDUAL_SCALE = 100.0
# Pull of z towards 0, relative to the cost at the start of a solve: stops drift along directions that the data leave
# open and beyond a bound (z = 6 is 0.25 % from it and costs 1 %), and vanishes with the cost when the model is exact.
PULL = 3e-4
JITTER = 1e-13  # added to the unit diagonal of the scaled M; costs below 1e-13 of the energy are not resolved
NON_FINITE_COST = 1e12  # stands for a trial point whose prediction overflows: always rejected
CLEAR = 8  # steps since a trial where the model was not finite: before that, short steps are a wall, not a minimum
OFFSET_TOLERANCE = 1e-3  # of the relative offset: a further step would lower the cost by less than 1e-6 of itself


class Status(Enum):
    """How a fit ended, in a sentence that says what to do."""

    CONVERGED = "converged: no further step lowers the cost noticeably"
    AT_BOUND = "converged with parameters at a bound: the data ask for a value at or beyond it, see at_bound"
    STEP_LIMIT = "stopped at the step limit while the cost was still falling: raise fit.max_steps"
    NON_FINITE = "failed: the model is not finite at the starting point; check the file with `merlfit check`"
    UNEXPLAINED = (
        "failed: the model explains less than half of the file; check it with `merlfit check`, "
        "try body = 'auto' and acquisition = 'free'"
    )
    NO_DATA = (
        "failed: fewer than 30 valid bins brighter than 1e-30/sr, on all bins or on a thinned grid; see `merlfit check`"
    )

    @property
    def succeeded(self) -> bool:
        """Whether the parameters may be used."""
        return self in (Status.CONVERGED, Status.AT_BOUND)


@dataclass(frozen=True)
class Solution:
    """Outcome of one solve.

    Attributes:
        z: free coordinates (P,). cost: of Eq. 56 relative to the measurement's energy, without folding scatter.
        normal: per-channel (J|r)^T W (J|r) at z, (C, P+1, P+1). steps: evaluations of the normal equations.
        offset: Bates and Watts' relative offset at z, :func:`relative_offset`.
        converged: whether the solver met its tolerance.
    """

    z: np.ndarray
    cost: float
    normal: np.ndarray
    steps: int
    offset: float
    converged: bool


def _factor(m: Array) -> Array:
    """Upper triangular R with R^T R = m, for a positive semi-definite m of any scaling."""
    scale = jnp.sqrt(jnp.maximum(jnp.diag(m), 1e-300))
    unit = m / scale / scale[:, None]
    return jnp.linalg.cholesky(unit + JITTER * jnp.eye(len(m))).T * scale


class _Affine(eqx.Module):
    """The compressed residuals near ``at``: value (P+1,) and Jacobian (P+1, P)."""

    at: Array
    value: Array
    slope: Array

    def __call__(self, z: Array) -> Array:
        return self.value + self.slope @ (z - self.at)


def compress(z: Array, normal: Array, pull: Array) -> _Affine:
    """P + 1 residuals that stand for all: same cost, gradient and Gauss-Newton matrix at ``z``.

    Args:
        normal: per-channel (J|r)^T W (J|r), shape (C, P+1, P+1); J of the prediction, r = measured - predicted.
        pull: weight of z^2, added to the cost.
    """
    sign = jnp.ones(len(z) + 1).at[-1].set(-1.0)  # the residual's derivative is minus that of the prediction
    leash = jnp.concatenate([jnp.eye(len(z)), z[:, None]], 1)
    r = _factor((jnp.sum(normal, 0) * sign * sign[:, None] + pull * leash.T @ leash) * RESIDUAL_SCALE**2)
    r = jnp.where(jnp.all(jnp.isfinite(r)), r, jnp.eye(len(r)) * NON_FINITE_COST)
    return _Affine(z, r[:, -1], r[:, :-1])


@cache
def _machine(size: int, rtol: float) -> tuple[Any, Callable[..., Any]]:
    """Initial state and compiled step of optimistix' Levenberg-Marquardt for P parameters."""
    solver = optx.LevenbergMarquardt(rtol=rtol, atol=rtol)
    z = jnp.zeros(size)
    shape = jax.ShapeDtypeStruct((size + 1,), z.dtype)

    def affine(z: Array, near: _Affine) -> tuple[Array, None]:
        return near(z), None

    near = _Affine(z, jnp.zeros(size + 1), jnp.zeros((size + 1, size)))
    state = solver.init(affine, z, near, {}, shape, None, frozenset())
    dynamic, static = eqx.partition(state, eqx.is_array)

    @jax.jit
    def step(y: Array, dynamic: Any, normal: Array, pull: Array) -> tuple[Array, Any, Array, Array, Array]:  # noqa: ANN401
        state = eqx.combine(dynamic, static)
        near = compress(state.y_eval, normal, pull)
        y, state, _ = solver.step(affine, y, near, {}, state, frozenset())
        accepted = state.num_steps_since_acceptance == 0
        return y, eqx.filter(state, eqx.is_array), state.terminate, accepted, relative_offset(near.value)

    return dynamic, step


def _optimistix(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """Drive the stock solver, summing normal equations at every point that it asks for."""
    state, step = _machine(len(z), rtol)
    y, state = jnp.asarray(z), eqx.tree_at(lambda s: s.y_eval, state, jnp.asarray(z))
    kept = normal = evaluate(y)
    pull = jnp.asarray(PULL * np.nan_to_num(np.asarray(kept)[:, -1, -1].sum()))
    offset, converged, steps, blocked = float("inf"), False, 0, -CLEAR
    if not np.isfinite(kept).all():
        return Solution(np.asarray(y), float("nan"), np.asarray(kept), 1, offset, False)
    while steps < limit and not converged:
        normal = evaluate(state.y_eval) if steps else kept
        y, state, stop, accepted, trial_offset = step(y, state, normal, pull)
        steps += 1
        if steps == 1 or bool(accepted):
            kept, offset = normal, float(trial_offset)
        if not np.isfinite(normal).all():
            blocked = steps
        converged = (bool(stop) and steps > blocked + CLEAR) or offset < OFFSET_TOLERANCE
    return Solution(np.asarray(y), float(np.asarray(kept)[:, -1, -1].sum()), np.asarray(kept), steps, offset, converged)


def _scipy(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """The same compressed residuals given to MINPACK: a cross-check."""
    from scipy.optimize import least_squares

    pull = PULL * evaluate(jnp.asarray(z))[:, -1, -1].sum()

    def near(z: np.ndarray) -> _Affine:
        point = jnp.asarray(z)
        return compress(point, evaluate(point), pull)

    jac: Any = lambda z: np.asarray(near(z).slope)  # noqa: E731 - Any: scipy's stub knows names only
    found = least_squares(
        lambda z: np.asarray(near(z).value), z, jac, method="lm", xtol=rtol, ftol=rtol**2, max_nfev=limit
    )
    return _solution(evaluate, found.x, pull, int(found.nfev), bool(found.status > 0))


def _jaxopt(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """The same compressed residuals given to jaxopt: a cross-check."""
    with warnings.catch_warnings():  # jaxopt says on import that it is unmaintained
        warnings.simplefilter("ignore")
        import jaxopt

    pull = PULL * evaluate(jnp.asarray(z))[:, -1, -1].sum()

    @jax.custom_jvp
    def residual(z: Array) -> Array:
        return compress(z, evaluate(z), pull).value

    @residual.defjvp
    def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        near = compress(primals[0], evaluate(primals[0]), pull)
        return near.value, near.slope @ tangents[0]

    solver = jaxopt.LevenbergMarquardt(
        residual, materialize_jac=True, solver="cholesky", maxiter=limit, xtol=rtol, gtol=rtol,
        jit=False,  # its loop would compile the normal equations once more, several times over
    )  # fmt: skip
    found = solver.run(jnp.asarray(z))
    steps = int(found.state.iter_num)
    return _solution(evaluate, np.asarray(found.params), pull, steps, steps < limit)


def _solution(evaluate: Callable, z: np.ndarray, pull: Array, steps: int, converged: bool) -> Solution:
    normal = evaluate(jnp.asarray(z))
    offset = float(relative_offset(compress(jnp.asarray(z), normal, pull).value))
    return Solution(z, float(normal[:, -1, -1].sum()), np.asarray(normal), steps, offset, converged)


def solve(
    effects: Effects,
    z: np.ndarray,
    problem: Problem,
    max_steps: int = 100,
    rtol: float = 1e-5,
    backend: Backend = "optimistix",
) -> Solution:
    """Minimise Eq. 56 from the free coordinates ``z``.

    Args:
        max_steps: evaluations of the normal equations at the most; 1 evaluates the starting point.
        rtol: tolerance on z and on the residuals.
        backend: ``optimistix``; ``scipy`` (MINPACK) and ``jaxopt`` (an extra) are there for cross-checks.

    A trial step to where the model is not finite is rejected; the returned ``z`` is always finite.
    """

    def evaluate(z: Array) -> Array:
        return normal_equations(effects, z, problem)

    start = np.asarray(z, dtype=float)
    if backend == "scipy":
        return _scipy(evaluate, start, max_steps, rtol)
    if backend == "jaxopt":
        return _jaxopt(evaluate, start, max_steps, rtol)
    return _optimistix(evaluate, start, max_steps, rtol)


def relative_offset(compressed: Array) -> Array:
    """Bates and Watts' convergence measure: the part of the residual vector's length that the tangent space can remove.

    Free of units and of the parametrisation; 0 at a stationary point, 1 where the model is locally perfect. Squared, it
    is the relative decrease of cost that a Gauss-Newton step promises.

    Args:
        compressed: residuals of :func:`compress`, (P+1,): the last one is what no step can remove.
    """
    return jnp.linalg.norm(compressed[:-1]) / jnp.maximum(jnp.linalg.norm(compressed), 1e-300)
