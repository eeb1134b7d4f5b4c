"""The few rows of bins, or few scattered samples, that stand for all of them: most where parameters are read from.

What a row has to say is its leverage, trace((J^T J + S_0/N)^-1 J_row^T J_row): the number of parameters, as it were,
that it determines of those that the likelihood of N residuals does. Neighbouring rows are put together in runs, one row
for each (`merl_io.samples.thin`), so that no run has much of it. Of a narrow lobe with a sharp edge every row is kept
near the edge, of a matt material rows all over. Scattered samples are rows of one sample, in their order.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jax import Array

from ...merl_io import scattered
from ...merl_io.samples import Samples, runs_for, thin
from ...merl_io.scattered import ScatteredSamples
from ..fit.problem import Part, energy, make_problem
from ..fit.residuals import weighted_prediction
from ..fit.transforms import Layout
from ..support.kept import kept
from ..support.threads import side_by_side

ROWS = 18  # of theta_h that are kept
COLUMNS, AZIMUTHS = 10, 2  # of theta_d: the length of a run; nodes of a row of azimuths
CONSIDERED, KEPT = 2048, 288  # of scattered samples: those whose leverage is looked at, and those that are kept
UNIFORM_SHARE = 0.5  # of what a row holds, the part that is not leverage
BATCH = 16  # points of one call
STEP = 0.02  # of the differences that make a Jacobian, in standard deviations of the prior


@kept()
def _predicted(layout: Layout, points: Array, part: Part) -> Array:
    """Weighted predictions (W, M) at points (W, P), in the precision of ``part``.

    Not to be made float64 in here: jaxlib 0.10 then compiles wrong sums for a CPU (`tests/fitting/test_likelihood.py`).
    """
    predicted = lambda z: weighted_prediction(layout.model, layout.values(z), part).ravel()  # noqa: E731
    # of many points at once nothing is `materialised`, which scattered directions want
    return jax.lax.map(predicted, points) if part.directions.scattered else jax.vmap(predicted)(points)


@dataclass(frozen=True)
class Rows:
    """The least-squares problem of a few bins, its sums in the unit of all bins.

    Attributes:
        layout: of the parameters. part: the bins, in float32. unit: of residuals.
    """

    layout: Layout
    part: Part
    unit: float

    @classmethod
    def of(cls, layout: Layout, few: Samples | ScatteredSamples, whole: float) -> "Rows":
        """A few samples of those with the energy ``whole``."""
        (part,) = make_problem(few, AZIMUTHS, "float32").parts
        return cls(layout, part, float(np.sqrt(energy(few) / whole)))

    @property
    def target(self) -> np.ndarray:
        """Of the weighted measurement, (M,)."""
        return self.unit * np.asarray(self.part.target, float).ravel()

    def predicted(self, points: np.ndarray) -> np.ndarray:
        """Weighted predictions (N, M) at points (N, P)."""
        padded = np.concatenate([points, np.repeat(points[:1], -len(points) % BATCH, 0)])
        batches = np.split(padded, len(padded) // BATCH)
        found = side_by_side(lambda z: np.asarray(_predicted(self.layout, z, self.part), float), batches)
        return self.unit * np.concatenate(found)[: len(points)]

    def tangent(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted prediction at ``z`` (P,), and its Jacobian: (M,) and (M, P)."""
        steps = STEP * np.eye(len(z))
        at = self.predicted(z + np.concatenate([np.zeros((1, len(z))), steps, -steps]))
        return at[0], (at[1 : len(z) + 1] - at[len(z) + 1 :]).T / (2 * STEP)


def few_rows(layout: Layout, samples: Samples | ScatteredSamples, z: np.ndarray, least: float) -> Rows:
    """Of all rows those to keep at a fit.

    Args:
        z: free coordinates of the fit, (P,). least: S_0/N, curvature that stands for the prior.
    """
    whole = energy(samples)
    if isinstance(samples, ScatteredSamples):
        some = scattered.thin(samples, CONSIDERED)
        held = _held(Rows.of(layout, some, whole), z, least, np.ones(len(some.theta_h)))
        few = scattered.keep_middles(some, edges_of(held, KEPT))
    else:
        columns = runs_for(samples, (1, COLUMNS, 1))[1]
        # also without leverage rows near the mirror direction are kept: a lobe narrower than the first one is invisible
        otherwise = 1 / np.arange(1, len(samples.theta_h) + 1)
        held = _held(Rows.of(layout, thin(samples, (1, columns, 1)), whole), z, least, otherwise)
        few = thin(samples, (runs(held, min(ROWS, len(held))), columns, 1))
    return Rows.of(layout, few, whole)


def _held(every: Rows, z: np.ndarray, least: float, otherwise: np.ndarray) -> np.ndarray:
    """What each row has to say, their sum being 1; in proportion to ``otherwise`` where rows have no leverage."""
    _, jacobian = every.tangent(z)
    inverse = np.linalg.inv(jacobian.T @ jacobian + least * np.eye(len(z)))
    leverage = np.sum(jacobian @ inverse * jacobian, 1).reshape(every.part.target.shape)  # (N, C, h, D, K)
    by_row = leverage.sum((1, 3, 4)).ravel()[: len(otherwise)]  # beyond are empty ones
    return (1 - UNIFORM_SHARE) * by_row / by_row.sum() + UNIFORM_SHARE * otherwise / otherwise.sum()


def edges_of(shares: np.ndarray, count: int) -> np.ndarray:
    """Where runs of neighbours begin that hold about as much each, and the end: ``count`` runs, or a few more.

    What holds more than a run's part is a run of its own, so that it is kept.
    """
    alone = np.flatnonzero(shares * count > 1)
    held = np.cumsum(np.where(shares * count > 1, 0.0, shares))
    rest = max(count - len(alone), 1)
    between = np.searchsorted(held, held[-1] * np.arange(1, rest) / rest, side="right")
    return np.unique(np.concatenate([[0], alone, alone + 1, between, [len(shares)]]))


def runs(shares: np.ndarray, count: int) -> tuple[int, ...]:
    """Lengths of ``count`` runs of neighbours, the sum of squares of what they hold being the least."""
    held = np.concatenate([[0.0], np.cumsum(shares)])
    size = len(held)
    cost = np.where(np.arange(size)[:, None] < np.arange(size), (held - held[:, None]) ** 2, np.inf)
    lowest, begins = cost[0], []
    for _ in range(count - 1):
        through = lowest[:, None] + cost
        begins.append(np.argmin(through, 0))
        lowest = np.min(through, 0)
    edges = [size - 1]
    for begin in reversed(begins):
        edges.append(int(begin[edges[-1]]))
    return tuple(np.diff([0, *reversed(edges)]).tolist())
