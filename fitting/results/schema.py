"""The result of one material: what its JSON holds. Each part of it is in a file beside this one, field by field."""

import hashlib
import json
import math
from pathlib import PurePath
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from .schema_fit import Accuracy, Candidate, Fit, Metrics, Tried
from .schema_material import Acquisition, Model, Source
from .schema_parameters import (
    ROUNDING,
    DerivedResult,
    Direction,
    Identifiability,
    ParameterResult,
    Prior,
    Quantiles,
    TotalScatter,
)  # fmt: skip
from .schema_posterior import PosteriorResult
from .schema_run import EditedFrom, Run, this_run
from .strict import Many, Strict

__all__ = [
    "BY_HAND", "SCHEMA_VERSION", "UNSAID", "Accuracy", "Acquisition", "Candidate", "DerivedResult", "Direction",
    "EditedFrom", "Fit", "Identifiability", "Metrics", "Model", "ParameterResult", "PosteriorResult", "Prior",
    "Quantiles", "Result", "Run", "Source", "TotalScatter", "Tried", "genuine_words", "this_run",
]  # fmt: skip
SCHEMA_VERSION = "2.5"
BY_HAND = "its numbers were changed by hand since the fit: errors and intervals are not of these values"
UNSAID = "not a genuine MERL measurement, by its SHA-1"
UNSAID_SCATTERED = "a file of scattered directions, whose origin is not stated"


class Result(Strict):
    """What merlfit found out about one material."""

    schema_version: Literal["2.5"] = SCHEMA_VERSION
    """Version of this format."""
    run: Run = Field(default_factory=this_run)
    """When and how it was computed."""
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
    derived: Many[DerivedResult] = []  # noqa: RUF012 - pydantic copies it
    """Quantities that follow from the parameters; empty without a posterior."""
    tis: Many[TotalScatter] = []  # noqa: RUF012 - pydantic copies it
    """Total integrated scatter, by incidence and channel; empty in results of before it was stated."""
    posterior: PosteriorResult | None
    """How the posterior was sampled; null if it was not."""
    accuracy: Accuracy | None = None
    """What was asked for by ``--accuracy`` or ``--time``; null if nothing was."""
    seconds: dict[str, float]
    """Seconds by stage, and in total."""
    seed: int
    """Seed of the sampler's random numbers."""
    versions: dict[str, str]
    """Versions of Python and of the packages that computed it."""
    config: dict[str, Any]
    """All settings (``configs/default.toml``)."""
    numbers_sha1: str | None = None
    """SHA-1 of the parameters' values, of what they are the parameters of, and of what they were fitted to, by which a
    change by hand is told; null without a fit."""
    edited_from: EditedFrom | None = None
    """The fit that the values were edited from, by ``--set``, `Fit.edited` or the live view; null of a fit's own."""

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

    @model_validator(mode="after")
    def _edited_are_parameters(self) -> Self:
        """Nobody takes an edited material for a fit, or the other way round."""
        if (self.edited_from is not None) != (self.fit.status == "EDITED"):
            raise ValueError("edited_from and the fit's status EDITED should stand together")
        if unknown := (self.edited_from.fitted if self.edited_from else {}).keys() - {q.name for q in self.parameters}:
            raise ValueError(f"edited_from.fitted: {min(unknown)} is no parameter")
        return self

    @model_validator(mode="after")
    def _settings_can_be_used(self) -> Self:
        """What others take from tables of any content."""
        if "total" not in self.seconds:
            raise ValueError("seconds.total: is missing")
        limit = self.theta_max
        if limit is not None and (not isinstance(limit, int | float) or not 0.5 <= limit <= 1.571):
            raise ValueError("config.fit.theta_max: should be an angle between 0.5 and 1.571 rad")
        return self

    @property
    def theta_max(self) -> float | None:
        """Directions past it (rad) were neither fitted nor assessed; None where the settings name none."""
        section = self.config.get("fit")
        return section.get("theta_max") if isinstance(section, dict) else None

    @property
    def digest(self) -> str:
        """What `numbers_sha1` is of a result that nobody has changed."""
        include = {"name", "settings", "acquisition", "wavelengths_um"}
        fitted = self.model and self.model.model_dump(mode="json", include=include)
        numbers = [[q.name, q.value] for q in self.parameters]
        return hashlib.sha1(json.dumps([self.source.sha1, self.metrics.rmse, numbers, fitted]).encode()).hexdigest()

    @property
    def changed_by_hand(self) -> bool:
        """Whether numbers were changed in the file, as far as that is known: then its errors are not theirs."""
        return self.numbers_sha1 not in (None, self.digest)

    @property
    def edited_words(self) -> str:
        """What was edited, from which fit, in words; empty of a fit."""
        if (origin := self.edited_from) is None:
            return ""
        own = {q.name: q.value for q in self.parameters}
        changes = [f"{name} {was:.4g} -> {own[name]:.4g}" for name, was in origin.fitted.items()]
        said = ", ".join(changes) or "all values are those of the fit again"
        return f"edited from the fit {PurePath(origin.result).name}: {said}"

    @property
    def error_words(self) -> str:
        """How near the material is to the file, in words."""
        if self.edited_from is not None:
            return f"{self.edited_words}; without an error, as nothing was fitted to these values"
        rmse = self.metrics.rmse
        return BY_HAND if self.changed_by_hand else "without an error" if rmse is None else f"RMSE {rmse:.3g}/sr"

    @property
    def data_words(self) -> str:
        """What the file is, as far as that is known: by its SHA-1, or because the fit was told (``input.origin``)."""
        if self.source.genuine_merl:
            return genuine_words(self.source.genuine_merl)
        section = self.config.get("input")
        origin = section.get("origin") if isinstance(section, dict) else None
        if origin:
            return f"{origin} (stated, not checked)"
        return UNSAID if self.source.format == "MERL" else UNSAID_SCATTERED

    @property
    def uncertainty_words(self) -> str:
        """Where the uncertainties of the file's values are from, and what the model is taken to err by beside them."""
        stated, error = self.source.fraction_uncertain, self.fit.model_error
        if stated is None or error is None:
            return "none given; how far residuals count is found from their own size and likeness (docs/statistics.md)"
        some = "" if stated == 1 else f" for {stated:.1%} of the values, the channel's median for the others"
        return f"given by the file{some}; beside them the model is taken to err by {error:.3g} 1/sr at the weight 1"

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


def genuine_words(name: str) -> str:
    """What a file is that has the SHA-1 of one of MERL's."""
    return f"genuine MERL measurement {name}"


def _expected_parameters(model: Model) -> list[tuple[str, str, str | None]]:
    """Name, parameter and channel of every number that this model has."""
    return [
        (f"{q.name}_{channel}" if channel else q.name, q.name, channel)
        for q in model.measured.parameters
        for channel in (model.channels if q.per_channel else [None])
    ]
