"""The result of one material as JSON: its schema, written atomically, and the chain beside it."""

import codecs
import json
import math
import os
import platform
from collections.abc import Sized
from importlib import metadata
from pathlib import Path, PurePath
from typing import IO, Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from ..merl_io.atomic import write_atomically
from ..model.effects import Effects
from ..model.parameters import CHANNELS, parameters
from .choice import Choice

SCHEMA_VERSION = "1.3"
PACKAGES = ("merlfit", "jax", "jaxlib", "numpy", "scipy", "equinox", "lineax", "optimistix", "emcee", "arviz-stats")


PLAUSIBLE_UM = 0.1, 10.0  # wavelengths: a decade around what is visible
ROUNDING = 1e-9  # relative: by so much a value may lie beyond a bound


class ResultError(ValueError):
    """A result file that cannot be used; the message is one line that names the file."""


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

    path: Text
    material: FileName
    sha1: str
    git_blob_sha1: str
    genuine_merl: str | None
    fraction_valid: float
    outliers: int


class Model(_Part):
    """What was fitted."""

    name: Literal["two-scale"] = "two-scale"
    effects: Effects
    grazing_exponent: float
    channels: list[str]
    wavelengths_um: list[float]

    @model_validator(mode="after")
    def _of_a_fit(self) -> Self:
        low, high = PLAUSIBLE_UM
        if self.effects.diffraction == "exact":
            raise ValueError("diffraction 'exact' is a reference that takes hours; no fit uses it")
        if self.channels != list(CHANNELS):
            raise ValueError(f"channels should be {', '.join(CHANNELS)}, not {', '.join(self.channels) or 'none'}")
        _same_length("channels", len(self.channels), wavelengths_um=self.wavelengths_um)
        for x in self.wavelengths_um:
            if not low <= x <= high:
                raise ValueError(f"wavelengths_um {x:g} is not between {low:g} and {high:g}")
        return self


class Quantiles(_Part):
    """Posterior quantiles."""

    q05: float
    q50: float
    q95: float


class ParameterResult(_Part):
    """One fitted number.

    ``standard_error`` is the Laplace approximation's, null at a bound, where there is no normal distribution;
    quantiles are null without a posterior.
    """

    name: str
    parameter: str
    symbol: str
    channel: str | None
    meaning: str
    unit: str
    value: float
    standard_error: float | None
    quantiles: Quantiles | None
    lower: float
    upper: float
    at_bound: Literal["no", "lower", "upper"]
    prior: str
    source: str

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        slack = ROUNDING * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= self.value <= self.upper + slack:
            raise ValueError(f"{self.name} {self.value:g} is outside its bounds [{self.lower:g}, {self.upper:g}]")
        return self


class Direction(_Part):
    """A direction in free coordinates that the data do not determine.

    ``curvature`` of the likelihood along it, in units of the prior's; its larger ``components``, by coordinate.
    """

    curvature: float
    components: dict[str, float]


class Identifiability(_Part):
    """What the data determine, by the Gaussian approximation at the fit.

    ``correlation`` of the parameters ``names``. In the free ``coordinates`` the prior is standard normal:
    ``contraction`` is one minus the standard deviation that is left of it, ``determined`` the number of directions in
    which the likelihood is at least as curved as the prior, ``undetermined`` the others.
    """

    names: list[str]
    correlation: list[list[float]]
    coordinates: list[str]
    contraction: list[float]
    determined: int
    undetermined: list[Direction]

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        size = len(self.names)
        _same_length("names", size, correlation=self.correlation)
        for row in self.correlation:
            _same_length("names", size, correlation=row)
        _same_length("coordinates", len(self.coordinates), contraction=self.contraction)
        return self


class Candidate(_Part):
    """Interface and body on the coarse grid; ``converged`` is false of one too far behind to be followed.

    ``objective``: cost with the prior; ``cube_root``: error of cube roots on that grid; ``score``: what the choice goes
    by, from these two (``fitting/selection.py``). ``bic`` is of results before version 1.3.
    """

    index: str = "usual"
    body: str
    cost: float | None
    bic: float | None = None
    objective: float | None = None
    cube_root: float | None = None
    score: float | None = None
    converged: bool = True


