"""Starting points: one read off the data, and others spread over the whole prior, the best of each kind.

What matters is where basins of attraction differ: how wide the lobe of microfacets is, how much light is diffracted,
and whether that is the highlight, by a long correlation length, or a haze around it. Costs of starting points of
different kinds say little about where they lead; among points of one kind the lowest is a good guess. Optical constants
are not scattered but projected out (`projection`).

That is for the two-scale model. Of any other the best of many points of its prior are taken (`scattered`).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats.qmc import Sobol

from ...merl_io.samples import Samples
from ...model.two_scale import TwoScale
from ..objective.problem import Problem
from ..objective.residuals import costs_of_many
from ..objective.transforms import MIDDLE_UM, Layout
from .projection import project

CANDIDATES_EACH = 7  # candidates for every starting point that is asked for; a power of 2 in all
CLASSES = {"beta": 3, "p": 2, "sigma_s": 2}  # kinds: so many classes of each, equally likely
NEAR = 0.3  # standard deviation of b's coordinate where the highlight is taken for diffracted light
SCATTER = 1.5  # standard deviation of candidates in units of the prior's
DARK_QUANTILE = 0.1  # of the bins away from the lobe: taken for the body
RIM = 1e-3  # of the places of candidates between 0 and 1
THIRDS = ndtri([1 / 3, 2 / 3])
SHARED_EACH, OWN = 8, 16  # of `scattered`: points for every starting point that is asked for, and of each per channel
TYPICAL = {
    "p": 1.0, "b": 2.0, "c": 1.5, "sigma_s": 0.03, "grazing_exponent": 0.5, "grazing_exponent_diffracted": 0.3,
}  # fmt: skip
OPTICS = {"n": 1.0, "k": 3.0, "eta": 1.5, "albedo": 0.3}  # before they are projected


class ReadOff(NamedTuple):
    """What the data say about where to start: the measured highlight may be the facets' lobe, or diffracted light.

    Attributes:
        first: shared parameters with the former's width, the others typical. b: of the latter (um).
    """

    first: Mapping[str, float]
    b: float


def read_off(samples: Samples) -> ReadOff:
    """Lobes with the half width of the highlight; a diffraction lobe's is where 2 tan(theta_h) / lambda = 1 / b."""
    width = half_width(samples.theta_h, samples.theta_d, samples.value, samples.weight > 0)
    beta = width / np.log(2.0) ** (1 / (2 * TYPICAL["p"]))
    return ReadOff({"beta": beta, **TYPICAL}, MIDDLE_UM / (2 * width))


