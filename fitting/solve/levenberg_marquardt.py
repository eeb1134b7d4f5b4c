"""Levenberg-Marquardt on normal equations that are summed in blocks; optimistix is the solver.

optimistix wants a residual function and differentiates it. Ours has a million residuals, so it is shown an equivalent
one with P + 1: if R is the Cholesky factor of M = (J|r)^T W (J|r), then the last column of R has the same sum of
squares as the residuals, and its other columns, as a Jacobian, the same J^T J and J^T r. Between two steps of the
solver M is summed at the point that it wants to see next, and the solver is given the affine function with that value
and that Jacobian. Its step is compiled once for all models, grids and files.

The cost is that of Eq. 56 times 1 + PRIOR |z|^2, a weak prior that holds directions which the data leave open and
vanishes with the cost. It is a sum of squares like the cost itself: of the residuals times sqrt(1 + PRIOR |z|^2).
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
from jax import Array
from jax.typing import ArrayLike

from ..objective.problem import Problem
from ..objective.residuals import normal_equations
from ..objective.transforms import Layout
from .trust_region import TrustRegion

Backend = Literal["optimistix", "scipy", "jaxopt"]
PRIOR = 1e-2  # weight of |z|^2: as much as in the posterior of a material whose residuals are worth 100 bins in all
JITTER = 1e-13  # added to the unit diagonal of the scaled M; costs below 1e-13 of the energy are not resolved
NON_FINITE_COST = 1e12  # stands for a trial point whose prediction overflows: always rejected
CLEAR = 8  # steps since a trial where the model was not finite: before that, short steps are a wall, not a minimum
LEAST_BINS = 30  # fewer bins with light than this, of all or of a thinned grid, cannot carry a dozen parameters
BLACK = 1e-30  # 1/sr: no more light than this is none
UNEXPLAINED_COST = 0.5  # of the measurement's energy; predicting no light at all costs 1
OFFSET_TOLERANCE = 1e-3  # of the relative offset: a further step would lower the cost by less than 1e-6 of itself


class Status(Enum):
    """How a fit ended, in a sentence that says what to do."""

    CONVERGED = "converged: no further step lowers the cost noticeably"
    AT_BOUND = "converged with parameters at a bound: the best values lie there, or would lie beyond it"
    STEP_LIMIT = "usable, but stopped at the step limit while the cost was still falling: raise fit.max_steps"
    NON_FINITE = "failed: the model is not finite at the starting point; check the file with `merlfit check`"
    UNEXPLAINED = (
        f"failed: the model explains less than {1 - UNEXPLAINED_COST:.0%} of the file; check it with `merlfit check`, "
        "try effects.body = 'auto', acquisition.grazing_loss = 'free' or another --model"
    )
    NO_DATA = (
        f"failed: fewer than {LEAST_BINS} valid bins brighter than {BLACK:g}/sr, on all bins or on a thinned grid; "
        "see `merlfit check`"
    )

    @property
    def succeeded(self) -> bool:
        """Whether the parameters may be used."""
        return self in (Status.CONVERGED, Status.AT_BOUND, Status.STEP_LIMIT)


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

    @property
    def objective(self) -> float:
        """What is minimised: cost and prior."""
        return self.cost * float(prior_factor(self.z)[0]) ** 2


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


def prior_factor(z: ArrayLike) -> tuple[Array, Array]:
    """What the prior multiplies residuals by, s = sqrt(1 + PRIOR |z|^2), and its derivatives (P,)."""
    z = jnp.asarray(z)
    factor = jnp.sqrt(1 + PRIOR * jnp.sum(z * z))
    return factor, PRIOR * z / factor


def compress(z: Array, normal: Array | np.ndarray) -> _Affine:
    """P + 1 residuals that stand for all, prior included: same cost, gradient and Gauss-Newton matrix at ``z``.

    Args:
        normal: per-channel (J|r)^T W (J|r), shape (C, P+1, P+1); J of the prediction, r = measured - predicted.
    """
    sign = jnp.ones(len(z) + 1).at[-1].set(-1.0)  # the residual's derivative is minus that of the prediction
    factor, slope = prior_factor(z)
    with_prior = (factor * jnp.eye(len(z) + 1)).at[-1, :-1].add(slope)  # (J|r) to (s J + r ds/dz | s r)
    signed = jnp.sum(jnp.asarray(normal), 0) * sign * sign[:, None]
    r = _factor(with_prior.T @ signed @ with_prior)
    r = jnp.where(jnp.all(jnp.isfinite(r)), r, jnp.eye(len(r)) * NON_FINITE_COST)
    return _Affine(z, r[:, -1], r[:, :-1])


@cache
def _machine(size: int, rtol: float) -> tuple[Any, Callable[..., Any]]:
    """Initial state and compiled step of the solver for P parameters."""
    solver = TrustRegion(rtol=rtol, atol=rtol)
    z = jnp.zeros(size)
    shape = jax.ShapeDtypeStruct((size + 1,), z.dtype)

    def affine(z: Array, near: _Affine) -> tuple[Array, None]:
        return near(z), None

    near = _Affine(z, jnp.zeros(size + 1), jnp.zeros((size + 1, size)))
    state = solver.init(affine, z, near, {}, shape, None, frozenset())
    dynamic, static = eqx.partition(state, eqx.is_array)

    @jax.jit
    def step(y: Array, dynamic: eqx.Module, normal: Array) -> tuple[Array, eqx.Module, Array, Array, Array]:
        state: Any = eqx.combine(dynamic, static)
        near = compress(state.y_eval, normal)
        y, state, _ = solver.step(affine, y, near, {}, state, frozenset())
        stop = state.terminate | (state.search_state < rtol)  # no radius is left in which to go on
        accepted = state.num_steps_since_acceptance == 0
        return y, eqx.filter(state, eqx.is_array), stop, accepted, relative_offset(near.value)

    return dynamic, step


def _optimistix(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """Drive the solver, summing normal equations at every point that it asks for."""
    state, step = _machine(len(z), rtol)
    y, state = jnp.asarray(z), eqx.tree_at(lambda s: s.y_eval, state, jnp.asarray(z))
    kept = normal = evaluate(y)
    offset, converged, steps, blocked = float("inf"), False, 0, -CLEAR
    if not np.isfinite(kept).all():
        return Solution(np.asarray(y), float("nan"), np.asarray(kept), 1, offset, False)
    while steps < limit and not converged:
        normal = evaluate(state.y_eval) if steps else kept
        y, state, stop, accepted, trial_offset = step(y, state, normal)
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

    def near(z: np.ndarray) -> _Affine:
        point = jnp.asarray(z)
        return compress(point, evaluate(point))

    jac: Any = lambda z: np.asarray(near(z).slope)  # noqa: E731 - Any: scipy's stub knows names only
    found = least_squares(
        lambda z: np.asarray(near(z).value), z, jac, method="lm", xtol=rtol, ftol=rtol**2, max_nfev=limit
    )
    return _solution(evaluate, found.x, int(found.nfev), bool(found.status > 0))


def _jaxopt(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """The same compressed residuals given to jaxopt: a cross-check."""
    with warnings.catch_warnings():  # jaxopt says on import that it is unmaintained
        warnings.simplefilter("ignore")
        import jaxopt

    @jax.custom_jvp
    def residual(z: Array) -> Array:
        return compress(z, evaluate(z)).value

    @residual.defjvp
    def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        near = compress(primals[0], evaluate(primals[0]))
        return near.value, near.slope @ tangents[0]

    solver = jaxopt.LevenbergMarquardt(
        residual, materialize_jac=True, solver="cholesky", maxiter=limit, tol=rtol**2,
        jit=False,  # its loop would compile the normal equations once more, several times over
    )  # fmt: skip
    found = solver.run(jnp.asarray(z))
    steps = int(found.state.iter_num)
    return _solution(evaluate, np.asarray(found.params), steps, steps < limit)


def _solution(evaluate: Callable, z: np.ndarray, steps: int, converged: bool) -> Solution:
    normal = evaluate(jnp.asarray(z))
    offset = float(relative_offset(compress(jnp.asarray(z), normal).value))
    return Solution(z, float(normal[:, -1, -1].sum()), np.asarray(normal), steps, offset, converged)


def solve(
    layout: Layout,
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

    def evaluate(z: Array) -> np.ndarray:
        return normal_equations(layout, z, problem)

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
