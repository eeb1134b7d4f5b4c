"""Starting points: one read off the data, and others spread over the whole prior, the best of each kind.

What matters is where basins of attraction differ: how wide the lobe is, and of a two-scale material how much light is
diffracted, and whether that is the highlight, by a long correlation length, or a haze around it. Costs of starting
points of different kinds say little about where they lead; among points of one kind the lowest is a good guess. What is
per channel is not scattered but projected out (`projection`), or, where the model's channels are not separated, chosen
channel by channel among points of the prior.
"""

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from itertools import product

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats.qmc import Sobol

from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...model.sum import Sum
from .hints import StartHints, hints_of
from .problem import Problem
from .projection import project
from .residuals import Objective
from .sum_projection import project_sum
from .transforms import Layout

CANDIDATES_EACH = 7  # candidates for every starting point that is asked for; a power of 2 in all
OWN = 16  # points of the parameters per channel, for every candidate whose channels are not separated
NEAR = 0.3  # standard deviation of the coordinates that another reading of the data fixes
SCATTER = 1.5  # standard deviation of candidates in units of the prior's
DARK_QUANTILE = 0.1  # of the bins away from the lobe: taken for the body
LEAST_THETA_D, NEAREST, GROUPS = np.radians(15.0), 0.25, 40  # of scattered samples that show the highlight's width
RIM = 1e-3  # of the places of candidates between 0 and 1
Found = tuple[np.ndarray, dict[str, np.ndarray]]


def start_hints(samples: Samples | ScatteredSamples) -> StartHints:
    """What the data say of where to start."""
    if isinstance(samples, ScatteredSamples):
        return StartHints(_scattered_half_width(samples))
    return StartHints(half_width(samples.theta_h, samples.theta_d, samples.value, samples.weight > 0))


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


def _scattered_half_width(samples: ScatteredSamples) -> float:
    """The same of samples in no rows: groups of them by theta_h, from those whose theta_d is among the smallest."""
    near = samples.theta_d <= max(LEAST_THETA_D, float(np.quantile(samples.theta_d, NEAREST)))
    rank = np.argsort(samples.theta_h[near], kind="stable")
    groups = np.array_split(rank, min(GROUPS, len(rank)))
    theta_h = np.array([samples.theta_h[near][group].mean() for group in groups])
    counted = samples.weight[:, near] > 0
    value = np.where(counted, samples.value[:, near], 0.0)
    lobe = np.array([value[:, g].sum(1) / np.maximum(counted[:, g].sum(1), 1) for g in groups])  # (G, C)
    brightness = np.maximum(lobe - np.quantile(lobe, DARK_QUANTILE, axis=0), 0.0).mean(1)
    below = np.flatnonzero(brightness < brightness[:2].max() / 2)
    tangent = np.tan(np.minimum(theta_h, 1.5))
    return float(np.clip(tangent[below[0]] if len(below) and below[0] > 0 else tangent[0], 2e-3, 2.0))


def starting_points(
    layouts: Sequence[Layout],
    data: StartHints,
    problem: Problem,
    count: int,
    over: Callable[..., Iterable] = map,
    first: Mapping[str, float] | None = None,
) -> list[np.ndarray]:
    """So many starting points of every model and one more, in free coordinates, (count + 1, P) each.

    There are no random numbers in them: the same data have the same starting points.

    Args:
        problem: on which candidates are compared. over: maps a function over models, or over batches of candidates.
        first: shared parameters of the first instead of those that the data give.
    """
    alike: dict[Hashable, list[int]] = {}  # models with the same lobes have the same candidates
    for k, layout in enumerate(layouts):
        parted = hints_of(layout.model).linear
        alike.setdefault((parted.lobes, parted.fixed) if parted else k, []).append(k)
    every = [[layouts[k] for k in members] for members in alike.values()]
    if len(every) > 1:
        # A thread for each: while one waits for its programs the others go on. Not for batches, too: threads of a pool
        # that wait for that pool would wait for ever.
        points = over(lambda each: _of_alike(each, data, problem, count, map, first), every)
    else:
        points = [_of_alike(each, data, problem, count, over, first) for each in every]
    found: dict[int, np.ndarray] = {}
    for members, each in zip(alike.values(), points, strict=True):
        found |= dict(zip(members, each, strict=True))
    return [found[k] for k in range(len(layouts))]


