"""Levenberg-Marquardt on normal equations that are summed in blocks; optimistix is the solver.

optimistix wants a residual function and differentiates it. Ours has a million residuals, so it is shown an equivalent
one with P + 1: if R is the Cholesky factor of M = (J|r)^T W (J|r), then the last column of R has the same sum of
squares as the residuals, and its other columns, as a Jacobian, the same J^T J and J^T r. Between two steps of the
solver M is summed at the point that it wants to see next, and the solver is given the affine function with that value
and that Jacobian. Its step is compiled once for all models, grids and files, of several solves side by side.

The cost is that of Eq. 56 times 1 + PRIOR |z|^2, a weak prior that holds directions which the data leave open and
vanishes with the cost. It is a sum of squares like the cost itself: of the residuals times sqrt(1 + PRIOR |z|^2).
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ..support.choices import Backend
from .residuals import Objective
from .trust_region import TrustRegion

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
        return self.cost * (1 + PRIOR * float(self.z @ self.z))


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


class SolverState(eqx.Module):
    """Where one solve is; of several, all arrays have a leading axis.

    Attributes:
        y: accepted point (P,). state: of the solver. kept: normal equations at y.
        offset: relative offset at y. steps: evaluations. blocked: last step whose trial was not finite.
        converged: whether it met the tolerance. active: whether it goes on.
    """

    y: Array
    state: Any
    kept: Array
    offset: Array
    steps: Array
    blocked: Array
    converged: Array
    active: Array


@cache
def steps(size: int, rtol: float) -> tuple[Callable[..., SolverState], Callable[..., SolverState]]:
    """Start and step of the solver for P parameters, of one solve, to be compiled."""
    solver = TrustRegion(rtol=rtol, atol=rtol)

    def affine(z: Array, near: _Affine) -> tuple[Array, None]:
        return near(z), None

    def init() -> Any:  # noqa: ANN401 - the solver's own
        z, value = jnp.zeros(size), jnp.zeros(size + 1)
        near, shape = _Affine(z, value, jnp.zeros((size + 1, size))), jax.ShapeDtypeStruct(value.shape, value.dtype)
        return solver.init(affine, z, near, {}, shape, None, frozenset())

    dynamic, static = eqx.partition(eqx.filter_jit(init)(), eqx.is_array)  # one program for all of its arrays

    def start(y: Array, kept: Array) -> SolverState:
        state = eqx.tree_at(lambda s: s.y_eval, dynamic, y)
        never, finite = jnp.asarray(-CLEAR), jnp.all(jnp.isfinite(kept))
        return SolverState(
            y, state, kept, jnp.asarray(jnp.inf, float), jnp.asarray(0), never, jnp.asarray(False), finite
        )

    def advance(tolerance: float | Array, way: SolverState, normal: Array) -> SolverState:
        state: Any = eqx.combine(way.state, static)
        near = compress(state.y_eval, normal)
        y, state, _ = solver.step(affine, way.y, near, {}, state, frozenset())
        stop = state.terminate | (state.search_state < rtol)  # no radius is left in which to go on
        steps = way.steps + 1
        better = (state.num_steps_since_acceptance == 0) | (steps == 1)
        offset = jnp.where(better, relative_offset(near.value), way.offset)
        finite = jnp.all(jnp.isfinite(normal))
        blocked = jnp.where(finite, way.blocked, steps)
        usable = finite | (steps > 1)  # what is not finite where it starts goes nowhere
        converged = usable & ((stop & (steps > blocked + CLEAR)) | (offset < tolerance))
        kept, active = jnp.where(better, normal, way.kept), usable & ~converged
        moved = SolverState(y, eqx.filter(state, eqx.is_array), kept, offset, steps, blocked, converged, active)
        return jax.tree.map(lambda new, old: jnp.where(way.active, new, old), moved, way)

    return start, advance


@cache
def _compiled_steps(size: int, rtol: float) -> tuple[Callable[..., SolverState], Callable[..., SolverState]]:
    """The same of several solves at once, compiled."""
    start, advance = steps(size, rtol)
    return jax.jit(jax.vmap(start)), jax.jit(_one_after_the_other(advance))


def _one_after_the_other(
    advance: Callable[[float | Array, SolverState, Array], SolverState],
) -> Callable[[float | Array, SolverState, Array], SolverState]:
    """Over the leading axis of states and equations; on a GPU side by side.

    On a CPU XLA spreads a batch of decompositions over its own threads, and waits for them in one of these: calls from
    as many threads of ours as it has would wait for ever (jaxlib 0.10).
    """
    if jax.default_backend() != "cpu":
        return jax.vmap(advance, (None, 0, 0))
    return lambda tolerance, ways, normal: jax.lax.map(lambda pair: advance(tolerance, *pair), (ways, normal))


def solve_many(
    evaluate: Callable[[np.ndarray], np.ndarray | Array],
    points: np.ndarray,
    max_steps: int = 100,
    rtol: float = 1e-5,
    offset: float = OFFSET_TOLERANCE,
) -> list[Solution]:
    """Several solves side by side, each of which goes the way that it would go by itself.

    Those that have finished stay where they are until all have, their equations being summed on.

    Args:
        evaluate: normal equations (M, C, P+1, P+1) of M points (M, P). points: where to start, (M, P).
        max_steps, rtol, offset: as for `solve`, of each.
    """
    start, advance = _compiled_steps(points.shape[1], rtol)
    begun = np.asarray(points, float)
    ways = start(begun, evaluate(begun))
    for step in range(max_steps):
        if not np.asarray(ways.active).any():
            break
        ways = advance(offset, ways, evaluate(np.asarray(ways.state.y_eval)) if step else ways.kept)
    ended: SolverState = jax.tree.map(np.asarray, ways)
    return [_ended(jax.tree.map(lambda x, k=k: x[k], ended)) for k in range(len(begun))]


def _ended(way: SolverState) -> Solution:
    kept = np.asarray(way.kept)
    cost = float(kept[:, -1, -1].sum()) if np.all(np.isfinite(kept)) else float("nan")
    return Solution(np.asarray(way.y), cost, kept, max(int(way.steps), 1), float(way.offset), bool(way.converged))


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
    objective: Objective,
    z: np.ndarray,
    max_steps: int = 100,
    rtol: float = 1e-5,
    backend: Backend = "optimistix",
    offset: float = OFFSET_TOLERANCE,
) -> Solution:
    """Minimise Eq. 56 from the free coordinates ``z``.

    Args:
        max_steps: evaluations of the normal equations at the most; 1 evaluates the starting point.
        rtol: tolerance on z and on the residuals.
        offset: of :func:`relative_offset`, below which ``optimistix`` goes no further.
        backend: ``optimistix``; ``scipy`` (MINPACK) and ``jaxopt`` (an extra) are there for cross-checks.

    A trial step to where the model is not finite is rejected; the returned ``z`` is always finite.
    """

    start = np.asarray(z, dtype=float)
    if backend == "scipy":
        return _scipy(objective.normal_equations, start, max_steps, rtol)
    if backend == "jaxopt":
        return _jaxopt(objective.normal_equations, start, max_steps, rtol)
    (found,) = solve_many(
        lambda points: objective.normal_equations(points[0])[None], start[None], max_steps, rtol, offset
    )
    return found


def relative_offset(compressed: Array) -> Array:
    """Bates and Watts' convergence measure: the part of the residual vector's length that the tangent space can remove.

    Free of units and of the parametrisation; 0 at a stationary point, 1 where the model is locally perfect. Squared, it
    is the relative decrease of cost that a Gauss-Newton step promises.

    Args:
        compressed: residuals of :func:`compress`, (P+1,): the last one is what no step can remove.
    """
    return jnp.linalg.norm(compressed[:-1]) / jnp.maximum(jnp.linalg.norm(compressed), 1e-300)
