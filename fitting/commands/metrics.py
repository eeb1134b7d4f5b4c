"""`merlfit metrics`: errors of results against a file, as a table, as CSV, and over the light's angle."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import typer
from matplotlib.figure import Figure
from rich.table import Table

from ...merl_io import inputs
from ...merl_io.atomic import write_text
from ...merl_io.binary import Measurement
from ...merl_io.grid import merl_grid
from ...merl_io.inputs import is_scattered
from ...merl_io.scattered import ScatteredMeasurement, ScatteredSamples
from ...model.reflectance import evaluate
from ..fit import scattered_errors
from ..fit.error_metrics import INCIDENCE, Errors, by_incidence, errors
from ..fit.residuals import predict_samples
from ..fit.weights import weighted_samples
from ..pipeline.comparison import Row, row_of
from ..pipeline.synthesis import tabulate
from ..results.schema import UNSAID, UNSAID_SCATTERED, Model, Result, genuine_words
from ..results.storage import ResultError, read_result
from ..show.comparison_table import FIGURES, LIT, WHAT, named, shown
from ..show.style import own_style, plain, save
from ..support.choices import THETA_MAX
from ..support.compilation import use_persistent_cache
from ..support.outputs import refuse_others
from ..support.tables import as_csv, table
from ..support.terminal import BAD_INPUT, console, fail, why_ended, writable_folder


def metrics_of(results: list[Path], against: Path, out: Path | None, force: bool = False) -> None:
    """Print the errors of results against a file; with a folder, write them and the curves over theta_i.

    Exits with 2 if one of them has none; the others are assessed.
    """
    use_persistent_cache()
    refuse_others([] if out is None else metrics_in(out), force)
    found, missing = [], {}
    for path in results:
        try:
            found.append(assessed_result(path, read_result(path), against))
        except Exception as error:  # of any kind: the next result has its turn
            missing[why_ended(path, error)] = None  # once, if it is about the file
    for line in missing:
        fail(line)
    if found:
        console.print(metrics_table(found, against))
    if found and out is not None:
        writable_folder(out)
        for path in write_metrics(found, out):
            console.print(f"wrote {path}")
    if missing:
        raise typer.Exit(BAD_INPUT)


class Assessed(NamedTuple):
    """Errors of one result against a file.

    Attributes:
        path: of the result. row: its errors there. against: the file; data: what that is, in words.
        incidence: middles of intervals of theta_i (rad), of scattered directions the means of its samples; rmse: over
            them.
    """

    path: Path
    row: Row
    against: Path
    data: str
    incidence: np.ndarray
    rmse: np.ndarray


def assessed_result(path: Path, result: Result, against: Path) -> Assessed:
    """A result's prediction, as the apparatus would have measured it, beside a file.

    Raises:
        merlfit.merl_io.binary.MerlError: the file cannot be used. ResultError: the fit failed.
    """
    if (model := result.model) is None:
        raise ResultError(f"{path}: the fit failed ({result.fit.status}), it has no material")
    measurement = inputs.read(against, dims=result.source.dims)
    count = 3 if isinstance(measurement, Measurement) else len(measurement.bands)
    if len(model.channels) != count:
        raise ResultError(f"{path}: has {len(model.channels)} channels, and {measurement.path} {count}")
    same = measurement.sha1 == result.source.sha1
    unsaid = UNSAID if isinstance(measurement, Measurement) else UNSAID_SCATTERED
    data = result.data_words if same else genuine_words(measurement.genuine) if measurement.genuine else unsaid
    if not isinstance(measurement, Measurement):
        found, *curve = _scattered(result, model, measurement)
        return Assessed(path, replace(row_of(result), errors=found), against, data, *curve)
    values = tabulate(lambda g: evaluate(model.measured, result.values(), g, model.wavelengths_um), measurement.dims)
    grid, valid = merl_grid(measurement.dims), measurement.valid
    found = errors(measurement.values, values, valid, grid)
    curve = by_incidence(measurement.values, values, valid, grid)
    return Assessed(path, replace(row_of(result), errors=found), against, data, *curve)


def _scattered(
    result: Result, model: Model, measurement: ScatteredMeasurement
) -> tuple[Errors, np.ndarray, np.ndarray]:
    """On the samples themselves: errors, and the curve over the light's angle."""
    samples = weighted_samples(measurement)
    assert isinstance(samples, ScatteredSamples)
    values = {name: jnp.asarray(x) for name, x in result.values().items()}
    predicted = np.asarray(predict_samples(model.measured, values, samples))
    return scattered_errors.errors(samples, predicted), *samples_by_incidence(samples, predicted)


