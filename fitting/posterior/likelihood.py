"""The likelihood of the posterior, on all bins and on a few (docs/statistics.md derives it).

Residuals of a measured material are mostly model error, smooth over the grid, not independent noise. All of them are
worth N independent ones (`error_metrics.effective_count`) of the size that they have at the fit, z_0:

    log L(z) = - N/2 S(z) / S(z_0),    S the cost of Eq. 56.

A chain asks for it a hundred thousand times, so that it walks on a stand-in of a few bins, and is corrected afterwards
(`importance`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax.numpy as jnp
import numpy as np

from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...model.reflectance import of_order
from ..fit.levenberg_marquardt import Solution
from ..fit.problem import Problem
from ..fit.residuals import Objective
from ..fit.transforms import Layout
from ..support.threads import side_by_side
from .coreset import few_rows

ORDER = 12  # of the convolution
ALL_ORDER = 20  # of it on all data, where log L differs from that of the fit's order by 0.02 from draw to draw, or less
COMPARED, ALIKE = 8, 0.05  # draws by which that is seen, and the largest standard deviation of differences of log L
LIKELIHOOD_POWER = 0.85  # power of the stand-in: where it errs in the tails, weights of all bins are not large for that


def log_likelihood(layout: Layout, points: np.ndarray, problem: Problem, count: float, lowest: float) -> np.ndarray:
    """log L at points (N, P) in free coordinates, (N,); -inf where the model is not finite.

    Args:
        count: effective sample count N. lowest: S at the fit.
    """
    objective = Objective(layout, problem)

    def cost(z: np.ndarray) -> float:
        return float(jnp.sum(objective.costs(layout.values(z))))

    # cores share the data of a point where it is much, and points where it is not
    costs = side_by_side(cost, points) if len(problem.parts) == 1 else [cost(z) for z in points]
    found = -count / 2 * np.array(costs) / lowest
    return np.where(np.isfinite(found), found, -np.inf)


def likelihood_of_all(
    layout: Layout, some: np.ndarray, problem: Problem, count: float, lowest: float
) -> Callable[[np.ndarray], np.ndarray]:
    """:func:`log_likelihood` up to a constant, by a convolution of a lower order where that says the same.

    Args:
        some: points of the posterior, by which it is seen.
    """
    quick, full = (
        partial(log_likelihood, replace(layout, model=model), problem=problem, count=count, lowest=lowest)
        for model in (of_order(layout.model, ALL_ORDER), layout.model)
    )
    if of_order(layout.model, ALL_ORDER) == layout.model:
        return full
    apart = quick(some) - full(some)
    return quick if np.std(apart[np.isfinite(apart)]) <= ALIKE and np.isfinite(apart).any() else full


@dataclass(frozen=True)
class StandIn:
    """The likelihood on a few bins.

    Attributes:
        weighed: weighted predictions (N, M) of points (N, P). target: of the weighted measurement, (M,).
        scale: with which the sum of squares becomes minus log L.
    """

    weighed: Callable[[np.ndarray], np.ndarray]
    target: np.ndarray
    scale: float

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """log L, up to a constant, of points (N, P); -inf where the model is not finite."""
        found = -self.scale * np.sum((self.weighed(points) - self.target) ** 2, 1)
        return np.where(np.isfinite(found), found, -np.inf)

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        """The same with the prior, standard normal in free coordinates."""
        return self.log_likelihood(points) - np.sum(points**2, 1) / 2


def stand_in(layout: Layout, samples: Samples | ScatteredSamples, solution: Solution, count: float) -> StandIn:
    """The likelihood on `coreset.few_rows`, in float32, with the gradient at the fit that all bins have.

    It is that to the power `LIKELIHOOD_POWER`: a proposal that is wider than the target has weights that are bounded.

    Its measurement is moved for that along the tangent space of the model, by no more than the posterior is wide:
    target + J a, a = (J^T J + S_0/N)^-1 (g - J^T r), g the gradient J^T r of all bins. So the noise of the few bins,
    which the others average out, does not move the maximum.
    """
    least = solution.cost / count
    rows = few_rows(replace(layout, model=of_order(layout.model, ORDER)), samples, solution.z, least)
    at, jacobian = rows.tangent(solution.z)
    lacking = solution.normal.sum(0)[:-1, -1] - jacobian.T @ (rows.target - at)
    moved = np.linalg.solve(jacobian.T @ jacobian + least * np.eye(len(solution.z)), lacking)
    return StandIn(rows.predicted, rows.target + jacobian @ moved, LIKELIHOOD_POWER * count / (2 * solution.cost))
