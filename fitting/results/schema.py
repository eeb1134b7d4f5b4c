"""The result of one material: what its JSON holds, field by field."""

import math
import os
import sys
from collections.abc import Sized
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    model_validator,
)

from ...merl_io import inputs
from ...merl_io.bands import Bands, ColourSpace
from ...model.apparatus import APPARATUS, Apparatus, GrazingLoss
from ...model.measured import Measured
from ...model.reflectance import Reflectance, Values
from ...model.registry import made
from ..settings.choice import Choice

SCHEMA_VERSION = "2.2"
OLDER = ("1.0", "1.1", "1.2", "1.3", "1.4", "2.0", "2.1")  # versions that are read, too: `upgraded` makes them this one


UNSAID = "not a genuine MERL measurement, by its SHA-1"
PLAUSIBLE_UM = 0.1, 10.0  # wavelengths: a decade around what is visible
ROUNDING = 1e-9  # relative: by so much a value may lie beyond a bound


class _First(FailFast):
    """The first wrong item is told: a million of them would take a kilobyte each."""

    def __hash__(self) -> int:
        """Unions need one."""
        return hash(self.fail_fast)


Item = TypeVar("Item")
Many = Annotated[list[Item], _First()]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


def _readable(text: object) -> object:
    """File names are bytes: of one that is no UTF-8, the bytes that are none become question marks."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace") if isinstance(text, str) else text


def _file_name(name: str) -> str:
    """Only what stays in its folder when a path is made of it."""
    if name in ("", ".", "..") or PurePath(name).name != name or "\0" in name:
        raise ValueError(f"{name!r} is not the name of a file without its folder")
    return name


Text = Annotated[str, BeforeValidator(_readable)]
FileName = Annotated[Text, AfterValidator(_file_name)]


def _same_length(first: str, size: int, **lists: Sized) -> None:
    for name, each in lists.items():
        if len(each) != size:
            raise ValueError(f"{name} has {len(each)} entries, {first} {size}")


class Source(_Part):
    """Where the data came from."""

    format: Literal["MERL", "table", "RGL"]
    """Of the file: bins as MERL has them, a table of scattered directions (docs/tables.md), or RGL's ``.bsdf``
    (docs/rgl.md)."""
    path: Text
    """File that was fitted, as it was named; relative to where the fit ran, unless it is absolute."""
    material: FileName
    """Name of the file without its folder and its ending."""
    sha1: str
    """SHA-1 of the file."""
    git_blob_sha1: str
    """SHA-1 of the file as git computes it for a blob."""
    genuine_merl: str | None
    """Name of the MERL material whose published file this is, bit by bit; null for any other file."""
    dims: tuple[int, int, int] | None
    """Numbers of bins of theta_h, theta_d and phi_d in the file; null of scattered directions."""
    fraction_valid: float
    """Share of the bins that hold a datum in every channel; of scattered directions that of values that are data."""
    outliers: int | None
    """Number of valid bins that are very much brighter than their neighbours; null of scattered directions."""

    def read(self, file: Path) -> inputs.Input:
        """The data again, from a file that has to be the one that was fitted.

        Raises:
            merlfit.merl_io.binary.MerlError: it cannot be used, or is another one.
        """
        return inputs.read(file, self.sha1, self.dims)


class Acquisition(_Part):
    """What the apparatus does to the material."""

    grazing_loss: Annotated[float, Field(ge=0, le=1)] | GrazingLoss
    """Loss of light at grazing angles: ``off``, ``free`` (exponents are parameters), ``derived`` from the widths of the
    lobes, or the exponent itself."""
    apparatus: Apparatus | None = None
    """Sphere, pixel and lamp that a derived loss assumes; null otherwise."""
    exponents: dict[str, float | None]
    """Exponent of the loss by sharp lobe, ``specular`` or ``diffracted`` (HP17 Eq. 60); 0 where no light is lost. Null
    of diffracted light in results of schema 1.2 and older, which had one exponent for all light."""


class Model(_Part):
    """What was fitted: a material, and what the apparatus made of it."""

    name: str
    """Name of the material's model (``merlfit models``)."""
    settings: dict[str, Any]
    """Settings of the model by name; of the two-scale model, which physical effects it simulates."""
    acquisition: Acquisition
    """What the apparatus does to the material."""
    channels: Many[str]
    """Names of the colour channels; lists by channel have this order."""
    colour_space: ColourSpace = "linear RGB of MERL, as stored"
    """Colour space of channels and albedos. The files have no white point of their own; nothing is converted."""
    wavelengths_um: Many[float]
    """Wavelength that stands for each channel (micrometres)."""

    @model_validator(mode="after")
    def _of_a_fit(self) -> Self:
        low, high = PLAUSIBLE_UM
        if self.material.objection is not None:
            raise ValueError(self.material.objection)
        if self.acquisition.exponents.keys() != {*self.material.lobes}:
            raise ValueError(f"acquisition.exponents should be those of {', '.join(self.material.lobes) or 'no lobe'}")
        if not self.channels or len(set(self.channels)) < len(self.channels):
            raise ValueError(f"channels should be different names, not {', '.join(self.channels) or 'none'}")
        _same_length("channels", len(self.channels), wavelengths_um=self.wavelengths_um)
        for x in self.wavelengths_um:
            if not low <= x <= high:
                raise ValueError(f"wavelengths_um {x:g} is not between {low:g} and {high:g}")
        return self

    @classmethod
    def of(
        cls, model: Measured, values: Values, bands: Bands, colour_space: ColourSpace = "linear RGB of MERL, as stored"
    ) -> Self:
        """What a fit with these parameter values was of."""
        material, derived = model.material, model.grazing_loss == "derived"
        return cls(
            name=material.name,
            settings=asdict(material),  # pyright: ignore[reportArgumentType] - models are dataclasses
            acquisition=Acquisition(
                grazing_loss=model.grazing_loss, apparatus=model.apparatus if derived else None,
                exponents={lobe: float(model.exponent(lobe, values, bands.wavelengths_um)) for lobe in model.lobes},
            ),
            channels=list(bands.names), colour_space=colour_space, wavelengths_um=list(bands.wavelengths_um),
        )  # fmt: skip

    @cached_property
    def measured(self) -> Measured:
        """The model that was fitted: the material as the apparatus sees it."""
        a = self.acquisition
        return Measured(made(self.name, self.settings), a.grazing_loss, a.apparatus or APPARATUS)

    @property
    def material(self) -> Reflectance:
        """The material, without the apparatus."""
        return self.measured.material

    @property
    def bands(self) -> Bands:
        """Channels and their wavelengths."""
        return Bands(tuple(self.channels), tuple(self.wavelengths_um))


