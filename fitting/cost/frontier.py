"""What accuracy costs: the settings worth having, how near to the best fit they end and how fast.

The error of a fit is how far its prediction f is from that of the reference fit, over all bins, relative to the
measurement m and with the weights of Eq. 56:

    error = sqrt(sum w (f - f_ref)^2 / sum w m^2).

The reference is the last of `POINTS` with its last steps taken once more. Errors and seconds of all points are measured
on calibration materials (``merlfit cost``, :mod:`.measure`); the package ships one such calibration for machines that
have none.
Seconds are those of one file with nothing left to compile, from reading to the metrics, without a posterior.
"""

import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from ...merl_io.atomic import write_text
from ...merl_io.source import whole
from ..results.storage import versions
from ..settings.choice import POINTS, Choice
from ..support.compilation import cache_folder
from ..support.threads import machine

FILE = "frontier.json"
LARGEST = 2**26  # bytes of a calibration, and of the rows that it is made of: they have some 100 kB


class _Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="strings")


class Percentiles(_Frozen):
    """Over cases: median, what 95 % of them do not exceed, and the largest."""

    median: float
    p95: float
    worst: float

    @classmethod
    def of(cls, values: Sequence[float] | np.ndarray) -> "Percentiles":
        """Percentiles of a sample."""
        median, p95 = np.median(values), np.quantile(values, 0.95, method="inverted_cdf")
        return cls(median=float(median), p95=float(p95), worst=float(np.max(values)))


class Point(_Frozen):
    """One choice as measured on the calibration materials.

    Attributes:
        error: as above. promised: the larger of the error and its estimate (:mod:`merlfit.fitting.cost.accuracy`).
        other_minimum: 95th percentile of the errors that exceed their estimate, 0 of the others: fits that ended in
            another minimum than the reference, of which an estimate knows nothing.
        failed: share of fits that ended without usable parameters. other_body: share of materials for which it
            chose another body than the reference.
        rmse: against the file, 1/sr. parameters: the largest difference from the reference among parameters that are
            not at a bound, in the reference's standard errors; None where no material has the same body.
        seconds: of the fit. estimate_seconds: of the estimate of its error. megabytes: largest memory of a process that
            fits one file after the other and estimates their errors.
    """

    choice: Choice
    error: Percentiles
    promised: Percentiles
    other_minimum: float
    failed: float
    other_body: float
    rmse: Percentiles
    parameters: Percentiles | None
    seconds: Percentiles
    estimate_seconds: Percentiles
    megabytes: float


OBJECTIVE = 2
"""Raised when what a fit minimises, or how it looks for starting points, changes: 2 since directions past theta_max are
left out and each lobe has its own grazing loss."""


class Frontier(_Frozen):
    """A calibration: all that ``merlfit cost`` measured, and of what. Version 1.1 had tiers of the lobe, too.

    Attributes:
        objective: what the fits minimised, `OBJECTIVE` at the time.
        data: what the calibration materials are.
    """

    model_config = ConfigDict(extra="ignore")
    schema_version: Literal["1.1", "1.2"] = "1.2"
    objective: int = 1
    data: str
    materials: list[str]
    machine: str
    taken: str
    versions: dict[str, str]
    points: list[Point]


def shipped() -> Frontier:
    """The calibration that comes with the package."""
    return Frontier.model_validate_json((resources.files(__package__ or "") / FILE).read_bytes())


def load() -> tuple[Frontier, str]:
    """This machine's calibration, or the shipped one, and in words which it is.

    Times of another machine (of a shared home), of other versions or of other settings are not this machine's.
    """
    stale, path = "", cache_folder() / FILE
    try:
        found = Frontier.model_validate_json(whole(path, most=LARGEST))
        here = (found.machine, found.versions, found.objective) == (machine(), versions(), OBJECTIVE)
        if here and [q.choice for q in found.points] == list(POINTS):
            return found, f"calibrated on this machine, {found.taken}, {found.data}"
        stale = "the calibration that was kept is of another machine or of other versions; "
    except ValueError:  # of the file, or of what it says
        stale = "the calibration that was kept cannot be read; " if os.path.lexists(path) else ""
    found = shipped()
    if found.objective != OBJECTIVE:
        stale += "measured with what an earlier version minimised, so that errors and seconds are a rough guide; "
    said = f"calibrated on another machine ({found.machine}), {found.data}; {stale}`merlfit cost` calibrates this one"
    return found, said


def pareto(costs: Sequence[float], errors: Sequence[float]) -> list[int]:
    """Indices of those than which none is both as cheap and as accurate, cheapest first."""
    order = sorted(range(len(costs)), key=lambda i: (costs[i], errors[i]))
    front: list[int] = []
    for i in order:
        if not front or errors[i] < errors[front[-1]]:
            front.append(i)
    return front


def keep(frontier: Frontier, folder: Path) -> Path:
    """Write a calibration into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    write_text(path, frontier.model_dump_json(indent=1) + "\n")
    return path
