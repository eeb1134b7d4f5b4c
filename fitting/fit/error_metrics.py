"""How far a prediction is from a measurement, and how many independent bins the difference is worth."""

from dataclasses import dataclass, fields

import numpy as np

from ...merl_io.grid import MerlGrid, merl_grid
from ...merl_io.samples import Samples
from ...scene.gridded import GRID
from ...scene.spheres import distances
from ..support.choices import THETA_MAX
from ..support.threads import side_by_side
from .weights import within

COLOURS = 3  # channels that make a picture
LEAST_PAIRS = 10  # of bins, to speak of a correlation between them
INCIDENCE = 0.1  # rad: interval of theta_i of `by_incidence`
SIN_FLOOR = 0.02  # of theta_i in the RMSE weight, as the reference evaluation of the published parameters has it


HIGHLIGHT_THETA_D = np.radians(60)  # up to which the brightest bin at theta_h = 0 is the highlight


@dataclass(frozen=True)
class Errors:
    """How far a prediction is from a measurement, over bins with both directions at theta < theta_max.

    Attributes:
        rmse: 1/sr, cos^2-weighted (HP17 Table 2). smape: 0 to 1.
        cube_root: RMS difference of cube roots of BRDF times cos_i (1/sr^(1/3)), over pairs of directions.
        log: RMS difference of log(1 + BRDF cos_i), over pairs of directions (Loew et al. 2012).
        highlight: predicted over measured brightest value at theta_h = 0, theta_d < 60 degrees, channels summed.
        picture: mean CIELAB distance of spheres over all pixels and both lightings (`scene.spheres.distances`).
        lamp, environment: over the lit pixels of one lighting.
    """

    rmse: float
    smape: float
    cube_root: float
    log: float
    highlight: float
    picture: float
    lamp: float = float("nan")
    environment: float = float("nan")


