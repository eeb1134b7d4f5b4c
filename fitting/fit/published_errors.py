"""Published parameter sets, assessed by the same figures as fits."""

import jax.numpy as jnp
import numpy as np

from ...merl_io.binary import Measurement
from ...merl_io.grid import merl_grid
from ...merl_io.inputs import Input
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples
from ...model import published
from ..support.choices import THETA_MAX
from . import error_metrics, scattered_errors
from .problem import energy
from .residuals import predict_samples


def sources_of(material: str) -> list[str]:
    """Published tables that have parameters for a material of this name."""
    return [source for source in published.SOURCES if material in published.materials(source)]


def assess_published(
    source: str, measurement: Measurement, samples: Samples, theta_max: float = THETA_MAX
) -> tuple[error_metrics.Errors, float]:
    """Errors and cost of a material's published parameters, Ngan's on the scale of MERL's files."""
    model, values = published.SOURCES[source].model, published.published(measurement.name, source, rescaled=True)
    predicted = predict_samples(model, {name: jnp.asarray(x) for name, x in values.items()}, samples)
    found, costs = assess_prediction(predicted, measurement, samples, theta_max)
    return found, float(costs.sum())


def assess_prediction(
    predicted: np.ndarray, measurement: Input, samples: Samples | ScatteredSamples, theta_max: float = THETA_MAX
) -> tuple[error_metrics.Errors, np.ndarray]:
    """Errors of a prediction on folded bins, (C, H, D, P), or on scattered samples, (C, S).

    Returns:
        these, and its cost per channel, relative to the energy.
    """
    squares = samples.weight * (samples.value - predicted) ** 2
    costs = np.sum(squares, tuple(range(1, squares.ndim))) / energy(samples)
    if isinstance(samples, ScatteredSamples) or isinstance(measurement, ScatteredMeasurement):
        assert isinstance(samples, ScatteredSamples)
        return scattered_errors.errors(samples, predicted), costs
    unfolded = np.concatenate([predicted, predicted[..., ::-1]], -1)  # bins phi_d and pi - phi_d are reciprocal
    found = error_metrics.errors(
        measurement.values, unfolded, measurement.valid, merl_grid(measurement.dims), theta_max
    )
    return found, costs