def _of_alike(
    layouts: Sequence[Layout],
    data: StartHints,
    problem: Problem,
    count: int,
    over: Callable[..., Iterable],
    first: Mapping[str, float] | None,
) -> list[np.ndarray]:
    """The same of models with the same lobes.

    Candidates are a Sobol sequence over the prior of the shared parameters, shifted (modulo 1) so that its first point
    is the first reading of the data: another first reading moves all of them. Readings take turns: every candidate
    whose turn is not the first reading's lies near its reading. Of every kind the best is taken, then the second best,
    and so on.
    """
    lead = layouts[0].unfixed
    shared = [q.name for q in lead.parameters if not q.per_channel]  # they come first
    hints = hints_of(lead.model)
    size, strata = len(shared), hints.strata or {}
    readings = hints.starts(data, lead.bands.middle_um) or [{}]
    if unknown := {*strata, *(name for each in readings for name in each)} - {q.name for q in lead.parameters}:
        raise ValueError(f"{lead.model}: starts or strata name what is no parameter: {', '.join(sorted(unknown))}")
    moved = [[name for name, x in each.items() if x != readings[0].get(name)] for each in readings]
    if first is not None:
        readings[0] = {**first}
    readings[0] |= {name: each.start for name, each in lead.constraints if each.start is not None}
    typical = {q.name: q.default for q in lead.parameters}
    begun = [lead.free({**typical, **reading}) for reading in readings]
    most = 1 << (CANDIDATES_EACH * count - 1).bit_length()
    places = (ndtr(begun[0][:size] / SCATTER) + _sobol(size, most)) % 1.0
    points = np.tile(begun[0], (most, 1))
    points[1:, :size] = SCATTER * ndtri(np.clip(places[1:], RIM, 1 - RIM))
    turn = np.arange(most) % len(readings)
    for k in range(1, len(readings)):
        rows, columns = np.flatnonzero(turn == k)[:, None], [shared.index(name) for name in moved[k] if name in shared]
        points[rows, columns] = begun[k][columns] + NEAR / SCATTER * points[rows, columns]
    kinds = np.column_stack([(places * [strata.get(name, 1) for name in shared]).astype(int), turn])
    if hints.linear is None and not isinstance(lead.material, Sum):
        own = _classes(lead, size, most)
        kinds = np.column_stack([kinds, own])
        found = [_by_channel(layouts[0], points, size, readings[0], own, problem)]
    else:
        named = layouts[0].held(lead.values(points))
        given, summed = {name: named[name] for name in shared}, isinstance(lead.material, Sum)
        nothing = np.zeros(len(points))
        found = (
            [(nothing, project_sum(layout, given, problem, over)) for layout in layouts]
            if summed
            else project(layouts, given, problem, over)
        )
        for layout, (_, values) in zip(layouts, found, strict=True):
            for q in (q for q in layout.parameters if q.name not in values):
                values[q.name] = np.full((len(points), len(layout.bands)), q.default)
            for name, each in layout.constraints:
                if each.start is not None and name not in shared:
                    values[name][0] = each.start
        if summed:  # weights by least squares are no constants yet
            found = [(_costs(layout, v, problem), v) for layout, (_, v) in zip(layouts, found, strict=True)]
    rows_of_kinds = [tuple(each) for each in kinds.tolist()]
    chosen = [[0, *(1 + k for k in _best(costs[1:], rows_of_kinds[1:], count))] for costs, _ in found]
    return [
        layout.free({name: x[rows] for name, x in values.items()})
        for layout, rows, (_, values) in zip(layouts, chosen, found, strict=True)
    ]


def _costs(layout: Layout, values: Mapping[str, np.ndarray], problem: Problem) -> np.ndarray:
    """Costs (N,) of points by their values, as the layout holds them."""
    return np.asarray(Objective(layout, problem).costs_of_many(layout.held(values))).sum(-1)


def _classes(layout: Layout, size: int, count: int) -> np.ndarray:
    """Classes of the parameters per channel, (count, Q): all combinations take turns."""
    strata = hints_of(layout.model).strata or {}
    numbers = [strata.get(q.name, 1) for q in layout.parameters[size:]]
    every = np.array(list(product(*map(range, numbers)))).reshape(-1, len(numbers))
    return every[np.arange(count) % len(every)]


def _by_channel(
    layout: Layout, points: np.ndarray, size: int, known: Collection[str], classes: np.ndarray, problem: Problem
) -> Found:
    """Every candidate with points of the parameters per channel, of which each channel takes the best.

    No channel's cost knows of another's parameters. Every candidate has points of its own, within its classes; those
    of the first have what the data say of those named in ``known``.
    """
    own, channels = layout.parameters[size:], len(layout.bands)
    each = OWN if own else 1
    strata = hints_of(layout.model).strata or {}
    numbers = np.array([strata.get(q.name, 1) for q in own])
    around = _sobol(len(own), len(points) * each, skipped=1).reshape(len(points), each, len(own))
    around = SCATTER * ndtri(np.clip((classes[:, None] + around) / numbers, RIM, 1 - RIM))
    for k, q in enumerate(own):
        if q.name in known:
            around[0, :, k] = points[0, layout.slices[q.name].start + layout.bands.middle]
    every = np.concatenate(
        [np.repeat(points[:, :size], each, 0), np.repeat(around.reshape(-1, len(own)), channels, 1)], 1
    )
    values = layout.unfixed.values(every)
    for q in own:  # alike in all channels, whatever the prior of their differences
        values[q.name] = np.repeat(values[q.name][:, layout.bands.middle, None], channels, 1)
    values = layout.held(values)
    found = Objective(layout, problem).costs_of_many(values)
    costs = np.nan_to_num(np.asarray(found), nan=np.inf).reshape(len(points), each, channels)
    chosen = costs.argmin(1) + each * np.arange(len(points))[:, None]  # (N, C), of all rows
    given = {name: np.asarray(x) for name, x in values.items()}
    best = {name: x[chosen, np.arange(channels)] if x.ndim == 2 else x[chosen[:, 0]] for name, x in given.items()}
    return costs.min(1).sum(1), best


def _sobol(size: int, count: int, skipped: int = 0) -> np.ndarray:
    """Points in the unit cube, (count, size), after so many, of which the first is the cube's corner."""
    if not size:
        return np.zeros((count, 0))
    sequence = Sobol(size, scramble=False)
    return (sequence.fast_forward(skipped) if skipped else sequence).random(count)


def _best(costs: np.ndarray, kinds: Sequence[tuple[int, ...]], count: int) -> list[int]:
    """So many candidates: of every kind the best, then the second best, and so on."""
    better: Counter[tuple[int, ...]] = Counter()
    order, finite = [], np.nan_to_num(costs, nan=np.inf).tolist()
    for i in np.argsort(finite, kind="stable").tolist():
        order.append((better[kinds[i]], finite[i], i))
        better[kinds[i]] += 1
    return [i for _, _, i in sorted(order)[:count]]
