"""Published parameter sets, judged by the same figures as fits."""

import jax.numpy as jnp
import numpy as np

from ...merl_io.binary import Measurement
from ...merl_io.grid import merl_grid
from ...merl_io.samples import Samples
from ...model import published
from ..objective.problem import directions, energy
from ..objective.residuals import predict
from ..objective.weights import THETA_MAX
from . import metrics


def sources_of(material: str) -> list[str]:
    """Published tables that have parameters for a material of this name."""
    return [source for source in published.SOURCES if material in published.materials(source)]


def judged(
    source: str, measurement: Measurement, samples: Samples, theta_max: float = THETA_MAX
) -> tuple[metrics.Errors, float]:
    """Errors and cost of a material's published parameters, Ngan's on the scale of MERL's files."""
    model, values = published.SOURCES[source].model, published.published(measurement.name, source, rescaled=True)
    where = directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o, samples.bands)
    predicted = predict(model, {name: jnp.asarray(x) for name, x in values.items()}, where)
    found, costs = judge(predicted, measurement, samples, theta_max)
    return found, float(costs.sum())


def judge(
    predicted: np.ndarray, measurement: Measurement, samples: Samples, theta_max: float = THETA_MAX
) -> tuple[metrics.Errors, np.ndarray]:
    """Errors of a prediction on folded bins, (C, H, D, P), and its cost per channel, relative to the energy."""
    unfolded = np.concatenate([predicted, predicted[..., ::-1]], -1)  # bins phi_d and pi - phi_d are reciprocal
    found = metrics.errors(measurement.values, unfolded, measurement.valid, merl_grid(measurement.dims), theta_max)
    return found, np.sum(samples.weight * (samples.value - predicted) ** 2, (1, 2, 3)) / energy(samples)
