"""Fits of files, one after the other, as the commands `merlfit fit` and `merlfit demo` make them."""

from collections import Counter
from pathlib import Path
from typing import Unpack

import typer

from ..merl_io.atomic import WriteError
from ..merl_io.binary import Measurement, MerlError
from ..model.registry import made, models
from .cost.accuracy import Aim, aim
from .cost.request import request
from .output.comparison import by_label, judged_result, metrics_table, table_of, verdict, write_metrics, write_tables
from .output.keeping import Complete, Place, claimed, completeness, place_of, taken
from .output.report import Outcome, accuracy_line, summary_table
from .pipeline.comparison import FIT, compare_file
from .pipeline.run import fit_file
from .results.export import ResultError, read_result
from .results.schema import Result
from .settings.config import Config, ConfigError, Replaced, load
from .support.compilation import use_persistent_cache
from .support.terminal import (
    BAD_INPUT,
    FAILED_FIT,
    Stopped,
    console,
    fail,
    note,
    progress_display,
    reporter,
    writable_folder,
)

NOT_GENUINE = "files that are not (all) genuine MERL measurements, by their SHA-1"


def settings_of(config: Path | None = None, **replaced: Unpack[Replaced]) -> Config:
    """Those of a file of settings with what the command line replaces in it."""
    try:
        return load(config, **replaced)
    except ConfigError as error:
        raise fail(str(error)) from None


def aim_of(settings: Config, accuracy: float | None, within: str | None) -> Aim | None:
    """Choose settings for an accuracy or a time, and print them; None if neither was asked for."""
    if accuracy is None and within is None:
        return None
    try:
        chosen = aim(request(accuracy, within), settings)
    except ValueError as error:
        raise fail(str(error)) from None
    console.print(chosen.summary, soft_wrap=True)
    return chosen


def refuse_same_names(files: list[Path]) -> None:
    """End with an error where two results would have one name."""
    twice = [name for name, count in Counter(path.stem for path in files).items() if count > 1]
    if twice:
        raise fail(
            f"several files are named {twice[0]}, and a result is named after its file: fit them into different folders"
        )


def fit_files(files: list[Path], out: Path, settings: Config, aim: Aim | None = None) -> list[Outcome]:
    """Fit one file after the other; whatever one runs into, the others are fitted."""
    use_persistent_cache()
    writable_folder(out)
    refuse_same_names(files)
    chosen, finish = (aim.settings, aim.finish) if aim else (settings, None)
    outcomes = []
    with claimed(out) as alone, progress_display() as progress:
        if not alone:
            note(taken(out))
        batch = progress.add_task(f"{len(files)} files", total=len(files), visible=len(files) > 1)
        for k, path in enumerate(files, 1):
            progress.update(batch, completed=k - 1, description=f"{k - 1} of {len(files)} files")
            task = progress.add_task(path.name, total=None)
            label = f"[{k}/{len(files)}] {path.stem}"
            place = None
            try:
                with place_of(out, path.stem) as place:
                    result = fit_file(path, place.folder, chosen, reporter(progress, task, label), finish)
                outcomes.append(Outcome(path, result))
                console.print(f"{label}: {result.fit.status}, {result.seconds['total']:.1f} s")
                if result.accuracy is not None:
                    console.print(f"{label}: {accuracy_line(result.accuracy)}", soft_wrap=True)
            except MerlError as error:
                outcomes.append(Outcome(path, None, str(error), bad_input=True))
                fail(str(error))
            except WriteError as error:  # names the output, the input is not to blame
                outcomes.append(Outcome(path, None, str(error)))
                fail(str(error))
            except Stopped as stop:
                left = f"; {len(files) - k} of {len(files)} files were not begun" if k < len(files) else ""
                note(f"stopped by {stop}: {kept(path, place)}{left}")
                if place is not None and completeness(place.path) >= Complete.FIT:
                    outcomes.append(Outcome(path, read_result(place.path)))
                if outcomes:
                    console.print(summary_table(outcomes))
                raise typer.Exit(stop.code) from None
            except Exception as error:  # of any kind: said with its name, and the next file has its turn
                said = f"{path}: failed unexpectedly: {type(error).__name__}: {error}"
                outcomes.append(Outcome(path, None, said))
                fail(said)
            if place is not None and place.said:
                note(place.said)
            progress.remove_task(task)
    return outcomes