def samples_by_incidence(samples: ScatteredSamples, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RMSE (1/sr) of the samples of intervals of theta_i, weighted as over all (`scattered_errors.errors`).

    Returns:
        the mean theta_i (rad) of each interval that has samples, and the RMSE there.
    """
    theta_i, used = np.arccos(np.clip(samples.cos_i, 0, 1)), samples.weight > 0
    squares, weight = (samples.value - predicted) ** 2, np.where(used, samples.share * samples.cos_i, 0.0)
    place = np.round(theta_i / INCIDENCE).astype(int)
    sums = [np.bincount(place, np.sum(x, 0)) for x in (weight, weight * theta_i, weight * squares)]
    total, angle, error = (x[sums[0] > 0] for x in sums)
    return angle / total, np.sqrt(error / total)


def metrics_table(found: Sequence[Assessed], against: Path) -> Table:
    """What `merlfit metrics` prints."""
    where = f"its {'samples' if is_scattered(against) else 'bins of (theta_h, theta_d, phi_d)'}"
    title = f"errors against {against} over {where}, both directions at theta < {THETA_MAX:g} rad"
    left, figures = ("result", "model"), FIGURES | LIT
    rows = (
        (str(each.path), named(each.row), *(shown(name, getattr(each.row.errors, name)) for name in figures))
        for each in found
    )
    return table(title, (*left, *(head.replace(" ", "\n") for head in figures.values())), left, rows, caption=WHAT)


def metrics_in(folder: Path) -> list[Path]:
    """Files of `write_metrics`."""
    return [folder / name for name in ("metrics.csv", "by_incidence.csv", "by_incidence.png")]


def write_metrics(found: Sequence[Assessed], folder: Path) -> list[Path]:
    """``metrics.csv``, ``by_incidence.csv`` and ``by_incidence.png``."""
    lines = [{"result": str(f.path), "against": str(f.against), "data": f.data, "model": f.row.model,
              "variant": f.row.variant,
              **{name: getattr(f.row.errors, name) for name in (*FIGURES, *LIT)}} for f in found]  # fmt: skip
    curves = [{"theta_i_deg": round(float(np.degrees(x)), 3), **{str(f.path): f.rmse[k] for f in found}}
              for k, x in enumerate(found[0].incidence)]  # fmt: skip
    written = metrics_in(folder)
    for path, rows in zip(written, (lines, curves), strict=False):
        write_text(path, as_csv(list(rows[0]), rows))
        if not curves:
            return written[:1]
    save(_by_incidence(found), written[2])
    return written


@own_style()
def _by_incidence(found: Sequence[Assessed]) -> Figure:
    """The RMSE over the light's angle."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    for each in found:
        words = plain(f"{each.row.material}: {named(each.row)}")
        axis.plot(np.degrees(each.incidence), each.rmse, "o-", markersize=3, label=words)
    axis.set(yscale="log", xlabel=r"$\theta_i$ (deg)", ylabel="RMSE (1/sr)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    data = next((f.data for f in found if f.data != UNSAID), UNSAID)  # told by the fit of this very file
    figure.suptitle(plain(f"errors against {found[0].against.name} by the light's angle\ndata: {data}"), fontsize=10)
    return figure
