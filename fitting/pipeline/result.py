"""What a fit found, as it goes to JSON."""

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from ...merl_io.bands import ColourSpace
from ...merl_io.inputs import Input, remarks
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples
from ...model.derived import quantities
from ...model.measured import Measured
from ..fit.identifiability import identifiability
from ..fit.levenberg_marquardt import Status
from ..fit.outcome import Fitted, cautions, said
from ..fit.problem import energy
from ..fit.total_scatter import SAME, incidences_of, of_file
from ..fit.transforms import Layout
from ..results import schema, storage
from ..results.schema_posterior import sha1_of_draws
from ..settings.config import Config
from ..settings.sections import AUTO
from ..support.weighted import quantiles

if TYPE_CHECKING:  # the sampler's libraries take a second to load
    from ..posterior.sampling import Sampled

OVERSTATED, LEAST_EXPECTED = 0.7, 30  # times stated uncertainties: smaller residuals are told; of so many at least


def make_result(
    measurement: Input,
    samples: Samples | ScatteredSamples,
    fitted: Fitted | None,
    sampled: "Sampled | None",
    config: Config,
    seconds: dict[str, float],
    accuracy: schema.Accuracy | None = None,
) -> schema.Result:
    """Everything that is known about one material, as it goes to JSON."""
    source = schema.Source(
        path=str(measurement.path), material=measurement.name, sha1=measurement.sha1,
        format=measurement.format, git_blob_sha1=measurement.blob_sha1, genuine_merl=measurement.genuine,
        dims=measurement.dims, fraction_valid=float(measurement.valid.mean()), outliers=measurement.outliers,
        quantity=measurement.quantity, fraction_uncertain=measurement.fraction_uncertain,
    )  # fmt: skip
    bins = int(np.any(samples.weight > 0, axis=0).sum())
    common = {
        "source": source, "accuracy": accuracy, "seconds": seconds, "seed": config.seed,
        "versions": storage.versions(), "config": config.plain(),
    }  # fmt: skip
    if fitted is None or fitted.status is Status.NON_FINITE:
        status = Status.NO_DATA if fitted is None else Status.NON_FINITE
        fit_part = schema.Fit(
            status=status.name, message=status.value, succeeded=False, cost=None, cost_per_channel=None,
            folding_scatter=None, steps=0, relative_offset=None, bins=bins, candidates=[],
        )  # fmt: skip
        return schema.Result(
            model=None, parameters=[], fit=fit_part, metrics=schema.Metrics(rmse=None, smape=None), posterior=None,
            **common,
        )  # fmt: skip
    s, unit = fitted.solution, energy(samples)
    fit_part = schema.Fit(
        status=fitted.status.name, message=said(fitted.status, measurement), succeeded=fitted.status.succeeded,
        cost=s.cost, cost_per_channel=fitted.costs.tolist(), folding_scatter=samples.scatter / unit,
        steps=s.steps, relative_offset=storage.finite(s.offset), bins=bins, candidates=fitted.candidates,
        weights=fitted.exponent, effective_bins=round(fitted.count, 2), model_error=fitted.model_error,
        cautions=[
            *cautions(fitted, config.fit.weights, config.model.name == AUTO), *overstated(fitted, samples),
            *unread(measurement), *remarks(measurement),
        ],
    )  # fmt: skip
    errors = schema.Metrics(**{name: storage.finite(x) for name, x in asdict(fitted.errors).items()})
    found = identifiability(fitted.layout, fitted.noise, fitted.covariance)
    result = schema.Result(
        model=_model_part(fitted.layout, s.z, measurement.colour_space), parameters=parameter_results(fitted),
        fit=fit_part, metrics=errors, identifiability=found, posterior=None,
        tis=total_scatter_results(fitted, measurement, sampled), **common,
    )  # fmt: skip
    more = {} if sampled is None else posterior_parts(result.parameters, fitted, sampled, measurement.name)
    return result.model_copy(update={"numbers_sha1": result.digest, **more})


def overstated(fitted: Fitted, samples: Samples | ScatteredSamples) -> list[str]:
    """A line where residuals are far smaller than the uncertainties that the file states."""
    if fitted.model_error is None:
        return []
    expected = np.count_nonzero(samples.weight) - fitted.layout.size
    squares = fitted.solution.cost * energy(samples) / fitted.model_error**2  # in units of what is expected of each
    if expected < LEAST_EXPECTED or squares > OVERSTATED**2 * expected:
        return []
    return [
        f"the file's uncertainties are {(expected / squares) ** 0.5:.2g} times as large as the residuals: are they "
        "expanded ones (k = 2), or errors that all values share? Standard uncertainties (k = 1) of the noise are wanted"
    ]


def unread(measurement: Input) -> list[str]:
    """A line that says how many of the file's wavelengths were fitted, if not all."""
    if not measurement.left_out:
        return []
    count = len(measurement.bands)
    return [
        f"{count} of the file's {count + measurement.left_out} wavelengths were fitted, evenly spaced (docs/rgl.md)"
    ]


def parameter_results(fitted: Fitted) -> list[schema.ParameterResult]:
    """Every entry with value, interval by the Laplace approximation and bounds."""
    layout, bounds = fitted.layout, fitted.at_bound
    intervals = [
        schema.Quantiles(q05=ends[0], q50=float(value), q95=ends[1]) if ends and at == "no" else None
        for ends, value, at in zip(fitted.laplace, fitted.values, bounds, strict=True)
    ]
    return [
        schema.ParameterResult(
            name=name, parameter=q.name, symbol=q.symbol, channel=name.rsplit("_", 1)[-1] if q.per_channel else None,
            meaning=q.meaning, unit=q.unit, value=float(fitted.values[i]),
            laplace=intervals[i], quantiles=None, lower=q.lower, upper=q.upper,
            at_bound=bounds[i], fitted=layout.kinds[i],
            prior=layout.prior(q), source=q.source,
        )
        for i, (name, q) in enumerate(zip(layout.names, layout.entries, strict=True))
    ]  # fmt: skip


