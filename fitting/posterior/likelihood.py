"""The likelihood of the posterior, on all bins and on a few (docs/statistics.md derives it).

Residuals of a measured material are mostly model error, smooth over the grid, not independent noise. All of them are
worth N independent ones of the size S_0/N that they have at the fit. Those that a change of the parameters could undo
count by how well the data determine that change (`fit.noise`):

    log L(z) = -a |e|^2 - d^T (G/2 - a H) d,    d = H^-1 J^T e,

e being the weighted residuals at z, J their Jacobian at the fit, H = J^T J, G the precision there, and a N/2S_0 or as
much of it as leaves G/2 - a H without a negative eigenvalue. Near the fit that is -(z - z_0)^T G (z - z_0) / 2; far
away it is where the model is that counts, not where its tangent would be.

A chain asks for it a hundred thousand times, so that it walks on a stand-in of a few bins, and is corrected afterwards
(`importance`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...model.reflectance import of_order
from ..fit.levenberg_marquardt import Solution
from ..fit.noise import Noise
from ..fit.problem import Problem
from ..fit.residuals import Objective
from ..fit.transforms import Layout
from .coreset import STEP, few_rows

ORDER = 12  # of the convolution
ALL_ORDER = 20  # of it on all data, where log L differs from that of the fit's order by 0.02 from draw to draw, or less
COMPARED, ALIKE = 8, 0.05  # draws by which that is seen, and the largest standard deviation of differences of log L
LIKELIHOOD_POWER = 0.85  # power of the stand-in: where it errs in the tails, weights of all bins are not large for that


@dataclass(frozen=True)
class Likelihood:
    """That of some bins, or all.

    Attributes:
        weighed: weighted predictions (N, M) of points (N, P). target: of the weighted measurement, (M,).
        scale, along, excess: of :meth:`.noise.Noise.counted`, (M, P) and (P, P): how residuals count.
    """

    weighed: Callable[[np.ndarray], np.ndarray]
    target: np.ndarray
    scale: float
    along: np.ndarray
    excess: np.ndarray

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """log L, up to a constant, of points (N, P); -inf where the model is not finite."""
        residuals = self.weighed(points) - self.target
        undone = (residuals @ self.along).astype(float)
        squares = np.einsum("nm,nm->n", residuals, residuals, dtype=float)
        found = -self.scale * (squares + np.einsum("np,pq,nq->n", undone, self.excess, undone))
        return np.where(np.isfinite(found), found, -np.inf)

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        """The same with the prior, standard normal in free coordinates."""
        return self.log_likelihood(points) - np.sum(points**2, 1) / 2


def likelihood_of_all(
    layout: Layout, z: np.ndarray, problem: Problem, noise: Noise, some: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """log L of points (N, P), up to a constant, (N,): by a convolution of a lower order where that says the same.

    Args:
        z: the fit, (P,). some: points of the posterior, by which it is seen.
    """
    full = on_all(layout, z, problem, noise)
    lower = of_order(layout.model, ALL_ORDER)
    if lower == layout.model:
        return full.log_likelihood
    quick = replace(full, weighed=Objective(replace(layout, model=lower), problem).weighed)
    apart = quick.log_likelihood(some) - full.log_likelihood(some)
    alike = np.isfinite(apart).any() and np.std(apart[np.isfinite(apart)]) <= ALIKE
    return (quick if alike else full).log_likelihood


def on_all(layout: Layout, z: np.ndarray, problem: Problem, noise: Noise) -> Likelihood:
    """That of all bins, but for what no smooth function of the azimuth explains: a constant."""
    objective = Objective(layout, problem)
    steps = STEP * np.eye(len(z))
    jacobian = ((objective.weighed(z + steps) - objective.weighed(z - steps)) / (2 * STEP)).T
    return Likelihood(objective.weighed, objective.target, *noise.counted(jacobian))


def stand_in(layout: Layout, samples: Samples | ScatteredSamples, solution: Solution, noise: Noise) -> Likelihood:
    """The likelihood on `coreset.few_rows`, in float32, with the gradient at the fit that all bins have.

    It is that to the power `LIKELIHOOD_POWER`: a proposal that is wider than the target has weights that are bounded.

    Its measurement is moved for that along the tangent space of the model, by no more than the posterior is wide:
    target + J a, a = (G + 1)^-1 G (d - d'), d and d' the steps that the residuals of all bins and of the few look like.
    So the noise of the few bins, which the others average out, does not move the maximum.
    """
    rows = few_rows(replace(layout, model=of_order(layout.model, ORDER)), samples, solution.z, noise.variance)
    at, jacobian = rows.tangent(solution.z)
    scale, along, excess = noise.counted(jacobian)
    normal = solution.normal.sum(0)
    lacking = noise.step(normal[:-1, :-1], normal[:-1, -1]) - along.T @ (rows.target - at)
    target = rows.target + jacobian @ (noise.covariance @ noise.precision @ lacking)
    return Likelihood(rows.predicted, target, LIKELIHOOD_POWER * scale, along, excess)