class Quantiles(_Part):
    """Posterior quantiles."""

    q05: float
    """5 % of the posterior lie below it."""
    q50: float
    """Median of the posterior."""
    q95: float
    """95 % of the posterior lie below it."""


class ParameterResult(_Part):
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
    standard_error: float | None
    """By the Laplace approximation; null at a bound, where there is no normal distribution."""
    quantiles: Quantiles | None
    """Of the posterior; null without a posterior that is good enough."""
    lower: float
    """Lower bound of the fit."""
    upper: float
    """Upper bound of the fit."""
    at_bound: Literal["no", "lower", "upper"]
    """At which bound the value is."""
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


class Direction(_Part):
    """A direction in free coordinates that the data do not determine."""

    curvature: float
    """Curvature of the likelihood along it, in units of the prior's; below 1."""
    components: dict[str, float]
    """Larger components of the unit vector, by coordinate."""


class Prior(_Part):
    """Prior of one parameter, for programs: cut at the bounds of the parameter."""

    parameter: str
    """Name in `parameters`."""
    quantity: str
    """What the distribution is of: the parameter itself, or ``half_width`` = beta (ln 2)^(1/(2 p)), ``sigma_rel`` =
    sigma_s times the root of the share of diffracted light above the horizon, ``odds`` = albedo / (1 - albedo),
    ``dispersion`` = eta - 1 over that of the middle channel."""
    distribution: Literal["log-normal", "uniform"]
    """Of the quantity less `offset`."""
    offset: float
    """Subtracted from the quantity before the logarithm is taken."""
    median: float | None
    """Of the log-normal distribution before it is cut; null of a uniform one."""
    factor: float | None
    """By which one standard deviation multiplies or divides the median; null of a uniform distribution."""
    lower: float
    """Lower bound of the parameter."""
    upper: float
    """Upper bound of the parameter."""