def kept(path: Path, place: Place | None) -> str:
    """What there is of a fit that was stopped."""
    if place is not None and place.said:
        return place.said
    found = Complete.NOTHING if place is None else completeness(place.path)
    if place is None or found == Complete.NOTHING:
        return f"{path.stem} was not fitted"
    more = "continues it" if found == Complete.CHAIN else "samples it"
    return f"{place.path} holds {found.words}; `merlfit sample {place.path}` {more}"


def summarise(outcomes: list[Outcome]) -> None:
    """Table of all fits; exits with 2 after bad input, with 1 after a fit that failed."""
    console.print(summary_table(outcomes))
    for o in outcomes:
        if o.result is not None and not o.result.fit.succeeded:
            console.print(f"{o.path.stem}: {o.result.fit.message}")
        for caution in o.result.fit.cautions if o.result is not None else ():
            console.print(f"{o.path.stem}: {caution}")
    if any(o.bad_input for o in outcomes):
        raise typer.Exit(BAD_INPUT)
    if any(o.result is None or not o.result.fit.succeeded for o in outcomes):
        raise typer.Exit(FAILED_FIT)


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


def placed(measurement: Measurement, folder: Path, settings: Config) -> Result:
    """Fit, and write the result where it replaces none that is more complete."""
    folder.mkdir(parents=True, exist_ok=True)
    with place_of(folder, measurement.name) as place:
        result = fit_file(measurement, place.folder, settings)
    if place.said:
        note(place.said)
    return result


def compare_files(
    files: list[Path], names: str | None, out: Path, settings: Config, with_published: bool = True
) -> None:
    """Fit all models to each file, print medians and write tables; whatever one file runs into, the others go on.

    Exits with 2 after bad input, with 1 if no model could be fitted to a file.
    """
    use_persistent_cache()
    writable_folder(out)
    refuse_same_names(files)
    wanted, rows, code = chosen_models(names), [], 0
    with claimed(out) as alone, progress_display() as progress:
        if not alone:
            note(taken(out))
        for k, path in enumerate(files, 1):
            task = progress.add_task(path.name, total=None)
            label = f"[{k}/{len(files)}] {path.stem}"
            say = reporter(progress, task, label)
            try:
                found, _ = compare_file(path, wanted, settings, out, say, with_published, placed)
                rows += found
                code = max(code, 0 if any(row.origin == FIT for row in found) else FAILED_FIT)
                console.print(f"{label}: {verdict(found)}", soft_wrap=True)
            except ConfigError as error:
                raise fail(str(error)) from None
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
                fail(f"{path}: failed unexpectedly: {type(error).__name__}: {error}")
            progress.remove_task(task)
    if rows:
        data = "genuine MERL measurements" if all(row.genuine for row in rows) else NOT_GENUINE
        title = f"{len({row.material for row in rows})} materials, {len(by_label(rows))} models"
        console.print(table_of(rows))
        written = write_tables(rows, out, "comparison", title, data)
        console.print(f"wrote {written[0]}, and .md, .html and .png beside it", soft_wrap=True)
    if code:
        raise typer.Exit(code)


def which_model(path: Path, names: str | None, out: Path, settings: Config) -> None:
    """Print which model is the least that explains a file; exits with 2 after bad input, with 1 if none was fitted."""
    use_persistent_cache()
    writable_folder(out)
    wanted = chosen_models(names)
    try:
        with progress_display() as progress:
            task = progress.add_task(path.name, total=None)
            rows, _ = compare_file(path, wanted, settings, out, reporter(progress, task, path.stem), False, placed)
    except (MerlError, WriteError, ConfigError) as error:
        raise fail(str(error)) from None
    except Stopped as stop:
        note(f"stopped by {stop}")
        raise typer.Exit(stop.code) from None
    if not rows:
        fail(f"{path}: no model could be fitted; see `merlfit check`")
        raise typer.Exit(FAILED_FIT)
    console.print(table_of(rows))
    console.print(verdict(rows), soft_wrap=True)


def metrics_of(results: list[Path], against: Path, out: Path | None) -> None:
    """Print the errors of results against a file; with a folder, write them and the curves over theta_i."""
    use_persistent_cache()
    try:
        found = [judged_result(path, read_result(path), against) for path in results]
    except (MerlError, ResultError, ValueError) as error:
        raise fail(str(error)) from None
    console.print(metrics_table(found, against))
    if out is not None:
        writable_folder(out)
        for path in write_metrics(found, out):
            console.print(f"wrote {path}", soft_wrap=True)