class Fit(_Part):
    """How the fit ended. Costs are Eq. 56 relative to the measurement's weighted energy.

    ``weights``: exponent of the compressive weight that the fit was made with, or ``log``. ``cautions``: what a user of
    the parameters should know, in words.
    """

    status: Literal["CONVERGED", "AT_BOUND", "STEP_LIMIT", "UNEXPLAINED", "NON_FINITE", "NO_DATA"]
    message: str
    succeeded: bool
    cost: float | None
    cost_per_channel: list[float] | None
    folding_scatter: float | None
    steps: int
    relative_offset: float | None
    bins: int
    candidates: list[Candidate]
    weights: float | Literal["log"] | None = None
    cautions: list[str] = []


class Metrics(_Part):
    """Errors over all valid bins with both directions at theta < ``fit.theta_max``; prediction with the grazing loss.

    ``rmse`` (1/sr) and ``smape``; ``cube_root`` and ``log``: RMS differences of cube roots of BRDF times cos_i and of
    log(1 + BRDF cos_i); ``highlight``: fitted over measured peak; ``picture``: mean CIELAB distance of spheres.
    """

    rmse: float | None
    smape: float | None
    cube_root: float | None = None
    log: float | None = None
    highlight: float | None = None
    picture: float | None = None


class DerivedResult(_Part):
    """One derived quantity, of the material without the apparatus; quantiles are null without a posterior to trust."""

    name: str
    quantity: str
    channel: str | None
    meaning: str
    unit: str
    value: float
    quantiles: Quantiles | None


class PosteriorResult(_Part):
    """How the sampling went (docs/statistics.md). Not ``sufficient``, there are no quantiles, and ``message`` says why.

    ``effective_bins``: how many independent residuals those of the fit are worth. ``draws`` from the chain were weighed
    by the likelihood of all bins; ``pareto_k`` is the shape of the largest weights. Lists are by ``coordinates``:
    ``r_hat``, ``bulk_size``, ``tail_size`` of the chain, ``effective_size`` of the weighted draws, ``contraction`` one
    minus the posterior's standard deviation, of which the prior's is one.
    """

    sufficient: bool
    message: str
    steps: int
    walkers: int
    acceptance: float
    effective_bins: float
    draws: int
    pareto_k: float | None
    coordinates: list[str]
    autocorrelation_steps: list[float | None]
    r_hat: list[float | None]
    bulk_size: list[float | None]
    tail_size: list[float | None]
    effective_size: list[float | None]
    contraction: list[float | None]
    chain_file: FileName

    @model_validator(mode="after")
    def _lists_agree(self) -> Self:
        _same_length(
            "coordinates", len(self.coordinates), autocorrelation_steps=self.autocorrelation_steps, r_hat=self.r_hat,
            bulk_size=self.bulk_size, tail_size=self.tail_size, effective_size=self.effective_size,
            contraction=self.contraction,
        )  # fmt: skip
        return self


class Tried(_Part):
    """Settings that a fit was taken to, and the error that was estimated there."""

    settings: Choice
    estimated: float | None


class Accuracy(_Part):
    """What ``--accuracy`` or ``--time`` asked for, what was chosen, and what came of it.

    ``config`` is what the fit began with; it was taken on through the settings ``tried`` and is that of ``settings``.

    Errors are distances from the prediction of the reference fit, over all bins, relative to the measurement, with the
    weights of Eq. 56. ``expected`` and ``expected_seconds`` are those of the first settings, what 95 % of the
    calibration's fits keep to; null with effects or limits of steps that are not those calibrated. ``estimated`` is the
    error at ``settings``; ``met`` is null for a time.
    """

    asked: float | None
    asked_seconds: float | None
    calibration: str
    expected: float | None
    expected_seconds: float | None
    tried: list[Tried]
    settings: Choice
    estimated: float | None
    met: bool | None