class Identifiability(_Part):
    """What the data determine, by the Gaussian approximation at the fit (Laplace)."""

    names: Many[str]
    """Parameters, in the order of `parameters`."""
    covariance: Many[Many[float]] | None = None
    """Covariance of the parameters, in units of theirs; from the normal equations of the fit with the prior. Of a
    parameter at a bound it is that of the approximation, which does not hold there. Null before version 1.4."""
    correlation: Many[Many[float]]
    """The same as correlations."""
    coordinates: Many[str]
    """Free coordinates, in which the prior is standard normal: the quantity that each prior is of."""
    priors: Many[Prior] | None = None
    """Prior of each coordinate. Null before version 1.4."""
    contraction: Many[float]
    """By coordinate: one minus the standard deviation that the data leave, of which the prior's is one."""
    determined: int
    """Number of directions in which the likelihood is at least as curved as the prior."""
    undetermined: Many[Direction]
    """The other directions: there the prior decides."""

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        size = len(self.names)
        _same_length("names", size, correlation=self.correlation, covariance=self.covariance or self.names)
        for row in [*self.correlation, *(self.covariance or [])]:
            _same_length("names", size, covariance_or_correlation=row)
        _same_length("coordinates", len(self.coordinates), contraction=self.contraction)
        _same_length("coordinates", len(self.coordinates), priors=self.priors or self.coordinates)
        return self


class Candidate(_Part):
    """One model, or variant of a model, that was compared on the coarse grid."""

    model: str
    """Name of the model."""
    variant: str
    """Variant in short words: interface and body of a two-scale model, ``complex none`` (a metal) or ``real lambert``;
    the model's name where it has no variants."""
    cost: float | None
    """Cost on the coarse grid, as in `fit.cost`."""
    bic: float | None = None
    """What results before version 1.3 chose by."""
    objective: float | None = None
    """Cost with the prior."""
    cube_root: float | None = None
    """Error of cube roots on the coarse grid."""
    score: float | None = None
    """What the choice goes by, the lowest is best (``fitting/assess/selection.py``)."""
    converged: bool = True
    """False of a kind that was too far behind to be followed to the end, or was still creeping on the coarse grid."""


class Fit(_Part):
    """How the fit ended."""

    status: Literal["CONVERGED", "AT_BOUND", "STEP_LIMIT", "UNEXPLAINED", "NON_FINITE", "NO_DATA"]
    """How it ended, as a word for programs."""
    message: str
    """The same in a sentence, with what is wrong with the file."""
    succeeded: bool
    """Whether its parameters may be used: it converged, at a bound or not, or stopped at the step limit."""
    cost: float | None
    """HP17 Eq. 56, relative to the measurement's weighted energy."""
    cost_per_channel: Many[float] | None
    """The cost by channel."""
    folding_scatter: float | None
    """Part of the cost by which bins at phi_d and pi - phi_d differ, which should be equal; no model can lower it."""
    steps: int
    """Steps on the last grid."""
    relative_offset: float | None
    """How far from the minimum the fit stopped, as Bates and Watts measure it."""
    bins: int
    """Bins with a weight."""
    effective_bins: float | None = None
    """How many independent residuals those of the fit count as (docs/statistics.md). Null before version 2.1."""
    candidates: Many[Candidate]
    """Models and their variants that were compared."""
    weights: float | Literal["log"] | None = None
    """Exponent of the compressive weight that the fit was made with, or ``log``."""
    cautions: Many[str] = []
    """What a user of the parameters should know, in words."""


class Metrics(_Part):
    """Errors over all valid bins with light and viewer at theta < ``fit.theta_max``, of a prediction with the loss."""

    rmse: float | None
    """Root of the mean squared error (1/sr)."""
    smape: float | None
    """Symmetric mean absolute percentage error, as a share."""
    cube_root: float | None = None
    """RMS difference of the cube roots of BRDF times cos_i."""
    log: float | None = None
    """RMS difference of log(1 + BRDF cos_i)."""
    highlight: float | None = None
    """Fitted over measured peak."""
    picture: float | None = None
    """Mean CIELAB distance of rendered spheres."""


