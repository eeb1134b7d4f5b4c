"""Models compared on files, as `merlfit compare` and `merlfit which` do it."""

import json
import traceback
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from ...merl_io import inputs
from ...merl_io.atomic import WriteError, refused, write_text
from ...merl_io.binary import DIMS, Measurement, MerlError, write
from ...merl_io.grid import merl_grid
from ...merl_io.inputs import Input
from ...model.registry import made, models
from ...scene.colour import coloured
from ..fit.published_errors import assess_prediction
from ..fit.tabulated import tabulated
from ..fit.weights import weighted_samples
from ..pipeline.comparison import FIT, Row, compare_file
from ..pipeline.draws import NoPicture
from ..pipeline.place import claimed, place_of
from ..pipeline.resampling import resample
from ..pipeline.run import fit_file
from ..pipeline.stacking import scatter_of_several
from ..results.schema import Result
from ..results.storage import valid_result
from ..settings.config import Config, ConfigError, parse
from ..show.comparison_table import (
    NAME,
    beside_table,
    by_label,
    compared_in,
    several_table,
    several_words,
    table_of,
    verdict,
    write_tables,
)  # fmt: skip
from ..support.clock import Report
from ..support.compilation import programs_told, use_persistent_cache
from ..support.numbers import counted
from ..support.outputs import log, log_of, refuse_others, refuse_present
from ..support.terminal import (
    BAD_INPUT,
    FAILED_FIT,
    Stopped,
    console,
    fail,
    note,
    progress_display,
    reporter,
    reporting,
    why_ended,
    writable_folder,
)  # fmt: skip
from .fit import numbered, refuse_same_names

MOST_SAMPLED = 3  # models whose posteriors are stacked
NOT_GENUINE = "files that are not (all) genuine MERL measurements, by their SHA-1"


def chosen_models(names: str | None) -> list[str]:
    """Models by name, with commas between; all for none."""
    if names is None:
        return list(models())
    found = [name.strip() for name in names.split(",") if name.strip()]
    try:
        for name in found:
            made(name, {})
    except ValueError as error:
        raise fail(str(error)) from None
    if not found or len(set(found)) < len(found):
        raise fail(f"--models {names!r} should be different names, with commas between")
    return found


def placed(measurement: Input, folder: Path, settings: Config) -> Result:
    """Fit, and write the result where it replaces none that is more complete."""
    with place_of(folder, measurement.name) as place:
        result = fit_file(measurement, place.folder, settings)
    if place.said:
        note(place.said)
    return result


@contextmanager
def claimed_for(models: Iterable[str], out: Path) -> Iterator[None]:
    """Claim a folder and that of each model in it, which `merlfit fit` of this model may want.

    Raises:
        WriteError: one cannot be made, or another run has it.
    """
    with ExitStack() as stack:
        stack.enter_context(claimed(out))
        for folder in (out / model for model in models):
            with refused(folder, "made"):
                folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(claimed(folder))
        yield


def compare_files(
    files: list[Path], names: str | None, out: Path, settings: Config, with_published: bool = True, force: bool = False
) -> None:
    """Fit all models to each file, print medians and write tables; whatever one file runs into, the others go on.

    Exits with 2 after bad input, with 1 if no model could be fitted to a file.
    """
    use_persistent_cache()
    writable_folder(out)
    refuse_same_names(files)
    refuse_others(compared_in(out), force)
    wanted, rows, code = chosen_models(names), [], 0
    with claimed_for(wanted, out), progress_display() as progress:
        for k, path in enumerate(files):
            task = progress.add_task(path.name, total=None)
            say = reporter(progress, task, numbered(k, len(files), path.stem))
            try:
                with programs_told(say) as told:
                    found, _ = compare_file(path, wanted, settings, out, told, with_published, placed)
                rows += found
                code = max(code, 0 if any(row.origin == FIT for row in found) else FAILED_FIT)
                console.print(numbered(k, len(files), verdict(found)))
            except ConfigError:  # of all files
                raise
            except MerlError as error:
                code = BAD_INPUT
                fail(str(error))
            except WriteError as error:
                code = max(code, FAILED_FIT)
                fail(str(error))
            except Stopped as stop:
                note(f"stopped by {stop}; the same command goes on from there")
                raise typer.Exit(stop.code) from None
            except Exception as error:  # of any kind: said with its name, and the next file has its turn
                code = max(code, FAILED_FIT)
                log(log_of(out, path.stem), traceback.format_exc())
                fail(f"{why_ended(path, error)}; {log_of(out, path.stem)} says where")
            progress.remove_task(task)
    if rows:
        data = "genuine MERL measurements" if all(row.genuine for row in rows) else NOT_GENUINE
        materials = len({row.material for row in rows})
        title = f"{counted(materials, 'material')}, {counted(len(by_label(rows)), 'model')}"
        console.print(table_of(rows))
        written = write_tables(rows, out, NAME, title, data)
        console.print(f"wrote {written[0]}, and .md, .html and .png beside it")
    if code:
        raise typer.Exit(code)


