"""What a fit found, and what a user of it should know."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ...merl_io.binary import OUTLIER
from ...merl_io.inputs import Input
from ...model.parameters import Parameter
from ...model.reflectance import Reflectance
from ...model.two_scale import TwoScale
from ..results import schema
from ..support.choices import EXPONENT, Exponent, Weights
from . import error_metrics, plausible
from .largest_albedo import largest_albedo
from .levenberg_marquardt import UNEXPLAINED_COST, Solution, Status
from .noise import Noise
from .selection import VISIBLE, alike, lost
from .total_scatter import of_values, with_slopes
from .transforms import ODDS, Layout

EDGE = 0.01  # of the way between its bounds: nearer to one of them a parameter may be at it
DECIDED = np.sqrt(0.5)  # of the prior's standard deviation: data leave as much that say as much as the prior
POOR = 0.05  # of the measurement's energy: what a fit leaves of a file that the model does not describe well
RESOLVED = 2.0  # standard errors from a bound: further away a parameter is not at it, however near
NINETY = 1.6449  # standard deviations to both sides that hold 90 % of a normal distribution
UNREAL = ", but no matter is like that"
OUTLIERS = (
    "{count} bins of the file are outliers, over {times:g} times brighter than what is beside them: they dominate the "
    "RMSE, and the cost hardly feels them"
)
Bound = Literal["no", "lower", "upper"]


@dataclass(frozen=True)
class Fitted:
    """A fit on all bins.

    Attributes:
        layout: what was fitted, and in which coordinates.
        solution: where it ended, with the cost of all bins and the normal equations of the last grid.
        costs: of all bins, by channel (C,). noise: of the residuals. errors: metrics.
        candidates: models and their variants that were compared on the coarse grid.
        exponent: of the weights that it was made with. model_error: that these assume beside the file's uncertainties
            (1/sr); None where it states none.
    """

    layout: Layout
    solution: Solution
    costs: np.ndarray
    noise: Noise
    errors: error_metrics.Errors
    candidates: list[schema.Candidate]
    exponent: Exponent = EXPONENT
    model_error: float | None = None

    @property
    def material(self) -> Reflectance:
        """What was fitted, without the apparatus."""
        return self.layout.material

    @property
    def count(self) -> float:
        """N, how many independent residuals those of all bins are worth."""
        return self.noise.count

    @cached_property
    def values(self) -> np.ndarray:
        """Physical values, (P,)."""
        return np.asarray(self.layout.flat(self.solution.z))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the physical values, by the Laplace approximation, (P, P)."""
        slopes = np.asarray(self.layout.slopes(self.solution.z))
        return slopes @ self.noise.covariance @ slopes.T

    @cached_property
    def standard_errors(self) -> np.ndarray:
        """Standard errors of the physical values, (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def laplace(self) -> list[tuple[float, float] | None]:
        """90 % intervals of the physical values by the Laplace approximation; None where the data do not decide.

        Each value is normal in its own free coordinate, which has the others at the fit: with J the slopes and C the
        covariance there, of the standard deviation sqrt((J C J^T)_ii) / J_ii. So an interval holds the value, keeps
        within the bounds and is as skew as the coordinate. The data decide where this is below `DECIDED` of what
        the prior alone, C = 1, leaves. What is fixed has none.
        """
        z, slopes = np.asarray(self.solution.z), np.asarray(self.layout.slopes(self.solution.z))
        source = self.layout.table.source
        own, prior = np.abs(slopes[np.arange(len(slopes)), source]), np.linalg.norm(slopes, axis=1)

        def end(k: int, steps: float) -> float:
            return float(np.asarray(self.layout.flat(z + steps / own[k] * (np.arange(len(z)) == source[k])))[k])

        return [
            (end(k, -NINETY * error), end(k, NINETY * error)) if error < DECIDED * prior[k] and own[k] > 0 else None
            for k, error in enumerate(self.standard_errors)
        ]

    def total_scatter(self, theta_i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Total integrated scatter at incidences (rad), (A,): (C, A), and ends of its 90 % interval, (2, C, A).

        It is taken to be normal in its logarithm; NaN where the data do not decide, as of :attr:`laplace`.
        """
        values = self.layout.values(self.solution.z)
        at_fit, slopes = with_slopes(self.material, values, self.layout.bands, theta_i)
        by_entry = np.zeros((*at_fit.shape, len(self.values)))
        for name, slope in slopes.items():
            for k in range(self.layout.slices[name].start, self.layout.slices[name].stop):
                own = k - self.layout.slices[name].start if self.layout.entries[k].per_channel else slice(None)
                by_entry[own, :, k] = slope[own]
        error = np.sqrt(np.einsum("cap,pq,caq->ca", by_entry, self.covariance, by_entry))
        prior = np.linalg.norm(by_entry @ np.asarray(self.layout.slopes(self.solution.z)), axis=-1)
        relative = np.where((error < DECIDED * prior) & (at_fit > 0), error / np.maximum(at_fit, 1e-30), np.nan)
        return at_fit, at_fit * np.exp(NINETY * np.stack([-relative, relative]))

    def scatter_at(self, points: np.ndarray, theta_i: np.ndarray) -> np.ndarray:
        """Total integrated scatter at free coordinates (n, F) and incidences (rad), (A,): (n, C, A)."""
        return of_values(self.material, self.layout.values(points), self.layout.bands, theta_i)

    @cached_property
    def at_bound(self) -> list[Bound]:
        """At which bound each entry is: within 1 % of it, and no two standard errors away.

        An albedo is at neither 0 nor 1, which its odds never reach: where they are as good, its standard error says so.
        """
        entries = self.layout.entries
        place = [float(q.position(x)) for q, x in zip(entries, self.values, strict=True)]
        error = [q.slope(x) * e for q, x, e in zip(entries, self.values, self.standard_errors, strict=True)]
        near = [
            kind != "fixed" and not _endless(q) and min(x, 1 - x) < EDGE and min(x, 1 - x) <= RESOLVED * e
            for kind, q, x, e in zip(self.layout.kinds, entries, place, error, strict=True)
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


def _endless(q: Parameter) -> bool:
    """Whether its odds may be of any size, so that it comes to no bound."""
    return q.quantity == ODDS and (q.lower, q.upper) == (0.0, 1.0)


def said(status: Status, measurement: Input) -> str:
    """What a status says, and what is wrong with the file however the fit ended."""
    if not (count := measurement.outliers):
        return status.value
    return f"{status.value}; {OUTLIERS.format(count=count, times=OUTLIER)}"


def cautions(fitted: Fitted, weights: Weights, richer: bool = False) -> list[str]:
    """What a user of the parameters should know, in words.

    Args:
        weights: that were asked for. richer: whether sums of lobes were asked for, too.
    """
    found, peak = [], fitted.errors.highlight
    if np.isfinite(peak) and lost(peak):
        other = "none" if np.isnan(fitted.errors.picture) else "adaptive"  # which compares pictures
        tried = weights in (other, "adaptive")
        mend = "no exponent of the weights keeps it" if tried else f"fit with --weights {other}"
        found.append(f"the highlight is lost: the fit's peak is {peak:.2g} times as bright as the file's; {mend}")
    lit = {name: getattr(fitted.errors, name) for name in ("lamp", "environment")}
    if max(lit.values()) > VISIBLE:
        off = ", ".join(f"{x:.2g} under {'a lamp' if name == 'lamp' else 'an environment'}" for name, x in lit.items())
        found.append(f"it does not look like the file: spheres differ by {off} (CIELAB of lit pixels, 1 is noticeable)")
    poor = bool(found) or fitted.solution.cost > POOR
    found += others(fitted)
    if fitted.status is Status.STEP_LIMIT:
        found.append("the cost was still falling when the fit stopped: raise fit.max_steps to go on")
    if fitted.solution.cost > POOR:
        found.append(
            f"the model does not describe this file well: {fitted.solution.cost:.0%} of its weighted energy is left"
        )
    if poor and not richer and isinstance(fitted.material, TwoScale):
        found.append("one lobe may be too few: --model auto tries a second lobe, a coat, a film and gratings, too")
    if bound := [_near(fitted, k) for k, at in enumerate(fitted.at_bound) if at != "no"]:
        found.append(f"at a bound, so that a value beyond it may fit better: {', '.join(bound)}")
    values = {name: fitted.values[s] for name, s in fitted.layout.slices.items()}
    bands = fitted.layout.bands
    found += plausible.cautions(fitted.material, values, bands.names, bands.wavelengths_um)
    return found + excess(fitted)


def _near(fitted: Fitted, k: int) -> str:
    """A name, and how near it is to the bound that it is at."""
    q, value, at = fitted.layout.entries[k], fitted.values[k], fitted.at_bound[k]
    away, bound = float(q.position(value)), q.lower if at == "lower" else q.upper
    away = away if at == "lower" else 1 - away
    scale = "logarithmic range" if q.scale == "log" else "range"
    return f"{fitted.layout.names[k]} {value:.4g} ({at}, {bound:g}, to {max(away, 0.0):.1%} of the {scale})"


def excess(fitted: Fitted) -> list[str]:
    """A line where the material gives back more light than it receives."""
    material = fitted.material
    brightest = largest_albedo(material, fitted.layout.values(fitted.solution.z), fitted.layout.bands)
    if brightest is None or not brightest.excessive:
        return []
    mend = "--preset conserving" if isinstance(material, TwoScale) else f"--model {TwoScale.name} --preset conserving"
    return [
        f"the material gives back more light than it receives: {brightest.albedo:.2f} times as much at "
        f"{brightest.degrees:.0f} degrees ({brightest.channel}); fit with {mend}, which does not"
    ]


def explains(candidate: schema.Candidate) -> bool:
    """Whether a kind leaves no more of the file than a fit may that succeeds."""
    return candidate.cost is not None and candidate.cost <= UNEXPLAINED_COST


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
        f"{c.variant} ({figures[-1][k] - figures[-1][own[0]]:+.1f}{'' if c.of_matter else UNREAL})"
        for k, c in enumerate(compared)
        if k != own[0] and alike(k, own[0], *figures) and (fitted.status is Status.UNEXPLAINED or explains(c))
    ]
    return [f"other models describe the file about as well (score against this one): {', '.join(near)}"] if near else []