class DerivedResult(_Part):
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
    """Of the posterior; null without a posterior that is good enough."""


class PosteriorResult(_Part):
    """How the sampling went (docs/statistics.md)."""

    sufficient: bool
    """Whether the chain is good enough for intervals; if not, there are no quantiles."""
    message: str
    """Why it is good enough, or why not."""
    steps: int
    """Steps of every walker after tuning."""
    walkers: int
    """Number of walkers."""
    acceptance: float
    """Share of proposals that were accepted."""
    effective_bins: float
    """How many independent residuals those of the fit count as."""
    draws: int
    """Draws from the chain that were weighted by the likelihood of all bins."""
    pareto_k: float | None
    """Shape of the largest weights; above 0.7 they cannot be trusted."""
    coordinates: Many[str]
    """Free coordinates; the following lists are by coordinate."""
    autocorrelation_steps: Many[float | None]
    """Autocorrelation time of the chain, in steps."""
    r_hat: Many[float | None]
    """Split R-hat of the chain."""
    bulk_size: Many[float | None]
    """Effective sample size of the chain in the bulk."""
    tail_size: Many[float | None]
    """Effective sample size of the chain in the tails."""
    effective_size: Many[float | None]
    """Effective sample size of the weighted draws."""
    contraction: Many[float | None]
    """One minus the posterior's standard deviation, of which the prior's is one."""
    chain_file: FileName
    """File beside this one with the chain and the draws (docs/result.md)."""

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        _same_length(
            "coordinates", len(self.coordinates), autocorrelation_steps=self.autocorrelation_steps, r_hat=self.r_hat,
            bulk_size=self.bulk_size, tail_size=self.tail_size, effective_size=self.effective_size,
            contraction=self.contraction,
        )  # fmt: skip
        return self


class Tried(_Part):
    """Settings that a fit was taken to, and what was estimated there."""

    settings: Choice
    """The settings."""
    estimated: float | None
    """Error there, as in `accuracy.estimated`."""
    floor: bool = False
    """As in `accuracy.floor`."""


class Accuracy(_Part):
    """What ``--accuracy`` or ``--time`` asked for, what was chosen, and what came of it.

    Errors are distances from the prediction of the reference fit, over all bins, relative to the measurement, with the
    weights of Eq. 56. `config` is what the fit began with; it was carried on through the settings ``tried``.
    """

    asked: float | None
    """Error that was asked for; null if a time was."""
    asked_seconds: float | None
    """Seconds that were asked for; null if an error was."""
    calibration: str
    """Which calibration the settings were chosen by, in words."""
    expected: float | None
    """What 95 % of the calibration's fits with the first settings keep to; null for effects or limits of steps that
    were not calibrated."""
    expected_seconds: float | None
    """The same of the seconds."""
    tried: Many[Tried]
    """Settings that the fit was taken to, one after the other."""
    settings: Choice
    """Those of the result."""
    estimated: float | None
    """Error of the result; null where there was no time to estimate it."""
    floor: bool = False
    """True where ``estimated`` is what 95 % of the calibration's fits with these settings keep to, because the estimate
    of this fit alone was lower."""
    met: bool | None
    """Whether the error that was asked for is kept to; null for a time."""


class Run(_Part):
    """When and how a result was computed."""

    finished: str
    """When it was computed: date and time in UTC (ISO 8601)."""
    command: Many[Text]
    """Command line; empty where Python called merlfit as a library."""
    folder: Text | None = None
    """Folder that it ran in, from which a relative `source.path` is seen; null before version 2.0."""


def this_run() -> Run:
    """Now, and the command line of this process if it is merlfit's."""
    program = PurePath(sys.argv[0] if sys.argv else "")
    ours = program.stem == "merlfit" or (program.name == "__main__.py" and program.parent.name in ("merlfit", "main"))
    command = ["merlfit", *(str(_readable(word)) for word in sys.argv[1:])] if ours else []
    return Run(finished=datetime.now(UTC).isoformat(timespec="seconds"), command=command, folder=_here())


