"""Degenerate files, the ``[[fit]]`` entries of cases.toml: what fitting each of them says.

``python -m tests.hard_cases`` prints them as its second table; tests/fitting/test_hard_fits.py asserts them.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import Status
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import run
from merlfit.fitting.pipeline.result import make_result
from merlfit.fitting.results.schema import Result
from merlfit.fitting.settings.config import parse
from merlfit.merl_io.binary import Measurement, MerlError, read, write
from merlfit.merl_io.grid import merl_grid
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import TwoScale, two_scale

from .table import table

TRUTH = {"beta": 0.15, "p": 0.7, "eta": np.array([1.4, 1.5, 1.6]), "albedo": np.array([0.5, 0.2, 0.05])}
CONFIG = parse(
    {
        "effects": {"preset": "microfacet", "body": "lambert"},
        "fit": {"starts": 1, "coarse_steps": 30, "max_steps": 20},
        "posterior": {"enabled": False},
    },
    "tests",
)


@cache
def material() -> np.ndarray:
    """A known material in every bin, (3, 90, 90, 180); NaN below the horizon."""
    grid = merl_grid()
    g = Geometry.from_half_difference(*np.ix_(grid.theta_h, grid.theta_d, grid.phi_d))
    values = jax.jit(lambda g: two_scale(TRUTH, g, TwoScale("lambert", "off")))(g)
    return np.where(grid.above, np.asarray(values), np.nan)


def measurement(values: np.ndarray) -> Measurement:
    """Written as a MERL file and read again."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hard.binary"
        write(path, values)
        return read(path)


def degenerate(file: dict) -> np.ndarray:
    """What an entry of the table puts into the bins."""
    known = material()
    values = known if file["fill"] == "material" else np.where(np.isfinite(known), float(file["fill"]), np.nan)
    values = values * file.get("factor", 1.0)
    values[:, 2, 10, 90] *= file.get("outlier", 1.0)
    if valid := file.get("valid", 0):
        bins = np.flatnonzero(np.isfinite(values[0]).ravel())[:: values[0].size // 200][:valid]
        kept = np.isin(np.arange(values[0].size), bins).reshape(values[0].shape)
        values = np.where(kept, values, np.nan)
    return values


def fit(file: dict) -> Result:
    """The fit of an entry's file.

    Raises:
        MerlError: the file is refused.
    """
    m = measurement(degenerate(file))
    samples, scale = weighted_samples(m), file.get("weight", 1.0)
    samples = replace(samples, weight=samples.weight * scale, scatter=samples.scatter * scale)
    fitted = run.fit(m, samples, CONFIG)
    return make_result(m, samples, fitted, None, CONFIG, {"total": 0.0})


def complaints(file: dict, result: Result) -> list[str]:
    """What is wrong: parameters that are not finite or out of bounds, far from the truth, a status not allowed."""
    status = Status[result.fit.status]
    wrong = {
        f"status {status.name}": status.name not in file.get("status", []),
        "another sentence than the status's": not result.fit.message.startswith(status.value),
        "succeeded, or not, against its status": result.fit.succeeded != status.succeeded,
        "parameters against its status": bool(result.parameters) == (status in (Status.NO_DATA, Status.NON_FINITE)),
        "cost": result.fit.cost is not None and not np.isfinite(result.fit.cost),
    }
    for q in result.parameters:
        wrong[q.name] = not (np.isfinite(q.value) and q.lower <= q.value <= q.upper)
        wrong[f"interval of {q.name}"] = q.laplace is not None and not q.laplace.q05 < q.value < q.laplace.q95
    if "near" in file and result.parameters:
        found = result.values()
        wrong |= {f"{q} far off": not np.allclose(found[q], x, rtol=file["near"], atol=0) for q, x in TRUTH.items()}
    return [what for what, is_so in wrong.items() if is_so]


@dataclass(frozen=True)
class Row:
    """How one file ended: its status or ``refused``, in its own sentence, and what is wrong with that."""

    name: str
    status: str
    message: str
    failures: list[str]


@cache
def row(name: str) -> Row:
    """The file of this name, fitted."""
    file = next(file for file in table()[2] if file["name"] == name)
    try:
        result = fit(file)
    except MerlError as error:
        said = str(error).split("hard.binary")[-1].lstrip(": ")
        known = "refused" in file and file["refused"] in said
        return Row(name, "refused", said, [] if known else ["refused"])
    failures = complaints(file, result) + (["not refused"] if "refused" in file else [])
    return Row(name, result.fit.status, result.fit.message, failures)


def rows() -> list[Row]:
    """All files."""
    return [row(file["name"]) for file in table()[2]]


def markdown(lines: list[Row]) -> str:
    """The table as Markdown; a status that is not allowed, or else wrong, is bold."""
    text = ["| file | status | what it says |", "|---|---|---|"]
    for line in lines:
        status = f"**{line.status}: {', '.join(line.failures)}**" if line.failures else line.status
        text.append(f"| {line.name} | {status} | {line.message} |")
    return "\n".join(text)
