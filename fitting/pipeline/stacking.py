"""Total integrated scatter as several models' posteriors have it, and as all of them have it together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...merl_io.inputs import Input
from ...merl_io.samples import Samples
from ..fit.problem import Problem
from ..fit.total_scatter import incidences_of
from ..posterior.likelihood import on_all
from ..posterior.stacking import log_densities, pieces_of, stacked
from ..results.schema import Result
from ..support.clock import Report, silent
from ..support.weighted import quantiles
from .draws import chain_file
from .resampling import fitted_of
from .search import AnySamples, make_coarse


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

    def plain(self, channels: Sequence[str]) -> dict[str, Any]:
        """As plain data of JSON."""

        def rows(x: np.ndarray) -> list[dict[str, Any]]:
            return [
                {"theta_i_deg": round(float(np.degrees(theta)), 3), "channel": channel,
                 **dict(zip(("q05", "q50", "q95"), x[:, c, k].tolist(), strict=True))}
                for k, theta in enumerate(self.theta_i) for c, channel in enumerate(channels)
            ]  # fmt: skip

        return {
            "format": "merlfit-stacked 1.0", "weights": self.weights, "pareto_k": self.pareto_k,
            "effective_bins": self.count, "pieces": self.pieces,
            "tis": {"together": rows(self.together), **{name: rows(x) for name, x in self.own.items()}},
        }  # fmt: skip


def scatter_of_several(
    results: Mapping[str, tuple[Result, Path]], measurement: Input, report: Report = silent
) -> ScatterOfSeveral:
    """Of results with posteriors, by name of the model.

    Args:
        results: with their paths; of the same measurement.

    Raises:
        merlfit.fitting.pipeline.draws.NoPicture: the chain of one cannot be read.
    """
    theta_i = incidences_of(measurement)
    found = {name: fitted_of(path, result, measurement) for name, (result, path) in results.items()}
    fits = {name: fitted for name, (fitted, _, _) in found.items()}
    best, samples, _ = min(found.values(), key=lambda each: each[0].model_error or each[0].solution.cost)
    problem, _ = make_coarse(samples)
    places, energy = _places(problem, samples)
    piece = pieces_of(energy, best.count)
    counts = best.count * np.bincount(piece, energy) / energy.sum()
    said, drawn, shares = [], [], []
    for name, (result, path) in results.items():
        report(f"{name}: what it says of what is left out")
        chain, fitted = chain_file(result, path), fits[name]
        points = fitted.layout.free(fitted.layout.structure.named(chain["values"]))
        weights = chain["weights"]
        likelihood = on_all(fitted.layout, fitted.solution.z, problem, fitted.noise)
        at_fit = likelihood.weighed(fitted.solution.z[None]) - likelihood.target
        variance = float(np.sum(at_fit.astype(float) ** 2)) / best.count
        said.append((log_densities(likelihood, points, piece[places], variance, counts), weights))
        drawn.append(fitted.scatter_at(points, theta_i))
        shares.append(weights / weights.sum())
    weighed = stacked(said)
    together = np.concatenate([w * each for w, each in zip(weighed.weights, shares, strict=True)])
    return ScatterOfSeveral(
        dict(zip(results, weighed.weights.tolist(), strict=True)),
        dict(zip(results, weighed.pareto_k.tolist(), strict=True)), best.count, len(counts), theta_i,
        {name: quantiles(x, w) for name, x, w in zip(results, drawn, shares, strict=True)},
        quantiles(np.concatenate(drawn), together),
    )  # fmt: skip


def _places(problem: Problem, samples: AnySamples) -> tuple[np.ndarray, np.ndarray]:
    """The place of each weighted residual, (M,), and the energy of all places, (S,).

    A place is a row of bins of all channels, or a scattered sample. Of bins those of one theta_d come one after the
    other, in order of theta_h.
    """
    found, energies, count = [], [], 0
    for part in problem.parts:
        target = np.asarray(part.target)  # (N, C, h, D, K)
        blocks, _, rows, columns, _ = target.shape
        order = np.arange(blocks * rows * columns).reshape(blocks, rows, columns)
        if isinstance(samples, Samples):
            order = np.moveaxis(order.reshape(columns, blocks, rows), 0, -1)
        found.append(count + np.broadcast_to(order[:, None, :, :, None], target.shape).ravel())
        energies.append(np.bincount(order.ravel(), np.sum(target.astype(float) ** 2, (1, 4)).ravel()))
        count += order.size
    return np.concatenate(found), np.concatenate(energies)
