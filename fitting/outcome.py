"""What a fit found, and how it is told in JSON."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import jax
import jax.numpy as jnp
import numpy as np

from ..merl_io.binary import OUTLIER, Measurement
from ..merl_io.samples import Samples
from ..model.effects import Effects
from ..model.parameters import WAVELENGTHS_UM
from ..model.two_scale import grazing_exponent
from . import export, metrics
from .config import Config
from .laplace import laplace_covariance
from .levenberg_marquardt import Solution, Status
from .problem import energy
from .transforms import layout_of

if TYPE_CHECKING:  # the sampler's libraries take a second to load
    from .posterior import Posterior

EDGE = 0.01  # of the way between its bounds: nearer to one of them a parameter may be at it
UNEXPLAINED_COST = 0.5  # of the measurement's energy; predicting no light at all costs 1
UNRESOLVED = 0.5  # standard error of logit(u), that is two standard errors from the bound: nearer it is at it
OUTLIERS = (
    "{count} bins of the file are outliers, over {times:g} times brighter than what is beside them: they dominate the "
    "RMSE, and the cost hardly feels them"
)
Bound = Literal["no", "lower", "upper"]


@dataclass(frozen=True)
class Fitted:
    """A fit on all bins.

    Attributes:
        effects: what was fitted. solution: where it ended. counts: effective sample counts per channel (C,).
        errors: metrics. candidates: bodies that were compared on the coarse grid.
    """

    effects: Effects
    solution: Solution
    counts: np.ndarray
    errors: metrics.Errors
    candidates: list[export.Candidate]

    @cached_property
    def deviation(self) -> np.ndarray:
        """Standard errors of the free coordinates by the Laplace approximation, (P,)."""
        return np.sqrt(np.diag(laplace_covariance(self.solution.normal, self.counts, self.solution.z)))

    @cached_property
    def at_bound(self) -> list[Bound]:
        """At which bound each entry is: within 1 % of it, and no two standard errors away (a dark albedo is not)."""
        u = layout_of(self.effects).position(self.solution.z)
        unresolved = self.deviation > UNRESOLVED
        return [
            "no" if not open_ or EDGE <= x <= 1 - EDGE else "lower" if x < EDGE else "upper"
            for x, open_ in zip(u, unresolved, strict=True)
        ]

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


def make_result(
    measurement: Measurement,
    samples: Samples,
    fitted: Fitted | None,
    chain: "Posterior | None",
    config: Config,
    seconds: dict[str, float],
) -> export.Result:
    """Everything that is known about one material, as it goes to JSON."""
    source = export.Source(
        path=str(measurement.path), material=measurement.name, sha1=measurement.sha1,
        git_blob_sha1=measurement.blob_sha1, genuine_merl=measurement.genuine,
        fraction_valid=float(measurement.valid.mean()), outliers=measurement.outliers,
    )  # fmt: skip
    bins = int(np.any(samples.weight > 0, axis=0).sum())
    common = {
        "source": source, "seconds": seconds, "seed": config.seed,
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
    )  # fmt: skip
    errors = export.Metrics(rmse=export.finite(fitted.errors.rmse), smape=export.finite(fitted.errors.smape))
    posterior = None if chain is None else _posterior_part(chain, fitted, measurement.name)
    return export.Result(
        model=_model_part(fitted.effects, s.z), parameters=parameter_results(fitted, chain), fit=fit_part,
        metrics=errors, posterior=posterior, **common,
    )  # fmt: skip


def parameter_results(fitted: Fitted, chain: "Posterior | None") -> list[export.ParameterResult]:
    """Every entry with value, Laplace standard error, posterior quantiles, bounds."""
    layout, z = layout_of(fitted.effects), fitted.solution.z
    deviation = fitted.deviation
    values, slopes = jax.jvp(layout.values, (jnp.asarray(z),), (jnp.ones(len(z)),))
    flat = [np.concatenate([np.ravel(part[q.name]) for q in layout.parameters]) for part in (values, slopes)]
    bounds = fitted.at_bound
    quantiles = None
    if chain is not None and chain.sufficient:
        quantiles = np.quantile(chain.values(layout), [0.05, 0.5, 0.95], axis=0)
    return [
        export.ParameterResult(
            name=name, parameter=q.name, symbol=q.symbol, channel=name.rsplit("_", 1)[-1] if q.per_channel else None,
            meaning=q.meaning, unit=q.unit, value=float(flat[0][i]),
            standard_error=export.finite(abs(flat[1][i]) * deviation[i]) if bounds[i] == "no" else None,
            quantiles=None if quantiles is None else export.Quantiles(
                q05=float(quantiles[0, i]), q50=float(quantiles[1, i]), q95=float(quantiles[2, i])),
            lower=q.lower, upper=q.upper,
            at_bound=bounds[i],
            prior=q.prior, source=q.source,
        )
        for i, (name, q) in enumerate(zip(layout.names, layout.entries, strict=True))
    ]  # fmt: skip


def _model_part(effects: Effects, z: np.ndarray) -> export.Model:
    layout = layout_of(effects)
    return export.Model(
        effects=effects, grazing_exponent=float(grazing_exponent(layout.values(jnp.asarray(z)), effects)),
        channels=list(layout.channels), wavelengths_um=list(WAVELENGTHS_UM),
    )  # fmt: skip


def _posterior_part(chain: "Posterior", fitted: Fitted, name: str) -> export.PosteriorResult:
    return export.PosteriorResult(
        sufficient=chain.sufficient, message=chain.message, steps=len(chain.chain), walkers=chain.chain.shape[1],
        acceptance=chain.acceptance,
        autocorrelation_steps=np.round(chain.autocorrelation, 2).tolist(),
        effective_size=np.round(chain.effective_size, 1).tolist(),
        effective_bins_per_channel=np.round(fitted.counts, 1).tolist(),
        thinning_error=export.finite(chain.thinning_error), chain_file=f"{name}.chain.npz",
    )  # fmt: skip
