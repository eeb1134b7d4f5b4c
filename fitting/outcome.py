"""What a fit found, and how it is told in JSON."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import jax.numpy as jnp
import numpy as np

from ..merl_io.binary import OUTLIER, Measurement
from ..merl_io.samples import Samples
from ..model.derived import quantities
from ..model.measured import Measured
from ..model.parameters import WAVELENGTHS_UM
from ..model.reflectance import Reflectance
from ..model.two_scale import TwoScale
from . import export, metrics
from .config import Config
from .identifiability import identifiability
from .laplace import laplace_covariance
from .levenberg_marquardt import UNEXPLAINED_COST, Solution, Status
from .problem import energy
from .selection import alike, lost
from .transforms import ODDS, Layout
from .weights import BEND, Bend

if TYPE_CHECKING:  # the sampler's libraries take a second to load
    from .sampling import Sampled

EDGE = 0.01  # of the way between its bounds: nearer to one of them a parameter may be at it
POOR = 0.05  # of the measurement's energy: what a fit leaves of a file that the model does not describe well
METAL_FLOOR = 0.05  # albedo under a complex index: stray light and dust on a metal are less
RESOLVED = 2.0  # standard errors from a bound: further away a parameter is not at it, however near
OUTLIERS = (
    "{count} bins of the file are outliers, over {times:g} times brighter than what is beside them: they dominate the "
    "RMSE, and the cost hardly feels them"
)
Bound = Literal["no", "lower", "upper"]


@dataclass(frozen=True)
class Fitted:
    """A fit on all bins.

    Attributes:
        layout: what was fitted, and in which coordinates. solution: where it ended.
        count: effective sample count of the residuals. errors: metrics.
        candidates: models and their variants that were compared on the coarse grid.
        bend: of the weights that it was made with.
    """

    layout: Layout
    solution: Solution
    count: float
    errors: metrics.Errors
    candidates: list[export.Candidate]
    bend: Bend = BEND

    @property
    def material(self) -> Reflectance:
        """What was fitted, without the apparatus."""
        return self.layout.material

    @cached_property
    def values(self) -> np.ndarray:
        """Physical values, (P,)."""
        return np.asarray(self.layout.flat(jnp.asarray(self.solution.z)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the physical values, by the Laplace approximation, (P, P)."""
        slopes = np.asarray(self.layout.slopes(jnp.asarray(self.solution.z)))
        return slopes @ laplace_covariance(self.solution.normal, self.count) @ slopes.T

    @cached_property
    def standard_errors(self) -> np.ndarray:
        """Of the physical values, (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def at_bound(self) -> list[Bound]:
        """At which bound each entry is: within 1 % of it, and no two standard errors away.

        An albedo is at none, which its odds never reach: where 0 or 1 is as good, its standard error says so.
        """
        entries = self.layout.entries
        place = [float(q.position(x)) for q, x in zip(entries, self.values, strict=True)]
        error = [q.stretch(x) * e for q, x, e in zip(entries, self.values, self.standard_errors, strict=True)]
        near = [
            q.quantity != ODDS and min(x, 1 - x) < EDGE and min(x, 1 - x) <= RESOLVED * e
            for q, x, e in zip(entries, place, error, strict=True)
        ]
        return ["no" if not at else "lower" if x < EDGE else "upper" for x, at in zip(place, near, strict=True)]

    @property
    def status(self) -> Status:
        """How it ended."""
        if not (np.isfinite(self.solution.cost) and np.all(np.isfinite(self.solution.normal))):
            return Status.NON_FINITE
        if self.solution.cost > UNEXPLAINED_COST:
            return Status.UNEXPLAINED
        if not self.solution.converged:
            return Status.STEP_LIMIT
        return Status.CONVERGED if set(self.at_bound) == {"no"} else Status.AT_BOUND


def said(status: Status, measurement: Measurement) -> str:
    """What a status says, and what is wrong with the file however the fit ended."""
    if not (count := measurement.outliers):
        return status.value
    return f"{status.value}; {OUTLIERS.format(count=count, times=OUTLIER)}"


def cautions(fitted: Fitted, config: Config) -> list[str]:
    """What a user of the parameters should know, in words."""
    found, peak = [], fitted.errors.highlight
    if np.isfinite(peak) and lost(peak):
        adaptive = config.fit.weights == "adaptive"
        mend = "no exponent of the weights keeps it" if adaptive else "fit with --weights adaptive"
        found.append(f"the highlight is lost: at its peak the fit has {peak:.2g} times the file's brightness; {mend}")
    found += others(fitted)
    if fitted.status is Status.STEP_LIMIT:
        found.append("the cost was still falling when the fit stopped: raise fit.max_steps to go on")
    if fitted.solution.cost > POOR:
        found.append(
            f"the model does not describe this file well: {fitted.solution.cost:.0%} of its weighted energy is left"
        )
    names = fitted.layout.names
    if bound := [f"{n} ({at})" for n, at in zip(names, fitted.at_bound, strict=True) if at != "no"]:
        found.append(f"at a bound, so that a value beyond it may fit better: {', '.join(bound)}")
    values = dict(zip(names, fitted.values.tolist(), strict=True))
    if values.get("sigma_s", 0.0) > min(WAVELENGTHS_UM) / 2:
        found.append(
            "sigma_s is more than half a wavelength: nearly all light is diffracted, and its value is uncertain"
        )
    floor = max((x for name, x in values.items() if name.startswith("albedo")), default=0.0)
    if isinstance(fitted.material, TwoScale) and fitted.material.index == "complex" and floor > METAL_FLOOR:
        found.append("a body this bright lies under no metal: n and k are effective values, not those of a material")
    return found


def others(fitted: Fitted) -> list[str]:
    """Which other models, or variants of the model, describe the file about as well."""
    known = [(c, c.objective, c.cube_root, c.score) for c in fitted.candidates]
    full = [(c, j, e, score) for c, j, e, score in known if j is not None and e is not None and score is not None]
    fits = fitted.material.name, fitted.material.variant
    own = [k for k, (c, *_) in enumerate(full) if (c.model, c.variant) == fits]
    if not own:
        return []
    compared, *figures = zip(*full, strict=True)
    near = [
        f"{c.variant} ({figures[-1][k] - figures[-1][own[0]]:+.1f})"
        for k, c in enumerate(compared)
        if k != own[0] and alike(k, own[0], *figures)
    ]
    return [f"other models describe the file about as well (score against this one): {', '.join(near)}"] if near else []


def make_result(
    measurement: Measurement,
    samples: Samples,
    fitted: Fitted | None,
    sampled: "Sampled | None",
    config: Config,
    seconds: dict[str, float],
    accuracy: export.Accuracy | None = None,
) -> export.Result:
    """Everything that is known about one material, as it goes to JSON."""
    source = export.Source(
        path=str(measurement.path), material=measurement.name, sha1=measurement.sha1,
        git_blob_sha1=measurement.blob_sha1, genuine_merl=measurement.genuine,
        fraction_valid=float(measurement.valid.mean()), outliers=measurement.outliers,
    )  # fmt: skip
    bins = int(np.any(samples.weight > 0, axis=0).sum())
    common = {
        "source": source, "accuracy": accuracy, "seconds": seconds, "seed": config.seed,
        "versions": export.versions(), "config": config.model_dump(mode="json"),
    }  # fmt: skip
    if fitted is None or not np.isfinite(fitted.solution.cost):
        status = Status.NO_DATA if fitted is None else Status.NON_FINITE
        fit_part = export.Fit(
            status=status.name, message=status.value, succeeded=False, cost=None, cost_per_channel=None,
            folding_scatter=None, steps=0, relative_offset=None, bins=bins, candidates=[],
        )  # fmt: skip
        return export.Result(
            model=None, parameters=[], fit=fit_part, metrics=export.Metrics(rmse=None, smape=None), posterior=None,
            **common,
        )  # fmt: skip
    s, unit = fitted.solution, energy(samples)
    fit_part = export.Fit(
        status=fitted.status.name, message=said(fitted.status, measurement), succeeded=fitted.status.succeeded,
        cost=s.cost, cost_per_channel=s.normal[:, -1, -1].tolist(), folding_scatter=samples.scatter / unit,
        steps=s.steps, relative_offset=export.finite(s.offset), bins=bins, candidates=fitted.candidates,
        weights=fitted.bend, cautions=cautions(fitted, config),
    )  # fmt: skip
    errors = export.Metrics(**{name: export.finite(x) for name, x in asdict(fitted.errors).items()})
    found = identifiability(fitted.layout, s.normal, fitted.count, fitted.covariance)
    return export.Result(
        model=_model_part(fitted.layout, s.z), parameters=parameter_results(fitted), fit=fit_part,
        metrics=errors, identifiability=found, posterior=None, **common,
    ).model_copy(update={} if sampled is None else posterior_parts(fitted, sampled, measurement.name))  # fmt: skip


def parameter_results(fitted: Fitted, sampled: "Sampled | None" = None) -> list[export.ParameterResult]:
    """Every entry with value, Laplace standard error, posterior quantiles, bounds."""
    layout, bounds = fitted.layout, fitted.at_bound
    intervals = [None] * layout.size if sampled is None else _intervals(sampled, sampled.values)
    return [
        export.ParameterResult(
            name=name, parameter=q.name, symbol=q.symbol, channel=name.rsplit("_", 1)[-1] if q.per_channel else None,
            meaning=q.meaning, unit=q.unit, value=float(fitted.values[i]),
            standard_error=export.finite(fitted.standard_errors[i]) if bounds[i] == "no" else None,
            quantiles=intervals[i], lower=q.lower, upper=q.upper,
            at_bound=bounds[i],
            prior=layout.prior(q), source=q.source,
        )
        for i, (name, q) in enumerate(zip(layout.names, layout.entries, strict=True))
    ]  # fmt: skip


def _intervals(sampled: "Sampled", values: np.ndarray) -> list[export.Quantiles | None]:
    """Of every column of values (n, P) of the draws; none where the posterior is not to be trusted."""
    from .importance import quantiles

    if not sampled.posterior.sufficient:
        return [None] * values.shape[1]
    found = quantiles(values, sampled.posterior.weights)
    return [export.Quantiles(q05=low, q50=middle, q95=high) for low, middle, high in found.T.tolist()]


def derived_results(fitted: Fitted, sampled: "Sampled") -> list[export.DerivedResult]:
    """Every derived quantity with its value at the fit and posterior quantiles."""
    found, channels = [], fitted.layout.channels
    for q in quantities(fitted.material):
        values = sampled.derived[q.name].reshape(len(sampled.values), -1)
        given = zip(np.ravel(sampled.at_fit[q.name]).tolist(), _intervals(sampled, values), strict=True)
        for k, (value, interval) in enumerate(given):
            channel = channels[k] if q.per_channel else None
            found.append(export.DerivedResult(
                name=f"{q.name}_{channel}" if channel else q.name, quantity=q.name, channel=channel, meaning=q.meaning,
                unit=q.unit, value=value, quantiles=interval,
            ))  # fmt: skip
    return found


def _model_part(layout: Layout, z: np.ndarray) -> export.Model:
    measured = layout.model if isinstance(layout.model, Measured) else Measured(layout.model, "off")
    return export.Model.of(measured, layout.values(jnp.asarray(z)))


def posterior_parts(fitted: Fitted, sampled: "Sampled", name: str) -> dict[str, object]:
    """What sampling adds to a result, by field of it.

    Args:
        name: of the material, after which the file of the chain is named.
    """
    p, d = sampled.posterior, sampled.posterior.diagnosis
    spread = np.sqrt(p.weights @ (p.draws - p.weights @ p.draws) ** 2)  # 1 is the prior's
    posterior = export.PosteriorResult(
        sufficient=p.sufficient, message=p.message, steps=len(p.chain.states), walkers=p.chain.states.shape[1],
        acceptance=p.chain.acceptance, effective_bins=round(fitted.count, 2), draws=len(p.draws),
        pareto_k=export.finite(p.pareto_k), coordinates=list(fitted.layout.coordinates),
        autocorrelation_steps=_numbers(d.times, 2), r_hat=_numbers(d.r_hat, 4),
        bulk_size=_numbers(d.bulk), tail_size=_numbers(d.tail), effective_size=_numbers(p.effective_size),
        contraction=_numbers(1 - spread, 3), chain_file=f"{name}.chain.npz",
    )  # fmt: skip
    return {
        "parameters": parameter_results(fitted, sampled), "derived": derived_results(fitted, sampled),
        "posterior": posterior,
    }  # fmt: skip


def _numbers(values: np.ndarray, digits: int = 1) -> list[float | None]:
    return [export.finite(round(float(x), digits)) for x in values]
