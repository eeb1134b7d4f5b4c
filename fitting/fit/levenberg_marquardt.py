"""Levenberg-Marquardt on normal equations that are summed in blocks.

Solvers want residuals and their Jacobian. A fit has a million residuals, so solvers are shown an equivalent problem
with P + 1: if R is the Cholesky factor of M = (J|r)^T W (J|r), then the last column of R has the same sum of squares as
the residuals, and its other columns, as a Jacobian, the same J^T J and J^T r. Between two steps M is summed at the
point that is to be seen next; the step itself (:mod:`.trust_region`) knows the P + 1 residuals alone.

The cost is that of Eq. 56 times 1 + PRIOR |z|^2, a weak prior that holds directions which the data leave open and
vanishes with the cost. It is a sum of squares like the cost itself: of the residuals times sqrt(1 + PRIOR |z|^2).
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...model.numerics import TINY, namespace_of
from ..support.choices import Backend
from .coordinates import Numbers
from .residuals import Objective
from .trust_region import FIRST_RADIUS, Linear, at_rest, bounded_step, next_radius

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


def prior_factor(z: Numbers) -> tuple[Numbers, Numbers]:
    """What the prior multiplies residuals by, s = sqrt(1 + PRIOR |z|^2), and its derivatives (..., P)."""
    factor = namespace_of(z).sqrt(1 + PRIOR * (z * z).sum(-1))
    return factor, PRIOR * z / factor[..., None]


def compress(z: Numbers, normal: Numbers) -> Linear:
    """P + 1 residuals that stand for all, prior included: same cost, gradient and Gauss-Newton matrix at ``z``.

    Args:
        z: free coordinates (..., P). normal: per-channel (J|r)^T W (J|r), shape (..., C, P+1, P+1); J of the
            prediction, r = measured - predicted.
    """
    xp, unit = namespace_of(normal), np.eye(z.shape[-1] + 1)
    sign, last = np.r_[np.ones(z.shape[-1]), -1.0], unit[-1]  # the residual's derivative is that of -prediction
    factor, slope = prior_factor(z)
    # (J|r) to (s J + r ds/dz | s r)
    with_prior = factor[..., None, None] * unit + last[:, None] * (slope @ unit[:-1])[..., None, :]
    whole = with_prior.swapaxes(-1, -2) @ (normal.sum(-3) * sign * sign[:, None]) @ with_prior
    usable = xp.isfinite(whole).all((-1, -2))[..., None, None]
    r = _factor(xp.where(usable, whole, unit))
    r = xp.where(usable & xp.isfinite(r).all((-1, -2))[..., None, None], r, unit * NON_FINITE_COST)
    return Linear(r[..., -1], r[..., :-1])


def _factor(m: Numbers) -> Numbers:
    """Upper triangular R with R^T R = m, for a positive semi-definite m of any scaling; not finite where m is not."""
    xp, unit = namespace_of(m), np.eye(m.shape[-1])
    scale = xp.sqrt(xp.maximum(xp.diagonal(m, axis1=-2, axis2=-1), TINY))
    scaled = m / scale[..., None, :] / scale[..., None] + JITTER * unit
    return _cholesky(scaled).swapaxes(-1, -2) * scale[..., None, :]


def _cholesky(m: Numbers) -> Numbers:
    """Lower triangular factors of matrices, NaN of those that have none."""
    if namespace_of(m) is jnp:
        return jnp.linalg.cholesky(m)
    try:
        return np.linalg.cholesky(m)
    except np.linalg.LinAlgError:
        return np.full_like(m, np.nan) if m.ndim == 2 else np.stack([_cholesky(each) for each in m])


class Way(NamedTuple):
    """Where solves are, (M, ...) of M.

    Attributes:
        y: accepted point (P,). near: compressed residuals and Jacobian there. kept: normal equations there.
        trial: point to be seen next. radius: in which the linear model is trusted. offset: relative offset at y.
        steps: evaluations. blocked: last step whose trial was not finite. converged: whether it met the tolerance.
        active: whether it goes on.
    """

    y: Numbers
    near: Linear
    kept: Numbers
    trial: Numbers
    radius: Numbers
    offset: Numbers
    steps: Numbers
    blocked: Numbers
    converged: Numbers
    active: Numbers


def begin(points: Numbers, normal: Numbers) -> Way:
    """Solves that have not yet gone a step, with the normal equations (M, C, P+1, P+1) of where they start, (M, P)."""
    xp, (many, size) = namespace_of(points), points.shape
    never = xp.zeros(many, bool)
    near = Linear(xp.zeros((many, size + 1)), xp.zeros((many, size + 1, size)))
    count, radius = xp.zeros(many, int), xp.full(many, FIRST_RADIUS)
    active = xp.isfinite(normal).all((1, 2, 3))
    return Way(points, near, normal, points, radius, xp.full(many, xp.inf), count, count - CLEAR, never, active)


def advance(tolerance: float | Array, rtol: float, way: Way, normal: Numbers) -> Way:
    """A step of those that are active.

    Args:
        tolerance: relative offset below which a solve goes no further. rtol: of steps and residuals, below which it is
            at rest. way: where solves are. normal: equations at their trial points.
    """
    xp = namespace_of(normal)
    seen, first = compress(way.trial, normal), way.steps == 0
    step, steps = way.trial - way.y, way.steps + 1
    radius, taken = next_radius(way.radius, step, way.near, seen.cost)
    radius, better = xp.where(first, way.radius, radius), taken | first
    offset = xp.where(better, relative_offset(seen.value), way.offset)
    finite = xp.isfinite(normal).all((1, 2, 3)) & (seen.value[..., -1] < NON_FINITE_COST)
    blocked = xp.where(finite, way.blocked, steps)
    usable = finite | ~first  # what is not finite where it starts goes nowhere
    # at rest, or no radius is left in which to go on
    stop = (taken & ~first & at_rest(way.trial, step, way.near, seen, rtol)) | (radius < rtol)
    converged = usable & ((stop & (steps > blocked + CLEAR)) | (offset < tolerance))
    y, kept = chosen(better, way.trial, way.y), chosen(better, normal, way.kept)
    near = Linear(chosen(better, seen.value, way.near.value), chosen(better, seen.slope, way.near.slope))
    moved = Way(
        y, near, kept, y + bounded_step(near, radius), radius, offset, steps, blocked, converged, usable & ~converged
    )
    return jax.tree.map(lambda new, old: chosen(way.active, new, old), moved, way)


def chosen(which: Numbers, one: Numbers, other: Numbers) -> Numbers:
    """One where it is said, (M,), otherwise the other, (M, ...)."""
    return namespace_of(one).where(which.reshape(-1, *(1,) * (one.ndim - 1)), one, other)


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
    begun = np.array(points, float)
    way = begin(begun, np.asarray(evaluate(begun)))
    for step in range(max_steps):
        if not way.active.any():
            break
        normal = np.asarray(evaluate(way.trial)) if step else way.kept
        with np.errstate(all="ignore"):  # of steps that are not taken
            way = advance(offset, rtol, way, normal)
    return [_ended(jax.tree.map(lambda x, k=k: x[k], way)) for k in range(len(begun))]


def _ended(way: Way) -> Solution:
    cost = float(way.kept[:, -1, -1].sum()) if np.all(np.isfinite(way.kept)) else float("nan")
    return Solution(way.y, cost, way.kept, max(int(way.steps), 1), float(way.offset), bool(way.converged))


def _scipy(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """The same compressed residuals given to MINPACK: a cross-check."""
    from scipy.optimize import least_squares

    jac: Any = lambda z: compress(z, evaluate(z)).slope  # noqa: E731 - Any: scipy's stub knows names only
    found = least_squares(
        lambda z: compress(z, evaluate(z)).value, z, jac, method="lm", xtol=rtol, ftol=rtol**2, max_nfev=limit
    )
    return _solution(evaluate, found.x, int(found.nfev), bool(found.status > 0))


def _jaxopt(evaluate: Callable, z: np.ndarray, limit: int, rtol: float) -> Solution:
    """The same compressed residuals given to jaxopt: a cross-check."""
    with warnings.catch_warnings():  # jaxopt says on import that it is unmaintained
        warnings.simplefilter("ignore")
        import jaxopt

    @jax.custom_jvp
    def residual(z: Array) -> Array:
        return jnp.asarray(compress(np.asarray(z), evaluate(z)).value)

    @residual.defjvp
    def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        near = compress(np.asarray(primals[0]), evaluate(primals[0]))
        return jnp.asarray(near.value), jnp.asarray(near.slope) @ tangents[0]

    solver = jaxopt.LevenbergMarquardt(
        residual, materialize_jac=True, solver="cholesky", maxiter=limit, tol=rtol**2,
        jit=False,  # its loop would compile the normal equations once more, several times over
    )  # fmt: skip
    found = solver.run(jnp.asarray(z))
    steps = int(found.state.iter_num)
    return _solution(evaluate, np.asarray(found.params), steps, steps < limit)


def _solution(evaluate: Callable, z: np.ndarray, steps: int, converged: bool) -> Solution:
    normal = evaluate(z)
    offset = float(relative_offset(compress(z, normal).value))
    return Solution(z, float(normal[:, -1, -1].sum()), normal, steps, offset, converged)


def solve(
    objective: Objective,
    z: np.ndarray,
    max_steps: int = 100,
    rtol: float = 1e-5,
    backend: Backend = "trust-region",
    offset: float = OFFSET_TOLERANCE,
) -> Solution:
    """Minimise Eq. 56 from the free coordinates ``z``.

    Args:
        max_steps: evaluations of the normal equations at the most; 1 evaluates the starting point.
        rtol: tolerance on z and on the residuals.
        offset: of :func:`relative_offset`, below which the trust region goes no further.
        backend: ``trust-region``; ``scipy`` (MINPACK) and ``jaxopt`` (an extra) are there for cross-checks.

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


def relative_offset(compressed: Numbers) -> Numbers:
    """Bates and Watts' convergence measure: the part of the residual vector's length that the tangent space can remove.

    Free of units and of the parametrisation; 0 at a stationary point, 1 where the model is locally perfect. Squared, it
    is the relative decrease of cost that a Gauss-Newton step promises.

    Args:
        compressed: residuals of :func:`compress`, (..., P+1): the last one is what no step can remove.
    """
    xp, squares = namespace_of(compressed), compressed**2
    return xp.sqrt(squares[..., :-1].sum(-1) / xp.maximum(squares.sum(-1), TINY))