def errors(
    measured: np.ndarray, predicted: np.ndarray, valid: np.ndarray, grid: MerlGrid, theta_max: float = THETA_MAX
) -> Errors:
    """All errors of a prediction.

    RMSE = sqrt(sum w d^2 / C), w proportional to cos_d sin_d sin_h dtheta_h cos_i^2 / sin_i and summing to one: HP17
    Table 2 integrated over incidence. sMAPE = mean of |m - p| / (m + p) over bins and channels, unweighted.

    Args:
        measured, predicted: (C, H, D, P), 1/sr; measured is anything where not valid. valid: (H, D, P).
        grid: angles of these bins, phi_d over the whole of [0, pi): light and viewer do not weigh alike.
    """
    inside = valid & within(grid, theta_max)
    if not inside.any():
        return Errors(*(float("nan"),) * len(fields(Errors)))
    measure = (np.sin(grid.theta_h) * np.gradient(grid.theta_h))[:, None, None] * np.sin(2 * grid.theta_d)[:, None]
    pairs = np.broadcast_to(measure, inside.shape)[inside]
    cos_i = grid.cos_i[inside]
    weight = pairs * cos_i**2 / np.maximum(np.sqrt(np.clip(1 - cos_i**2, 0, 1)), SIN_FLOOR)
    weight, pairs = weight / weight.sum(), pairs / pairs.sum()

    def channel(planes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        m, p = (plane[inside] for plane in planes)
        difference, total = np.abs(m - p), np.abs(m) + np.abs(p)
        seen, drawn = (np.maximum(x, 0.0) * cos_i for x in (m, p))
        return np.array([
            np.sum(weight * difference**2), np.mean(difference / np.where(total > 0, total, 1.0)),
            np.sum(pairs * (np.cbrt(seen) - np.cbrt(drawn)) ** 2),
            np.sum(pairs * (np.log1p(seen) - np.log1p(drawn)) ** 2),
        ])  # fmt: skip

    planes = list(zip(measured, predicted, strict=True))
    rmse, smape, cube_root, log = np.mean(side_by_side(channel, planes), 0)
    seen = (float("nan"),) * 3  # of a file with empty channels there is no picture
    if len(measured) == COLOURS:
        seen = distances(*_folded(measured, predicted, inside))
    return Errors(
        float(np.sqrt(rmse)), float(smape), float(np.sqrt(cube_root)), float(np.sqrt(log)),
        highlight(measured, predicted, inside, grid), *seen,
    )  # fmt: skip


def by_incidence(
    measured: np.ndarray, predicted: np.ndarray, valid: np.ndarray, grid: MerlGrid, theta_max: float = THETA_MAX
) -> tuple[np.ndarray, np.ndarray]:
    """RMSE (1/sr) by the light's angle: middles of intervals of theta_i (rad), and the curve over them.

    (Int d^2 cos^2(theta_i) domega_o)^(1/2) of HP17 Table 2 in the unit of :attr:`Errors.rmse`: the mean of its squares
    over the intervals is the square of that.
    """
    inside = valid & within(grid, theta_max)
    measure = (np.sin(grid.theta_h) * np.gradient(grid.theta_h))[:, None, None] * np.sin(2 * grid.theta_d)[:, None]
    cos_i = np.clip(grid.cos_i[inside], 0, 1)
    weight = np.broadcast_to(measure, inside.shape)[inside] * cos_i**2 / np.maximum(np.sqrt(1 - cos_i**2), SIN_FLOOR)
    edges = np.arange(0.0, theta_max + INCIDENCE / 2, INCIDENCE)
    place = np.clip(np.digitize(np.arccos(cos_i), edges) - 1, 0, len(edges) - 2)
    squares = np.mean((measured[:, inside] - predicted[:, inside]) ** 2, 0)
    summed = np.bincount(place, weight * squares, len(edges) - 1)
    return (edges[1:] + edges[:-1]) / 2, np.sqrt(summed * len(summed) / weight.sum())


def cube_root_error(samples: Samples, predicted: np.ndarray) -> float:
    """The same as `Errors.cube_root` on folded samples, whose two directions take turns at being the light's."""
    measure = (np.sin(samples.theta_h) * np.gradient(samples.theta_h))[:, None, None]
    measure = measure * np.sin(2 * samples.theta_d)[:, None]
    used = np.all(samples.weight > 0, axis=0)
    pairs = np.where(used, measure, 0.0)
    turns = (np.maximum(samples.cos_i, 0.0) ** (2 / 3) + np.maximum(samples.cos_o, 0.0) ** (2 / 3)) / 2
    squares = np.mean((np.cbrt(samples.value) - np.cbrt(np.maximum(predicted, 0.0))) ** 2, 0)
    return float(np.sqrt(np.sum(pairs * turns * np.where(used, squares, 0.0)) / max(np.sum(pairs), 1e-300)))


def picture_of_few(samples: Samples, predicted: np.ndarray) -> float:
    """`Errors.picture` of folded samples of which each stands for its neighbours, as on a coarse grid.

    No number of what has other channels than a picture.
    """
    if len(samples.value) != COLOURS:
        return float("nan")
    grid, half = merl_grid(GRID), GRID[2] // 2
    asked = np.sqrt(grid.theta_h), grid.theta_d, grid.phi_d[:half]
    axes = np.sqrt(samples.theta_h), samples.theta_d, samples.phi_d
    near = np.ix_(*(np.argmin(np.abs(x[:, None] - y), 1) for x, y in zip(asked, axes, strict=True)))
    used = within(grid, THETA_MAX)[..., :half] & np.all(samples.weight > 0, 0)[near]
    return distances(samples.value[:, *near], predicted[:, *near], used)[0]


def highlight_of_few(samples: Samples, predicted: np.ndarray) -> float:
    """`Errors.highlight` of the same."""
    return highlight(samples.value, predicted, np.all(samples.weight > 0, 0), samples)


def highlight(measured: np.ndarray, predicted: np.ndarray, inside: np.ndarray, grid: MerlGrid | Samples) -> float:
    """Predicted over measured brightest value at theta_h = 0, theta_d < 60 degrees; NaN where nothing is measured."""
    rows = np.flatnonzero(inside.any((1, 2)))[:1]
    narrow = inside[rows] & (grid.theta_d < HIGHLIGHT_THETA_D)[:, None]
    brightest = [np.max(np.where(narrow, np.sum(x[:, rows], 0), 0.0)) for x in (measured, predicted)]
    return float(brightest[1] / brightest[0]) if brightest[0] > 0 else float("nan")


def _folded(
    measured: np.ndarray, predicted: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both with reciprocal bins averaged, and where both of these are inside."""
    half = inside.shape[-1] // 2
    ours, theirs = ((x[..., :half] + x[..., : half - 1 : -1]) / 2 for x in (measured, predicted))
    return ours, theirs, inside[..., :half] & inside[..., : half - 1 : -1]


def correlation_length(field: np.ndarray, used: np.ndarray, axis: int) -> float:
    """Integrated correlation length of a zero-mean field along one axis, in bins: 1 + 2 sum of correlations.

    It says how many bins are worth one for a quantity that hardly changes over that length: the mean of n of them
    scatters as that of n / length independent ones. The sum ends before the first lag whose correlation is not positive
    (Geyer's initial positive sequence): beyond it there is but noise. 1 for independent bins, n for a constant field.
    Slices without any datum are passed over.
    """
    products = _pairs_of_rows(np.where(used, field, 0.0), axis)  # those at one lag are a diagonal
    pairs = _pairs_of_rows(used.astype(np.float32), axis)  # exact sums up to 2^24 pairs of rows
    kept = np.flatnonzero(np.diagonal(pairs))
    products, pairs = products[kept[:, None], kept], pairs[kept[:, None], kept]
    variance = np.trace(products) / np.trace(pairs, dtype=float)
    length = 1.0
    for lag in range(1, len(kept)):
        count = np.trace(pairs, lag, dtype=float)
        covariance = np.trace(products, lag) / count if count >= LEAST_PAIRS else 0.0
        if covariance <= 0:
            break
        length += 2 * (1 - lag / len(kept)) * min(covariance / variance, 1.0)
    return float(length)


def _pairs_of_rows(x: np.ndarray, axis: int) -> np.ndarray:
    """Scalar products of all slices along an axis, (n, n), without moving the axis, which would copy everything."""
    n = x.shape[axis]
    stacked = x.reshape(int(np.prod(x.shape[:axis])), n, -1)
    if stacked.shape[2] == 1:
        return stacked[..., 0].T @ stacked[..., 0]
    return np.sum(stacked @ stacked.swapaxes(1, 2), 0)


def effective_count(field: np.ndarray, used: np.ndarray) -> float:
    """N: how many independent equal residuals those of all channels are worth.

    Two things make them fewer than the bins: a few may carry most of the cost (participation, 3 (sum e^2)^2 / sum e^4,
    which is their number for equal Gaussian ones), and they err alike (the product of correlation lengths along the
    three angles and over the channels).

    Args:
        field: weighted residuals sqrt(w) (m - p), (C, H, D, P). used: which of them count, the same shape.
    """
    largest = np.max(np.abs(field[used]), initial=0.0)
    if largest == 0:
        return float(used.sum())
    field = field / largest  # its square may be no number otherwise
    e2 = field[used] ** 2
    participation = min(3 * e2.sum() ** 2 / np.sum(e2**2), e2.size)
    lengths = side_by_side(lambda axis: correlation_length(field, used, axis), range(field.ndim))
    return float(max(participation / np.prod(lengths), 1.0))