def with_quantiles(parameters: list[schema.ParameterResult], sampled: "Sampled") -> list[schema.ParameterResult]:
    """The fit's parameters, to the last digit, with their posterior quantiles."""
    found = _intervals(sampled, sampled.values)
    given = zip(parameters, found, strict=True)
    return [q.model_copy(update={"quantiles": None if q.fitted == "fixed" else each}) for q, each in given]


def _intervals(sampled: "Sampled", values: np.ndarray) -> list[schema.Quantiles | None]:
    """Interval of every column of values (n, P) of the draws; none where the posterior is not to be trusted."""
    if not sampled.posterior.sufficient:
        return [None] * values.shape[1]
    found = quantiles(values, sampled.posterior.weights)
    return [schema.Quantiles(q05=low, q50=middle, q95=high) for low, middle, high in found.T.tolist()]


def derived_results(fitted: Fitted, sampled: "Sampled") -> list[schema.DerivedResult]:
    """Every derived quantity with its value at the fit and posterior quantiles."""
    found, channels = [], fitted.layout.channels
    for q in quantities(fitted.material):
        values = sampled.derived[q.name].reshape(len(sampled.values), -1)
        given = zip(np.ravel(sampled.at_fit[q.name]).tolist(), _intervals(sampled, values), strict=True)
        for k, (value, interval) in enumerate(given):
            channel = channels[k] if q.per_channel else None
            found.append(schema.DerivedResult(
                name=f"{q.name}_{channel}" if channel else q.name, quantity=q.name, channel=channel, meaning=q.meaning,
                unit=q.unit, value=value, quantiles=interval,
            ))  # fmt: skip
    return found


def total_scatter_results(fitted: Fitted, measurement: Input, sampled: "Sampled | None") -> list[schema.TotalScatter]:
    """Total integrated scatter of the fit by incidence and channel, beside the file's own and what it states."""
    theta_i, channels = incidences_of(measurement), fitted.layout.channels
    at_fit, ends = fitted.total_scatter(theta_i)
    own, stated = of_file(measurement, theta_i), [None] * len(theta_i)
    if isinstance(measurement, ScatteredMeasurement) and len(channels) == 1:
        at = {k: x for k, t in enumerate(theta_i) for theta, x in measurement.stated_tis if abs(theta - t) < SAME}
        stated = [at.get(k) for k in range(len(theta_i))]
    drawn: list[schema.Quantiles | None] = [None] * at_fit.size
    if sampled is not None and sampled.posterior.sufficient:
        scatter = fitted.scatter_at(sampled.posterior.draws, theta_i)
        drawn = _intervals(sampled, scatter.reshape(len(scatter), -1))
    return [
        schema.TotalScatter(
            theta_i_deg=round(float(np.degrees(theta)), 3), channel=channel, value=float(at_fit[c, k]),
            laplace=_ends(ends[0, c, k], at_fit[c, k], ends[1, c, k]), quantiles=drawn[c * len(theta_i) + k],
            file=storage.finite(float(own[c, k])), stated=stated[k],
        )
        for k, theta in enumerate(theta_i) for c, channel in enumerate(channels)
    ]  # fmt: skip


def _ends(low: float, value: float, high: float) -> schema.Quantiles | None:
    return schema.Quantiles(q05=low, q50=value, q95=high) if np.isfinite(low + high) else None


def _model_part(layout: Layout, z: np.ndarray, colour_space: ColourSpace) -> schema.Model:
    measured = layout.model if isinstance(layout.model, Measured) else Measured(layout.model, "off")
    return schema.Model.of(measured, layout.values(z), layout.bands, colour_space)


def posterior_parts(
    parameters: list[schema.ParameterResult], fitted: Fitted, sampled: "Sampled", name: str
) -> dict[str, object]:
    """What sampling adds to a result, by field of it.

    Args:
        parameters: of the fit.
        name: of the material, after which the file of the chain is named.
    """
    p, d = sampled.posterior, sampled.posterior.diagnosis
    deviation = np.sqrt(p.weights @ (p.draws - p.weights @ p.draws) ** 2)  # 1 is the prior's
    posterior = schema.PosteriorResult(
        sufficient=p.sufficient, message=p.message, steps=len(p.chain.states), walkers=p.chain.states.shape[1],
        acceptance=p.chain.acceptance, effective_bins=round(fitted.count, 2), draws=len(p.draws),
        pareto_k=storage.finite(p.pareto_k), coordinates=list(fitted.layout.coordinates),
        autocorrelation_steps=_numbers(d.times, 2), r_hat=_numbers(d.r_hat, 4),
        bulk_size=_numbers(d.bulk), tail_size=_numbers(d.tail), effective_size=_numbers(p.effective_size),
        contraction=_numbers(1 - deviation, 3), chain_file=f"{name}.chain.npz",
        draws_sha1=sha1_of_draws(sampled.values, p.weights),
    )  # fmt: skip
    return {
        "parameters": with_quantiles(parameters, sampled), "derived": derived_results(fitted, sampled),
        "posterior": posterior,
    }  # fmt: skip


def _numbers(values: np.ndarray, digits: int = 1) -> list[float | None]:
    return [storage.finite(round(float(x), digits)) for x in values]
