"""Numbers that were found: parameters with their errors, what the data determine of them, and derived quantities."""

from typing import Literal, Self

from pydantic import model_validator

from .strict import Many, Strict, same_length

ROUNDING = 1e-9  # relative: by so much a value may lie beyond a bound


class Quantiles(Strict):
    """Quantiles of a distribution: a 90 % interval and what lies in the middle."""

    q05: float
    """5 % lie below it."""
    q50: float
    """Median."""
    q95: float
    """95 % lie below it."""


class ParameterResult(Strict):
    """One fitted number."""

    name: str
    """Unique name: that of the parameter, followed by the channel if there is one per channel (``eta_R``)."""
    parameter: str
    """Name of the parameter, as the model takes it (``eta``)."""
    symbol: str
    """Symbol in the papers (TeX)."""
    channel: str | None
    """Colour channel; null where all channels share the parameter."""
    meaning: str
    """What it is, in words."""
    unit: str
    """Unit of the numbers; "um" is micrometres, "1" no unit."""
    value: float
    """Fitted value."""
    laplace: Quantiles | None
    """By the Laplace approximation in free coordinates, around the fitted value and within the bounds
    (docs/statistics.md); null at a bound and where the prior says more than the data."""
    quantiles: Quantiles | None
    """Quantiles of the posterior; null without a posterior that is good enough."""
    lower: float
    """Lower bound of the fit."""
    upper: float
    """Upper bound of the fit."""
    at_bound: Literal["no", "lower", "upper"]
    """At which bound the value is."""
    fitted: Literal["free", "fixed", "tied"] = "free"
    """Whether it was fitted by itself, given by the user, or has the value of the middle channel."""
    prior: str
    """Prior in words; `identifiability.priors` has it for programs."""
    source: str
    """Where the papers define the parameter."""

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        slack = ROUNDING * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= self.value <= self.upper + slack:
            raise ValueError(f"{self.name} {self.value:g} is outside its bounds [{self.lower:g}, {self.upper:g}]")
        return self


class DerivedResult(Strict):
    """One derived quantity, of the material without the apparatus."""

    name: str
    """Unique name: that of the quantity, followed by the channel if there is one per channel."""
    quantity: str
    """Name of the quantity."""
    channel: str | None
    """Colour channel; null where all channels share the quantity."""
    meaning: str
    """What it is, in words."""
    unit: str
    """Unit of the numbers; "1" is no unit."""
    value: float
    """At the fit."""
    quantiles: Quantiles | None
    """Quantiles of the posterior; null without a posterior that is good enough."""


class TotalScatter(Strict):
    """Total integrated scatter (TIS): the share of the light from one direction that comes back, in one channel."""

    theta_i_deg: float
    """Angle of the light to the normal (degrees)."""
    channel: str
    """Colour channel or wavelength."""
    value: float
    """Of the fitted material, without the apparatus: the integral of the BRDF times cos theta_o over all viewers."""
    laplace: Quantiles | None
    """By the Laplace approximation, as a log-normal distribution; null where the prior says more than the data."""
    quantiles: Quantiles | None
    """Quantiles of the posterior; null without a posterior that is good enough."""
    file: float | None
    """Integral of the file's own values (docs/result.md); null where its samples do not cover the hemisphere."""
    stated: float | None
    """What the file itself states; null where it does not."""


class Direction(Strict):
    """A direction in free coordinates that the data do not determine."""

    curvature: float
    """Curvature of the likelihood along it, in units of the prior's; below 1."""
    components: dict[str, float]
    """Larger components of the unit vector, by coordinate."""


class Prior(Strict):
    """Prior of one parameter, for programs: cut at the bounds of the parameter."""

    parameter: str
    """Name in `parameters`."""
    quantity: str
    """What the distribution is of: the parameter itself, or ``half_width`` = beta (ln 2)^(1/(2 p)), ``sigma_rel`` =
    sigma_s times the root of the share of diffracted light above the horizon, ``odds`` = albedo / (1 - albedo),
    ``dispersion`` = eta - 1 over that of the middle channel."""
    distribution: Literal["log-normal", "uniform"]
    """Distribution of the quantity less `offset`."""
    offset: float
    """Subtracted from the quantity before the logarithm is taken."""
    median: float | None
    """Median of the log-normal distribution before it is cut; null of a uniform one."""
    factor: float | None
    """By which one standard deviation multiplies or divides the median; null of a uniform distribution."""
    lower: float
    """Lower bound of the parameter."""
    upper: float
    """Upper bound of the parameter."""


class Identifiability(Strict):
    """What the data determine, by the Gaussian approximation at the fit (Laplace)."""

    names: Many[str]
    """Parameters, in the order of `parameters`."""
    covariance: Many[Many[float]]
    """Covariance of the parameters, in units of theirs; from the normal equations of the fit with the prior. Of a
    parameter at a bound it is that of the approximation, which does not hold there."""
    correlation: Many[Many[float]]
    """The same as correlations."""
    coordinates: Many[str]
    """Free coordinates, in which the prior is standard normal: the quantity that each prior is of."""
    priors: Many[Prior]
    """Prior of each coordinate."""
    contraction: Many[float]
    """By coordinate: one minus the standard deviation that the data leave, of which the prior's is one."""
    determined: int
    """Number of directions in which the likelihood is at least as curved as the prior."""
    undetermined: Many[Direction]
    """The other directions: there the prior decides."""

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        size = len(self.names)
        same_length("names", size, correlation=self.correlation, covariance=self.covariance)
        for row in [*self.correlation, *self.covariance]:
            same_length("names", size, covariance_or_correlation=row)
        same_length("coordinates", len(self.coordinates), contraction=self.contraction, priors=self.priors)
        return self