def half_width(theta_h: np.ndarray, theta_d: np.ndarray, value: np.ndarray, used: np.ndarray) -> float:
    """tan(theta_h) where the lobe at small theta_d, averaged over azimuth and channels, has fallen to half.

    Args:
        value: (C, H, D, P), 1/sr. used: which of them count, the same shape.
    """
    columns = slice(0, max(1, len(theta_d) // 6))
    counted = used[:, :, columns]
    lobe = np.where(counted, value[:, :, columns], 0.0).sum((2, 3)) / np.maximum(counted.sum((2, 3)), 1)
    away = used[0] & (theta_h > 0.6)[:, None, None] & (theta_d < 0.9)[None, :, None]
    away = away if away.any() else used[0]
    dark = np.array([np.quantile(plane[away], DARK_QUANTILE) if away.any() else 0.0 for plane in value])
    brightness = np.maximum(lobe - dark[:, None], 0.0).mean(0)
    below = np.flatnonzero(brightness < brightness[:2].max() / 2)
    tangent = np.tan(np.minimum(theta_h, 1.5))
    return float(np.clip(tangent[below[0]] if len(below) and below[0] > 0 else tangent[0], 2e-3, 2.0))


def starting_points(
    layouts: Sequence[Layout], seen: ReadOff, problem: Problem, count: int, over: Callable[..., Iterable] = map
) -> list[np.ndarray]:
    """So many starting points of every model and one more, in free coordinates, (count + 1, P) each.

    There are no random numbers in them: the same data have the same starting points.

    Args:
        layouts: two-scale kinds differ in interface and body alone. seen: what the data say of these.
        problem: on which candidates are compared. over: maps a function over batches of candidates.
    """
    kinds = [layout for layout in layouts if isinstance(layout.material, TwoScale)]
    of_kinds = iter(projected(kinds, seen, problem, count, over) if kinds else [])
    return [
        next(of_kinds) if isinstance(layout.material, TwoScale) else scattered(layout, problem, count)
        for layout in layouts
    ]


def scattered(layout: Layout, problem: Problem, count: int) -> np.ndarray:
    """The best points of the prior of any model, in free coordinates, (count + 1, P).

    Points of the parameters that channels share, times points of those per channel: because no channel's cost knows of
    another's parameters, the best of the latter is taken channel by channel. Both are Sobol sequences. Kinds are the
    thirds of every parameter with a logarithmic scale, a width for instance: of each the best, then the second best.
    """
    own = [q for q in layout.parameters if q.per_channel]
    shared = len(layout.parameters) - len(own)
    channels = len(layout.channels)
    most = 1 << (SHARED_EACH * (count + 1) - 1).bit_length()
    places = [_spread(shared, most), _spread(len(own), OWN)]
    first, second = np.indices((len(places[0]), len(places[1]))).reshape(2, -1)
    points = np.concatenate([places[0][first], np.repeat(places[1][second], channels, 1)], 1)
    values = layout.values_of_many(points)
    for q in own:  # alike in all channels, whatever the prior of their differences
        values[q.name] = np.repeat(values[q.name][:, channels // 2, None], channels, 1)
    found = np.asarray(costs_of_many(layout.model, {name: jnp.asarray(x) for name, x in values.items()}, problem))
    costs = np.nan_to_num(found, nan=np.inf).reshape(len(places[0]), len(places[1]), channels)
    wide = [k for k, q in enumerate(layout.parameters[:shared]) if q.scale == "log"]
    kinds = [tuple(each) for each in np.digitize(places[0][:, wide], SCATTER * THIRDS).tolist()]
    chosen = costs.argmin(1)
    best = _best(costs.min(1).sum(1), kinds, count + 1)
    return np.array([layout.free(_chosen(values, k * len(places[1]) + chosen[k])) for k in best])


def _chosen(values: Mapping[str, np.ndarray], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the row of every channel, (C,); those of the first where channels share them."""
    return {name: x[rows[0]] if x.ndim == 1 else x[rows, np.arange(len(rows))] for name, x in values.items()}


def _spread(size: int, count: int) -> np.ndarray:
    """Points over the prior in free coordinates, (count, size); one where there is nothing to spread."""
    if size == 0:
        return np.zeros((1, 0))
    return SCATTER * ndtri(np.clip(Sobol(size, scramble=False).random(count), RIM, 1 - RIM))


def projected(
    layouts: Sequence[Layout], seen: ReadOff, problem: Problem, count: int, over: Callable[..., Iterable] = map
) -> list[np.ndarray]:
    """The same of two-scale models: the first point is read off the data.

    Candidates are a Sobol sequence over the prior of the shared parameters, shifted (modulo 1) so that its first point
    is that of ``seen``: another first point moves all. In every other candidate b is near that of ``seen``. Of every
    kind the best is taken, then the second best, and so on.

    Args:
        layouts: kinds that differ in interface and body alone: their candidates have the same lobes.
    """
    first = layouts[0]
    shared = [q.name for q in first.parameters if not q.per_channel]
    most = 1 << (CANDIDATES_EACH * count - 1).bit_length()
    begun = first.free({**OPTICS, **{name: seen.first[name] for name in shared}})
    size = len(shared)  # shared parameters come first
    places = (ndtr(begun[:size] / SCATTER) + Sobol(size, scramble=False).random(most)) % 1.0
    points = np.tile(begun, (most, 1))
    points[1:, :size] = SCATTER * ndtri(np.clip(places[1:], RIM, 1 - RIM))
    sharp = np.zeros(most, bool)
    if "b" in shared:
        sharp[1::2], b = True, shared.index("b")
        points[sharp, b] = first.free({**OPTICS, **seen.first, "b": seen.b})[b] + NEAR / SCATTER * points[sharp, b]
    named = first.values_of_many(points)
    found = project([each.model for each in layouts], {name: named[name] for name in shared}, problem, over)
    classes = np.array([CLASSES.get(name, 1) for name in shared])
    kinds = [tuple(each) for each in np.column_stack([(places * classes).astype(int), sharp]).tolist()]
    return [
        np.array(
            [
                layout.free({name: x[i] for name, x in values.items()})
                for i in (0, *(1 + k for k in _best(costs[1:], kinds[1:], count)))
            ]
        )
        for layout, (costs, values) in zip(layouts, found, strict=True)
    ]


def _best(costs: np.ndarray, kinds: Sequence[tuple[int, ...]], count: int) -> list[int]:
    """So many candidates: of every kind the best, then the second best, and so on."""
    better: Counter[tuple[int, ...]] = Counter()
    order = []
    for i in np.argsort(np.nan_to_num(costs, nan=np.inf), kind="stable").tolist():
        order.append((better[kinds[i]], float(np.nan_to_num(costs[i], nan=np.inf)), i))
        better[kinds[i]] += 1
    return [i for _, _, i in sorted(order)[:count]]
