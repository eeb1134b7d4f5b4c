"""The noise of a fit's residuals: what it leaves uncertain of the parameters (docs/statistics.md derives it).

A fit is where the gradient J^T e of the weighted residuals e is zero. So what it is uncertain by is what that gradient
scatters by. The covariance of the gradient,

    B = sum over pairs of bins of J(a) <e(a) e(b)> J(b)^T,

needs that of residuals, which are neither independent nor equal: their channels have a covariance S, and along
each angle they correlate over many bins. Both are read from the residuals, as a product of S and a correlation along
each axis. With the Gauss-Newton matrix H = J^T J the likelihood then has the precision G = H B^-1 H (Godambe 1960): a
quantity that all channels share is known as well as their common noise permits, one of a single channel as well as its
own does, and a sharp highlight's width better than a slope over the whole grid.

Residuals lack what the fit took from the noise: all that looks like a change of parameters. Of noise that is smooth
over the grid that is most of it. So S and the correlations are those of the residuals plus the fit's own expected
error J dz, dz ~ N(0, (G + 1)^-1), found again until B stays: a fixed point.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.special import ndtri, stdtrit

from ...merl_io.samples import Samples, runs_for, thin
from ...merl_io.scattered import ScatteredSamples
from ...merl_io.scattered import thin as thin_scattered
from ..support.threads import CORES
from .levenberg_marquardt import Solution
from .problem import energy

RUNS = (1, 5, 15)  # bins of theta_h, theta_d, phi_d that are taken together: J hardly changes over them
# Cells of scattered samples along the root of theta_h, theta_d, phi_d: the finest that hold so many each, of those that
# hold any. Between cells of few samples hardly any correlation is seen.
CELLS, LEAST_HELD = ((18, 9, 6), (12, 6, 4), (9, 4, 3)), 4
LEAST_CELLS = 50  # of the finest, that hold a sample: a scan in one plane has some 30, four have 90
PREDICTED, ORDERED = 8192, 2048  # scattered samples of which rates are computed, at the most: of cells, of runs
STEP = 1e-5  # of the differences that make a Jacobian, in standard deviations of the prior
ROUNDS, SETTLED = 100, 2e-3  # of finding what the fit took: at most, and the change of B after which it stays
LEAST_PAIRS = 20  # of places at one lag: fewer say nothing of a correlation
OPEN = 1e-3  # of S_0/N: curvature below which the data leave a direction open
# No direction is held to be known better than by so many times N independent residuals: of few places, which hardly
# show a correlation, than by N.
BEST, FEW = 4.0, 100
NINETY = 0.95  # quantile at which Student's t and the normal distribution shall agree
TINY = 1e-12
LEAST_COUNT = 1.5  # residuals: of fewer Student's t would say nothing
Predict = Callable[[np.ndarray, Samples | ScatteredSamples], np.ndarray]
Sum = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Noise:
    """What residuals at a fit say of their noise.

    Attributes:
        cost: S_0, of all bins. count: N, how many independent residuals they are worth.
        precision: G, of the likelihood in free coordinates at the fit, (P, P).
    """

    cost: float
    count: float
    precision: np.ndarray

    @property
    def variance(self) -> float:
        """S_0/N, of one of N residuals."""
        return max(self.cost, 1e-30) / self.count

    @property
    def covariance(self) -> np.ndarray:
        """Of the Gaussian approximation of the posterior in free coordinates, (P, P).

        To the precision of the likelihood the prior, standard normal in these coordinates, adds one. Directions that
        the data leave open are thus held by the prior.
        """
        return np.linalg.inv(np.eye(len(self.precision)) + self.precision)

    def step(self, hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Steps of the parameters that residuals with these gradients J^T e, (P, ...), look like."""
        return np.linalg.solve(hessian + OPEN * self.variance * np.eye(len(hessian)), gradient)

    def counted(self, jacobian: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """How residuals e count: a, U (M, P) and V (P, P) of -log L = a (|e|^2 + d^T V d), d = U^T e.

        d is the step of the parameters that e looks like. a is N/2S_0, or less by what the least known direction has
        less than its part of N residuals: so V has no negative eigenvalue, and no z is more likely than where |e| is
        least. At the fit the curvature is G.

        Args:
            jacobian: of weighted predictions by free coordinates at the fit, (M, P).
        """
        hessian = jacobian.T.astype(float) @ jacobian
        ridge = OPEN * self.variance * np.eye(len(hessian))
        root = np.linalg.inv(np.linalg.cholesky(hessian + ridge))
        share = min(1.0, float(np.linalg.eigvalsh(root @ (self.variance * self.precision + ridge) @ root.T)[0]))
        excess = self.variance * self.precision / share - hessian
        return share / (2 * self.variance), jacobian @ self.step(hessian, np.eye(len(hessian))), excess


def noise_of(
    samples: Samples | ScatteredSamples, predicted: np.ndarray, solution: Solution, count: float, predict: Predict
) -> Noise:
    """That of a fit.

    Args:
        predicted: of all samples, of the shape of their values. solution: with the cost of all of them. count: N.
        predict: predictions at other z, of samples.
    """
    z, slopes = np.asarray(solution.z), np.diag(solution.normal.sum(0))[:-1]
    unit = np.sqrt(energy(samples))
    few, together, mean = _scattered(samples) if isinstance(samples, ScatteredSamples) else _runs(samples)
    mass = together(samples.weight)
    with np.errstate(invalid="ignore", divide="ignore"):
        of_run = np.where(mass > 0, 1 / np.sqrt(mass), 0.0)
    residual = of_run * together(samples.weight * (samples.value - predicted)) / unit
    at = predict(z, few)
    with ThreadPoolExecutor(CORES) as pool:
        rates = list(pool.map(lambda step: mean((predict(z + step, few) - at) / STEP), STEP * np.eye(len(z))))
    jacobian = np.sqrt(mass) / unit * np.stack(rates)
    jacobian = np.where(np.isfinite(jacobian) & (mass > 0), jacobian, 0.0)
    squares = np.sum(jacobian.reshape(len(z), -1) ** 2, 1)  # of all bins they are those of the normal equations
    ratio = np.sqrt(slopes / np.where(squares > 0, squares, 1.0))
    jacobian *= np.where(squares > 0, ratio, 1.0).reshape(-1, *(1,) * mass.ndim)
    floor = solution.cost / count / (BEST if np.count_nonzero((mass > 0).any(0)) >= FEW else 1.0)
    if isinstance(samples, ScatteredSamples):
        floor = max(floor, (samples.model_error or 0.0) ** 2 / unit**2, samples.repeatability / unit**2)
    return Noise(solution.cost, count, precision_of(jacobian, residual, mass > 0, count, floor))


def _runs(samples: Samples) -> tuple[Samples, Sum, Sum]:
    """Of bins: `_scattered` says what. Rates of a run are those of its middle."""
    runs = runs_for(samples, RUNS)
    lengths = [(r,) * (n // r) if isinstance(r, int) else r for r, n in zip(runs, samples.cos_i.shape, strict=True)]
    starts = [np.cumsum(each) - each for each in map(np.asarray, lengths)]

    def summed(x: np.ndarray) -> np.ndarray:
        return reduce(lambda y, axis: np.add.reduceat(y, starts[axis], axis=axis + 1), range(3), x)

    return thin(samples, runs), summed, lambda rates: rates


def _scattered(samples: ScatteredSamples) -> tuple[ScatteredSamples, Sum, Sum]:
    """Samples at which to predict, and two functions that bring arrays (C, ...) to places along axes.

    The first sums what all samples have, the second takes the mean of rates at the samples that are predicted. Places
    are cells on three axes; where few hold any sample, as of one scan, runs of neighbours along their order.
    """
    size = len(samples.theta_h)
    occupied = [len(np.unique(_cell(samples, sides))) for sides in CELLS]
    if occupied[0] < LEAST_CELLS:
        few = thin_scattered(samples, ORDERED)
        edges = np.unique(np.round(np.linspace(0, size, len(few.theta_h) + 1)).astype(int))[:-1]
        return few, lambda x: np.add.reduceat(x, edges, axis=1), lambda rates: rates
    sides = next((each for each, many in zip(CELLS, occupied, strict=True) if size >= LEAST_HELD * many), CELLS[-1])
    few, cell = thin_scattered(samples, PREDICTED), _cell(samples, sides)
    of_few = _cell(few, sides)

    def summed(x: np.ndarray, place: np.ndarray = cell) -> np.ndarray:
        return np.stack([np.bincount(place, each, np.prod(sides)).reshape(sides) for each in x])

    mass = summed(few.weight, of_few)
    weighed = np.where(mass > 0, mass, 1.0)
    return few, summed, lambda rates: summed(few.weight * np.where(few.weight > 0, rates, 0.0), of_few) / weighed


def _cell(samples: ScatteredSamples, sides: tuple[int, int, int]) -> np.ndarray:
    parts = np.stack([np.sqrt(samples.theta_h * np.pi / 2), samples.theta_d, samples.phi_d]) / (np.pi / 2)
    many = np.array(sides)[:, None]
    return np.asarray(np.ravel_multi_index(tuple(np.minimum((parts * many).astype(int), many - 1)), sides))


def precision_of(
    jacobian: np.ndarray, residual: np.ndarray, used: np.ndarray, count: float, floor: float = 0.0
) -> np.ndarray:
    """G = H B^-1 H, (P, P), of residuals in rows of channels along one axis or more.

    Args:
        jacobian: (P, C, ...). residual: (C, ...). used: which of them count, (C, ...). count: N, from which the noise
            is known; of Student's t with so many degrees of freedom G has the 90 % intervals.
        floor: variance that residuals have at the least.
    """
    residual, jacobian = np.where(used, residual, 0.0), np.where(used, jacobian, 0.0)
    columns = jacobian.reshape(len(jacobian), -1)
    plain = columns @ columns.T
    if not (np.isfinite(residual).all() and np.isfinite(plain).all() and not np.isnan(count + floor)):
        return np.full_like(plain, np.nan)
    hessian = plain + TINY * max(np.trace(plain), TINY) * np.eye(len(plain))
    noise, rates, pairs = _moments(residual[None]), _moments(jacobian), _moments(used[None].astype(float))
    error, scatter, fewer = np.zeros_like(hessian), np.full_like(hessian, np.inf), _concentration(residual[used])
    for _ in range(ROUNDS):  # error: covariance of the fit's; scatter: B
        moments = [x[0, 0] + np.tensordot(error, y, 2) for x, y in zip(noise, rates, strict=True)]
        before, scatter = scatter, _gradient_covariance(jacobian, moments, [x[0, 0] for x in pairs])
        if np.all(np.abs(scatter - before) <= SETTLED * np.abs(scatter).max()):
            break
        error = np.linalg.inv(hessian @ np.linalg.solve(scatter, hessian) + np.eye(len(hessian)))
    student_factor = (stdtrit(max(count, LEAST_COUNT), NINETY) / ndtri(NINETY)) ** 2
    scatter = _at_least(student_factor * fewer * scatter, floor * hessian)
    rooted = np.linalg.solve(np.linalg.cholesky(scatter), plain)  # exactly zero where nothing depends on a coordinate
    return rooted.T @ rooted


def _moments(fields: np.ndarray) -> list[np.ndarray]:
    """Sums of products of fields (F, C, ...) with each other.

    The first, (F, F, C, C), is over all places, of channels with each other; the others, (F, F, L), are by lag along an
    axis, over channels and places.
    """
    flat = fields.reshape(len(fields) * fields.shape[1], -1)
    each = (flat @ flat.T).reshape(fields.shape[:2] * 2).swapaxes(1, 2)
    return [each, *(_lagged(fields, axis) for axis in range(2, fields.ndim))]


def _lagged(fields: np.ndarray, axis: int) -> np.ndarray:
    size = fields.shape[axis]
    spectra = np.fft.rfft(np.moveaxis(fields, axis, 0).reshape(size, len(fields), -1), 2 * size, 0)
    return np.moveaxis(np.fft.irfft(spectra.conj() @ spectra.swapaxes(1, 2), 2 * size, 0)[:size], 0, -1)


def _gradient_covariance(jacobian: np.ndarray, moments: list[np.ndarray], pairs: list[np.ndarray]) -> np.ndarray:
    """B, (P, P), of residuals with these moments; ``pairs`` are those of which residuals count."""
    many = np.diag(pairs[0])
    covariance = moments[0] / np.maximum(np.sqrt(many[:, None] * many), 1)
    smooth = jacobian
    for axis, (products, count) in enumerate(zip(moments[1:], pairs[1:], strict=True), 2):
        lags = np.abs(np.subtract.outer(*(np.arange(len(products)),) * 2))
        known = _correlation(products, count, LEAST_PAIRS * len(many))
        smooth = np.moveaxis(np.tensordot(known[lags], smooth, (1, axis)), 0, axis)
    mixed = np.tensordot(jacobian, covariance, (1, 0))  # (P, ..., D)
    flat, smooth, alone = (x.reshape(len(jacobian), -1) for x in (np.moveaxis(mixed, -1, 1), smooth, jacobian))
    found = flat @ smooth.T
    return _at_least((found + found.T) / 2, flat @ alone.T)


def _correlation(products: np.ndarray, pairs: np.ndarray, least: int) -> np.ndarray:
    """By lag, until the first that is not positive (Geyer's initial positive sequence) or has too few pairs."""
    kept = np.where(pairs >= least, products, 0.0) / np.maximum(pairs, 1)
    if not kept[0] > 0:
        return np.eye(len(kept))[0]
    positive = np.logical_and.accumulate(kept > 0)
    return np.where(positive, np.minimum(kept / kept[0], 1.0), 0.0)


def _concentration(residual: np.ndarray) -> float:
    """How many residuals there are for each that carries the cost: n / (3 (sum e^2)^2 / sum e^4), 1 at the least."""
    squares = residual**2
    return max(squares.size * float(np.sum(squares**2)) / max(3 * float(squares.sum()) ** 2, TINY), 1.0)


def _at_least(found: np.ndarray, other: np.ndarray) -> np.ndarray:
    """A covariance that is nowhere below another one: no direction is known better than with that one."""
    ridge = TINY * max(np.trace(other), np.trace(found), TINY) * np.eye(len(other))
    root = np.linalg.cholesky(other + ridge)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ found @ inverse.T)
    turned = root @ vectors
    return (turned * np.maximum(values, 1.0)) @ turned.T