class Result(_Part):
    """One material; version 1.0 had no ``accuracy``, 1.1 no ``identifiability`` and no ``derived``, 1.2 no pictures."""

    schema_version: Literal["1.0", "1.1", "1.2", "1.3"] = SCHEMA_VERSION
    source: Source
    model: Model | None
    parameters: list[ParameterResult]
    fit: Fit
    metrics: Metrics
    identifiability: Identifiability | None = None
    derived: list[DerivedResult] = []
    posterior: PosteriorResult | None
    accuracy: Accuracy | None = None
    seconds: dict[str, float]
    seed: int
    versions: dict[str, str]
    config: dict[str, Any]

    @model_validator(mode="after")
    def _parameters_are_the_models(self) -> Self:
        expected = _expected_parameters(self.model) if self.model else []
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
        return self

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
    """Name, parameter and channel of every number that these effects have."""
    return [
        (f"{q.name}_{channel}" if channel else q.name, q.name, channel)
        for q in parameters(model.effects)
        for channel in (model.channels if q.per_channel else [None])
    ]


def versions() -> dict[str, str]:
    """Versions of what computed the numbers."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}}


def finite(x: float) -> float | None:
    """The number, or None (null in JSON) where it is not finite."""
    return float(x) if math.isfinite(x) else None


def write_result(path: Path, result: Result) -> None:
    """Write JSON, atomically; numbers that are not finite are refused, since JSON has none.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    text = json.dumps(result.model_dump(mode="json"), indent=2, allow_nan=False, ensure_ascii=False) + "\n"

    def write(file: IO[bytes]) -> None:
        file.write(text.encode())

    write_atomically(path, write)


class _Versioned(BaseModel):
    schema_version: str


def read_result(path: str | os.PathLike[str]) -> Result:
    """Read and validate a result.

    Raises:
        ResultError: missing, not JSON, not a result, of a schema version that this program does not know, or with
            numbers, names or lists that no fit writes.
    """
    path = Path(path)
    try:
        text = path.read_bytes().removeprefix(codecs.BOM_UTF8)
        _check_version(path, _Versioned.model_validate_json(text).schema_version)
        return Result.model_validate_json(text)
    except OSError as error:
        raise ResultError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValidationError as error:
        raise ResultError(f"{path}: is not a merlfit result: {_in_words(error)}") from None


def _check_version(path: Path, version: str) -> None:
    known = get_args(Result.model_fields["schema_version"].annotation)
    if version in known:
        return
    numbers = [version.split("."), known[-1].split(".")]
    if all(part.isdecimal() for part in numbers[0]) and [int(x) for x in numbers[0]] > [int(x) for x in numbers[1]]:
        raise ResultError(
            f"{path}: was written by a newer merlfit (schema {version}, this one knows {known[-1]} at the most): "
            "update merlfit"
        )
    raise ResultError(f"{path}: is not a merlfit result: schema_version {version!r} is none of {', '.join(known)}")


SAID = {
    "missing": "is missing",
    "extra_forbidden": "is no field of a result",
    "finite_number": "is not a finite number",
}


def _in_words(error: ValidationError) -> str:
    """The first thing that is wrong, and where."""
    first = error.errors()[0]
    said = first["msg"].removeprefix("Value error, ")
    if first["type"] == "json_invalid":
        return said.replace("Invalid JSON", "it is not JSON")
    said = SAID.get(first["type"], said.replace("Input should be", "should be"))
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {said}" if where else said


def schema() -> dict[str, Any]:
    """JSON Schema of a result; the package ships it as ``fitting/result.schema.json``."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"merlfit/result-{SCHEMA_VERSION}",
        **Result.model_json_schema(mode="serialization"),
    }


if __name__ == "__main__":  # `make schema`
    target = Path(__file__).with_name("result.schema.json")
    target.write_text(json.dumps(schema(), indent=2) + "\n")
