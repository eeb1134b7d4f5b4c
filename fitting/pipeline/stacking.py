"""Total integrated scatter as several models' posteriors have it, and as all of them have it together."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...merl_io.inputs import Input
from ...merl_io.samples import Samples
from ..fit.problem import energy
from ..fit.residuals import predict_samples
from ..fit.total_scatter import incidences_of, of_values
from ..fit.transforms import Layout
from ..posterior.stacking import Said, pieces_of, stacked
from ..results.schema import Result
from ..settings.config import parse
from ..support.threads import CORES
from ..support.weighted import quantiles, resampled
from .draws import chain_file
from .models import layout_for
from .search import COARSE, AnySamples, thinned

DRAWS = 400  # of each posterior


@dataclass(frozen=True)
class ScatterOfSeveral:
    """What posteriors of several models of one file say.

    Attributes:
        weights: of the models by name, sum 1 (`posterior.stacking`). pareto_k: their largest. count: N, how many
            independent residuals there are. pieces: in how many the data were parted.
        theta_i: incidences (rad), (A,). own: median and ends of the 90 % interval by model, (3, C, A): 5, 50 and 95 %.
        together: the same of all models with their weights.
    """

    weights: dict[str, float]
    pareto_k: dict[str, float]
    count: float
    pieces: int
    theta_i: np.ndarray
    own: dict[str, np.ndarray]
    together: np.ndarray


def scatter_of_several(
    results: Mapping[str, tuple[Result, Path]], measurement: Input, samples: AnySamples
) -> ScatterOfSeveral:
    """Of results with posteriors, by name of the model.

    Args:
        results: with their paths. samples: of the file, weighted alike for all models.

    Raises:
        merlfit.fitting.pipeline.draws.NoPicture: the chain of one cannot be read.
    """
    few, theta_i = thinned(samples, COARSE), incidences_of(measurement)
    costs = [(r.fit.cost or 0.0, r.fit.effective_bins or 1.0) for r, _ in results.values()]
    count = min(costs)[1]
    pieces = pieces_of(_places(few, few.weight * few.value**2), count)
    said, drawn = [], []
    for result, path in results.values():
        assert result.model is not None
        layout = layout_for(parse(result.config, result.source.material), result.model.measured, result.model.bands)
        chain = chain_file(result, path)
        rows = resampled(chain["weights"], DRAWS)
        values = layout.structure.named(chain["values"][rows])
        variance = (result.fit.cost or 0.0) / count
        likelihood = np.asarray(chain["log_likelihood"])[rows]
        said.append(Said.of(_squares(layout, values, few), pieces, likelihood, variance, count))
        drawn.append(of_values(layout.material, values, layout.bands, theta_i))
    found = stacked(said)
    shares = np.repeat(found.weights / DRAWS, DRAWS)
    return ScatterOfSeveral(
        dict(zip(results, found.weights.tolist(), strict=True)),
        dict(zip(results, found.pareto_k.tolist(), strict=True)), count, int(pieces.max()) + 1, theta_i,
        {name: quantiles(each, np.ones(DRAWS)) for name, each in zip(results, drawn, strict=True)},
        quantiles(np.concatenate(drawn), shares),
    )  # fmt: skip


def _squares(layout: Layout, values: Mapping[str, np.ndarray], few: AnySamples) -> np.ndarray:
    """Weighted squares of residuals for draws, relative to the energy of all, (n, S)."""

    def of_one(k: int) -> np.ndarray:
        predicted = predict_samples(layout.model, {name: x[k] for name, x in values.items()}, few)
        return _places(few, few.weight * (few.value - predicted) ** 2) / energy(few)

    with ThreadPoolExecutor(CORES) as pool:
        return np.stack(list(pool.map(of_one, range(DRAWS))))


def _places(few: AnySamples, x: np.ndarray) -> np.ndarray:
    """Sums over the channels in an order in which neighbours in theta_d, then theta_h, stay together, (S,)."""
    summed = np.nan_to_num(x).sum(0)
    return (summed.swapaxes(0, 1) if isinstance(few, Samples) else summed).ravel()