def sampled(
    rows: list[Row], results: dict[str, Result], measurement: Input, out: Path, say: Report
) -> dict[str, tuple[Result, Path]]:
    """Results of the models of lowest BIC, `MOST_SAMPLED` at the most, with posteriors; where each is.

    Those that have one already are left alone, and chains go on where they were stopped. What fails is said.
    """
    bics = {row.model: row.bic for row in rows}
    fitted = {name: bics[r.model.material.name] for name, r in results.items() if r.model and r.fit.succeeded}
    found: dict[str, tuple[Result, Path]] = {}
    for model in sorted(fitted, key=fitted.__getitem__)[:MOST_SAMPLED]:
        path = out / model / f"{measurement.name}.json"
        result = valid_result(path, measurement.sha1, parse(results[model].config, str(path)))
        if result is None:  # it may be more complete than the new one
            note(f"{model} was not sampled: {path} is of another fit; name another folder (-o)")
            continue
        try:
            if result.posterior is None or not result.posterior.sufficient:
                result = resample(path, result, measurement, None, lambda stage, of=model: say(f"{of}: {stage}"))
        except (MerlError, RuntimeError) as error:
            note(f"{model} was not sampled: {error}")
            continue
        if result.posterior is not None and result.posterior.sufficient:
            found[model] = result, path
        else:
            note(f"{model} has no intervals: {result.posterior.message if result.posterior else 'not sampled'}")
    return found


def print_together(
    rows: list[Row], results: dict[str, Result], measurement: Input, out: Path, say: Report, kept: bool
) -> None:
    """Sample the best models, and print total integrated scatter by each and by all together.

    Args:
        kept: whether ``out`` stays, and what is printed is written there, too.
    """
    try:
        best = sampled(rows, results, measurement, out, say)
        several = scatter_of_several(best, measurement, say) if len(best) > 1 else None
    except NoPicture as error:
        raise fail(str(error)) from None
    if several is None:
        raise fail(f"{measurement.name}: fewer than two models have posteriors to stack")
    console.print(several_table(several, measurement.bands.names))
    console.print(several_words(several))
    if kept:
        target = _stacked(out, measurement.name)
        write_text(target, json.dumps(several.plain(measurement.bands.names), indent=1) + "\n")
        console.print(f"wrote {target}")


def _stacked(out: Path, name: str) -> Path:
    return out / f"{name}.stacked.json"


def which_model(
    path: Path, names: str | None, out: Path, settings: Config, table_to: Path | None = None, force: bool = False,
    sampling: bool = False, kept: bool = True,
) -> None:  # fmt: skip
    """Print which model is the least that explains a file; exits with 2 after bad input, with 1 if none was fitted.

    Args:
        table_to: the MERL file to write of tables that follow the file as nearly as may be; None for none.
        sampling: whether the best are sampled, and their total integrated scatter is printed. kept: whether ``out``
            stays.
    """
    use_persistent_cache()
    writable_folder(out)
    if table_to is not None:
        refuse_present(table_to, force)
    if sampling and kept:
        refuse_others([_stacked(out, path.stem)], force)
    wanted = chosen_models(names)
    with claimed_for(wanted, out), reporting(path.name, path.stem) as say, programs_told(say) as told:
        measurement = inputs.read(path, dims=settings.input.allowed, quantity=settings.input.quantity)
        samples = weighted_samples(measurement, settings.exponents[0], settings.fit.theta_max)
        table = tabulated(samples)
        if table_to is not None:
            if table is None:
                raise fail(f"{path}: has too few directions, or no light in a channel, for tables; leave --table out")
            grid = merl_grid(measurement.dims if isinstance(measurement, Measurement) else DIMS)
            write(table_to, coloured(table.on(grid), samples.bands), grid.above, grid.above.shape)
        rows, results = compare_file(measurement, wanted, settings, out, told, False, placed)
    if not rows:
        fail(f"{path}: no model could be fitted; see `merlfit check`")
        raise typer.Exit(FAILED_FIT)
    console.print(table_of(rows))
    said = ""
    if table is not None and getattr(samples, "uncertainty", None) is None:  # then all fits have these weights, too
        errors, _ = assess_prediction(table.predicted, measurement, samples, settings.fit.theta_max)
        said = beside_table(rows, table, errors)
    console.print(verdict(rows) + said)
    if table_to is not None:
        console.print(f"{table_to}: the tables, as a MERL file")
    if not sampling:
        return
    try:
        with claimed_for(wanted, out), reporting(path.name, path.stem) as say, programs_told(say) as told:
            print_together(rows, results, measurement, out, told, kept)
    except Stopped as stop:
        note(f"stopped by {stop}; {'the same command goes on from there' if kept else 'with -o it could be gone on'}")
        raise typer.Exit(stop.code) from None
