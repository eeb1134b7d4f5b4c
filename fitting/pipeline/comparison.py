"""Several models on one file: each fitted by the same pipeline, and published parameter sets beside them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...merl_io import inputs
from ...merl_io.bands import MERL
from ...merl_io.inputs import Input
from ...merl_io.scattered import ScatteredMeasurement
from ...model import published
from ...model.registry import made
from ...model.two_scale import TwoScale
from ..fit import error_metrics
from ..fit.problem import energy
from ..fit.published_errors import assess_published, sources_of
from ..fit.residuals import predict_samples
from ..fit.selection import bic
from ..fit.weights import weighted_samples
from ..results.schema import Result
from ..results.storage import finite, valid_result
from ..settings.config import Config, ConfigError, parse
from ..support.clock import Report, Stage, silent
from ..support.numbers import counted
from .models import candidates
from .run import fit_file

KEYS = ("material", "model", "variant", "origin", "weights", "status", "numbers")
FIT = "fit"
"""Origin of parameters that were not published."""


@dataclass(frozen=True)
class Row:
    """One model on one material.

    Attributes:
        material: name of the file. genuine: whether it is MERL's own, by SHA-1.
        model: name of the model. variant: which of its variants was chosen. origin: ``fit``, or a published table.
        weights: exponent of the compressive weight that it was fitted with, or ``log``; None for published parameters.
        status: how the fit ended. numbers: that were fitted, over all channels.
        errors: over all bins within theta_max. cost: of Eq. 56. bic: Bayesian information criterion, with one count of
            effective bins for all rows of a material. seconds: of the fit without reading the file, compilation
            included; None for published parameters.
        values: by name of the number.
    """

    material: str
    genuine: bool
    model: str
    variant: str
    origin: str
    weights: float | str | None
    status: str
    numbers: int
    errors: error_metrics.Errors
    cost: float
    bic: float
    seconds: float | None
    values: dict[str, float]

    def flat(self) -> dict[str, Any]:
        """As a line of a table."""
        own = {key: getattr(self, key) for key in KEYS}
        figures = {name: finite(x) for name, x in asdict(self.errors).items()}
        return {**own, **figures, "cost": self.cost, "bic": self.bic, "seconds": self.seconds, "values": self.values}


def config_of(config: Config, name: str) -> Config:
    """Settings of the fit of one model: those that have no effect on it are as by default.

    Raises:
        merlfit.fitting.settings.config.ConfigError: settings of a model of their own, or weights that every model would
            choose for itself.
    """
    for key in config.model.settings:
        raise ConfigError(f"model.{key} is a setting of one model: leave it out where several are compared")
    if config.fit.weights == "adaptive":
        raise ConfigError("fit.weights 'adaptive' gives every model another objective: compare with one of the others")
    data = {**config.plain(), "model": {"name": name}}
    if TwoScale.name not in name.split("+"):
        data["effects"] = {}
    if not made(name, {}).lobes:
        data["acquisition"], data["apparatus"] = {}, {}
    return parse(data, "settings")


def compare_file(
    path: Path | Input, names: Sequence[str], config: Config, out: Path, report: Report = silent,
    with_published: bool = True, fit: Callable[[Input, Path, Config], Result] = fit_file,
) -> tuple[list[Row], dict[str, Result]]:  # fmt: skip
    """Rows of one file, models first, in the order of their names; results are written to ``out/MODEL/NAME.json``.

    Args:
        with_published: whether published parameters of a material of the file's name stand beside the fits.
        fit: fits a measurement and writes its result to a folder.

    Raises:
        merlfit.merl_io.binary.MerlError: the file cannot be used. merlfit.fitting.settings.config.ConfigError: settings
            that several models cannot be compared with (`config_of`).
    """
    settings = [config_of(config, name) for name in names]
    for each in settings:
        candidates(each)  # before any is fitted: what is said of parameters that a model lacks is refused
    report("reading")
    measurement = (
        inputs.read(path, dims=config.input.allowed, quantity=config.input.quantity) if isinstance(path, Path) else path
    )
    if isinstance(measurement, ScatteredMeasurement):
        settings, with_published = [each.for_scattered for each in settings], False
    results: dict[str, Result] = {}
    for k, name in enumerate(names):
        report(Stage(f"{name} ({k + 1} of {counted(len(names), 'model')})", k / len(names)))
        own = settings[k]
        kept = valid_result(out / name / f"{measurement.name}.json", measurement.sha1, own)
        results[name] = fit(measurement, out / name, own) if kept is None else kept
    alike = on_same_weights(results, measurement, config)
    rows = [row_of(result) for result in alike.values() if result.model is not None]
    if with_published and (sources := sources_of(measurement.name)):
        report("published parameters")
        assert not isinstance(measurement, ScatteredMeasurement)
        samples = weighted_samples(measurement, config.exponents[-1], config.fit.theta_max)  # the fits' last
        for source in sources:
            errors, cost = assess_published(source, measurement, samples, config.fit.theta_max)
            rows.append(published_row(measurement.name, source, measurement.genuine is not None, errors, cost))
    return with_bic(rows, alike), results


def published_row(material: str, source: str, genuine: bool, errors: error_metrics.Errors, cost: float) -> Row:
    """Row of a published table, Ngan's on the scale of MERL's files."""
    model = published.SOURCES[source].model
    flat = {
        f"{name}_{channel}" if np.ndim(x) else name: float(y)
        for name, x in published.published(material, source, rescaled=True).items()
        for channel, y in zip(MERL.names if np.ndim(x) else [""], np.ravel(x), strict=True)
    }
    return Row(
        material, genuine, model.name, model.variant, source, None, "published", len(flat), errors, cost, float("nan"),
        None, flat,
    )  # fmt: skip


def on_same_weights(results: dict[str, Result], measurement: Input, config: Config) -> dict[str, Result]:
    """The same with costs that can be compared, where a file states uncertainties and each model found own weights.

    They are those of the model that errs least (`weights.found_error`).
    """
    errors = [r.fit.model_error for r in results.values() if r.fit.model_error is not None]
    if not errors:
        return results
    samples = weighted_samples(measurement, config.exponents[-1], config.fit.theta_max, min(errors))
    found = {}
    for name, result in results.items():
        if result.model is not None:
            predicted = predict_samples(result.model.measured, result.values(), samples)
            cost = float(np.sum(samples.weight * (samples.value - predicted) ** 2)) / energy(samples)
            result = result.model_copy(update={"fit": result.fit.model_copy(update={"cost": cost})})
        found[name] = result
    return found


def with_bic(rows: list[Row], results: dict[str, Result]) -> list[Row]:
    """With the effective count of the fit of the lowest cost, which the others are compared by, too."""
    known = [(r.fit.cost, r.fit.effective_bins) for r in results.values() if r.fit.cost and r.fit.effective_bins]
    count = min(known)[1] if known else 1.0
    return [row if row.origin != FIT else replace(row, bic=bic(row.cost, row.numbers, count)) for row in rows]


def row_of(result: Result) -> Row:
    """Row of a fit."""
    assert result.model is not None
    source, fit, material = result.source, result.fit, result.model.material
    known = result.metrics.model_dump().items()
    errors = error_metrics.Errors(**{name: float("nan") if x is None else x for name, x in known})
    free = sum(q.fitted == "free" for q in result.parameters)
    return Row(
        source.material, source.genuine_merl is not None, material.name, material.variant, FIT, fit.weights, fit.status,
        free, errors, float("nan") if fit.cost is None else fit.cost, float("nan"),
        result.seconds["total"], {q.name: q.value for q in result.parameters},
    )  # fmt: skip