def _here() -> str | None:
    """Working folder; None if it is gone."""
    try:
        return os.getcwd()
    except OSError:
        return None


class Result(_Part):
    """What merlfit found out about one material."""

    schema_version: Literal["2.2"] = SCHEMA_VERSION
    """Version of this format. Older ones are read as this one: 1.0 had no `accuracy`; 1.1 no `identifiability` and no
    `derived`; 1.2 no errors of pictures; 1.3 no `run`, `identifiability.covariance` and `identifiability.priors`; 1.4
    and before no other model than the two-scale one, its acquisition among its effects; 2.0 no `fit.effective_bins`;
    2.1 no `source.dims` and `source.format`."""
    run: Run | None = Field(default_factory=this_run)
    """When and how it was computed; null before version 1.4."""
    source: Source
    """The file that was fitted, and what it holds."""
    model: Model | None
    """What was fitted; null if nothing could be fitted."""
    parameters: Many[ParameterResult]
    """Fitted numbers."""
    fit: Fit
    """How the fit ended, and what it chose."""
    metrics: Metrics
    """Errors of the fit."""
    identifiability: Identifiability | None = None
    """What the data determine."""
    derived: Many[DerivedResult] = []
    """Quantities that follow from the parameters; empty without a posterior."""
    posterior: PosteriorResult | None
    """How the posterior was sampled; null if it was not."""
    accuracy: Accuracy | None = None
    """What was asked for by ``--accuracy`` or ``--time``; null if nothing was."""
    seconds: dict[str, float]
    """Seconds by stage, and in total."""
    seed: int
    """Of the sampler's random numbers."""
    versions: dict[str, str]
    """Versions of Python and of the packages that computed it."""
    config: dict[str, Any]
    """All settings (``configs/default.toml``)."""

    @model_validator(mode="after")
    def _parameters_are_the_models(self) -> Self:
        expected = _expected_parameters(self.model) if self.model else []
        declared = {q.name: q for q in self.model.measured.parameters} if self.model else {}
        found = [(q.name, q.parameter, q.channel) for q in self.parameters]
        if found != expected:
            here, there = ([name for name, *_ in each] for each in (found, expected))
            wrong = [f"{n} is missing" for n in there if n not in here] + [
                f"{n} is none" for n in here if n not in there
            ]
            raise ValueError(
                f"the parameters are not those of the model: {', '.join(wrong) or 'their order or channels'}; "
                "an older merlfit wrote it, or it was edited: fit the file again"
            )
        for q in self.parameters:  # whatever the bounds of the fit were
            kind = declared[q.parameter]
            slack = ROUNDING * abs(kind.upper)
            least, most = (kind.offset, math.inf) if kind.scale == "log" else (kind.lower - slack, kind.upper + slack)
            if not least <= q.value <= most or (kind.scale == "log" and q.value == least):
                raise ValueError(f"{q.name} {q.value:g} is impossible, whatever its bounds")
        return self

    @property
    def data_words(self) -> str:
        """What the file is, as far as that is known: by its SHA-1, or because the fit was told (``input.origin``)."""
        if self.source.genuine_merl:
            return f"genuine MERL measurement {self.source.genuine_merl}"
        section = self.config.get("input")
        origin = section.get("origin") if isinstance(section, dict) else None
        return f"{origin} (stated, not checked)" if origin else UNSAID

    def values(self, flat: np.ndarray | None = None) -> dict[str, Any]:
        """Values by parameter name, arrays for those per channel: what the model takes.

        Args:
            flat: other values of the ``parameters``, a draw from the posterior say.
        """
        grouped: dict[str, list[float]] = {}
        for k, q in enumerate(self.parameters):
            grouped.setdefault(q.parameter, []).append(q.value if flat is None else float(flat[k]))
        single = {q.parameter for q in self.parameters if q.channel is None}
        return {name: v[0] if name in single else np.array(v) for name, v in grouped.items()}


def _expected_parameters(model: Model) -> list[tuple[str, str, str | None]]:
    """Name, parameter and channel of every number that this model has."""
    return [
        (f"{q.name}_{channel}" if channel else q.name, q.name, channel)
        for q in model.measured.parameters
        for channel in (model.channels if q.per_channel else [None])
    ]
