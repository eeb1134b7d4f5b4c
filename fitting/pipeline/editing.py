"""A fitted material with some of its numbers changed: a result that says so, and claims nothing of the fit for them."""

import difflib
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
from numpy.typing import ArrayLike

from ...model.parameters import Parameter
from ..results.schema import EditedFrom, Fit, Metrics, Model, ParameterResult, Result, this_run
from ..results.storage import ResultError, versions
from ..settings.config import ConfigError

OF_FIT = "of the fit: "  # before its cautions


def edited(path: Path, result: Result, changes: Mapping[str, ArrayLike]) -> Result:
    """The same material with other values: without errors, posterior, or intervals of what was changed.

    Bounds are those of the model, or of the fit where these are wider. Intervals of what was not changed stay, and are
    those of the fit.

    Args:
        path: of the result, which the new one names; of one that was edited before, its own fit stays named.
        changes: values by name of the ``parameters`` (``n_R``); or of those with one for each channel all (``n``), as
            one number or one for each.

    Returns:
        the result as it is where nothing differs.

    Raises:
        ResultError: the fit failed. ConfigError: there is no such parameter, all channels share it, it is given twice,
            or its value cannot be.
    """
    if result.model is None:
        raise ResultError(f"{path}: the fit failed ({result.fit.status}), it has no material to edit")
    if result.changed_by_hand:
        raise ResultError(f"{path}: was changed by hand, so that intervals are not those of its numbers: edit the fit")
    found: dict[str, float] = {}
    for name, value in changes.items():
        for q, x in zip(*_meant(result, name, value), strict=True):
            if q.name in found:
                raise ConfigError(f"{q.name}: is set twice, by itself and by {q.parameter}")
            found[q.name] = x
    declared = {q.name: q for q in result.model.measured.parameters}
    parameters = [
        q if found.get(q.name, q.value) == q.value else _set(q, found[q.name], declared[q.parameter])
        for q in result.parameters
    ]
    if parameters == result.parameters:
        return result
    return _of(path, result, parameters)


def as_set(result: Result, values: Mapping[str, float]) -> dict[str, float]:
    """Values by the names of numbers as `edited` takes them: by parameter where all channels are tied."""
    tied = {q.parameter for q in result.parameters if q.fitted == "tied"}
    own = {q.name: q.parameter for q in result.parameters}
    return {own[name] if own[name] in tied else name: value for name, value in values.items()}


def edited_file(path: Path) -> Path:
    """File of what is made of a result that is edited, beside it."""
    return path.with_name(f"{path.stem.removesuffix('.edited')}.edited{path.suffix}")


def _meant(result: Result, name: str, value: ArrayLike) -> tuple[list[ParameterResult], list[float]]:
    """The numbers that a name stands for, and what each becomes."""
    one = [q for q in result.parameters if q.name == name]
    every = [q for q in result.parameters if q.parameter == name]
    meant = one or every
    if not meant:
        raise ConfigError(_unknown(result, name))
    tied = any(q.fitted == "tied" for q in result.parameters if q.parameter == meant[0].parameter)
    if tied and len(meant) == 1:
        raise ConfigError(f"{name}: the fit has one {meant[0].parameter} for all channels: set {meant[0].parameter}")
    try:
        values = np.asarray(value, float)
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: should be a number, not {value!r}") from None
    if values.shape not in ((), (1,), (len(meant),)) or (tied and values.size > 1):
        many = f", or {len(meant)}, one for each channel" if len(meant) > 1 and not tied else ""
        raise ConfigError(f"{name}: should be one number{many}, not {values.size}")
    return meant, np.broadcast_to(values.ravel(), (len(meant),)).tolist()


def _unknown(result: Result, name: str) -> str:
    """What to say of a name that is no parameter's."""
    assert result.model is not None
    shared = {q.parameter for q in result.parameters if q.channel is None}
    of, _, channel = name.rpartition("_")
    if of in shared and channel in result.model.channels:
        return f"{name}: all channels share {of}: set {of}"
    own = list(dict.fromkeys(q.parameter for q in result.parameters))
    known = list(dict.fromkeys([*own, *(q.name for q in result.parameters)]))
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
    return f"there is no parameter {name!r}; the nearest is {near!r} (there are {', '.join(own)})"


def _set(q: ParameterResult, value: float, kind: Parameter) -> ParameterResult:
    lower, upper = min(q.lower, kind.lower), max(q.upper, kind.upper)
    if not lower <= value <= upper:
        raise ConfigError(f"{q.name}: {value:g} is outside its bounds, {lower:g} to {upper:g}")
    given = {"value": value, "lower": lower, "upper": upper, "at_bound": "no", "laplace": None, "quantiles": None}
    return q.model_copy(update=given)


def _of(path: Path, result: Result, parameters: list[ParameterResult]) -> Result:
    """The result with other numbers, and without all that was found of those that it had."""
    m = result.model
    assert m is not None
    before = result.edited_from or EditedFrom(result=str(path), numbers_sha1=result.numbers_sha1, fitted={})
    own = {q.name: before.fitted.get(q.name, q.value) for q in result.parameters}
    changed = {q.name: own[q.name] for q in parameters if q.value != own[q.name]}
    found = result.model_copy(update={
        "run": this_run().model_copy(update={"folder": result.run.folder}),  # from which the file is seen
        "parameters": parameters, "metrics": Metrics(rmse=None, smape=None), "identifiability": None, "derived": [],
        "tis": [], "posterior": None, "accuracy": None, "seconds": {"total": 0.0}, "versions": versions(),
        "edited_from": before.model_copy(update={"fitted": changed}),
    })  # fmt: skip
    fit = Fit(
        status="EDITED", succeeded=result.fit.succeeded, cost=None, cost_per_channel=None, folding_scatter=None,
        message=f"{found.edited_words}; nothing was fitted to these values: they have no errors and no posterior",
        steps=0, relative_offset=None, bins=0, candidates=[],
        cautions=[said if said.startswith(OF_FIT) else f"{OF_FIT}{said}" for said in result.fit.cautions],
    )  # fmt: skip
    values = {name: jax.device_put(np.asarray(x)) for name, x in found.values().items()}
    model = Model.of(m.measured, values, m.bands, m.colour_space)  # whose loss at grazing angles may follow
    found = found.model_copy(update={"fit": fit, "model": model})
    return Result.model_validate(found.model_copy(update={"numbers_sha1": found.digest}).model_dump())
