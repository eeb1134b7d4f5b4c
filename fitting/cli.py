"""The command line: parses, calls, prints."""

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:  # the commands import what they need: `merlfit --help` does not wait for JAX
    from .accuracy import Aim
    from .config import Config
    from .export import Result
    from .report import Outcome

app = typer.Typer(
    name="merlfit", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich",
    help="Fit the two-scale reflection + diffraction model to MERL BRDF files, with error bars.",
)  # fmt: skip
BAD_INPUT, FAILED_FIT = 2, 1
console = Console()
if not console.is_terminal:
    console = Console(width=140)  # tables in logs and pipes are not squeezed to 80 columns
errors = Console(stderr=True)

Files = Annotated[list[Path], typer.Argument(help="MERL .binary files.", show_default=False)]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Seed = Annotated[int | None, typer.Option(help="Seed of the sampler.", show_default=False)]


def main() -> None:
    """Entry point of the ``merlfit`` command."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # all cores have threads of ours, which its own would hinder
    app()


def _fail(message: str) -> typer.Exit:
    errors.print(f"merlfit: {message}", style="red", highlight=False, soft_wrap=True, markup=False)
    return typer.Exit(BAD_INPUT)


@app.command(epilog="Example: merlfit check nickel.binary gold-metallic-paint2.binary")
def check(files: Files) -> None:
    """Print what MERL files hold: dims, valid bins, bad numbers, largest values, whether they are the genuine ones."""
    from ..merl_io.binary import MerlError
    from ..merl_io.check import inspect_file
    from .report import check_table

    reports, bad = [], 0
    for path in files:
        try:
            reports.append(inspect_file(path))
        except MerlError as error:
            bad += 1
            _fail(str(error))
    if reports:
        console.print(check_table(reports))
    if bad:
        raise typer.Exit(BAD_INPUT)


@app.command(epilog="Example: merlfit fit nickel.binary gray-plastic.binary -o fits --no-posterior")
def fit(
    files: Files,
    out: Out = Path("fits"),
    config: Annotated[Path | None, typer.Option(help="TOML settings; see configs/default.toml.")] = None,
    preset: Annotated[
        str | None, typer.Option(help="hp17, conserving, microfacet, preview or fast: effects by name.")
    ] = None,
    body: Annotated[str | None, typer.Option(help="auto, none (conductor), lambert, plastic or subsurface.")] = None,
    posterior: Annotated[bool | None, typer.Option("--posterior/--no-posterior", help="Sample the posterior.")] = None,
    seed: Seed = None,
    accuracy: Annotated[
        float | None,
        typer.Option(help="Cheapest settings that end so near to the best fit: 1e-3, relative."),
    ] = None,
    within: Annotated[
        str | None, typer.Option("--time", help="Most accurate settings that take no longer a file: 2s, 500ms, 1.5min.")
    ] = None,
) -> None:
    """Fit each file and write OUT/NAME.json. Exit code 0 if all fits succeeded, 1 if one failed, 2 on bad input."""
    settings = _settings(config, preset, body, posterior, seed)
    outcomes = _fit_all(files, out, settings, _aim(settings, accuracy, within))
    _summarise(outcomes)


def _aim(settings: "Config", accuracy: float | None, within: str | None) -> "Aim | None":
    """What to take for an accuracy or a time, told; None if nothing was asked."""
    if accuracy is None and within is None:
        return None
    from .accuracy import aim
    from .request import request

    try:
        chosen = aim(request(accuracy, within), settings)
    except ValueError as error:
        raise _fail(str(error)) from None
    console.print(chosen.told, markup=False, soft_wrap=True)
    return chosen


def _settings(
    config: Path | None, preset: str | None, body: str | None, posterior: bool | None, seed: int | None
) -> "Config":
    from .config import ConfigError, load

    try:
        return load(config, preset=preset, body=body, posterior=posterior, seed=seed)
    except ConfigError as error:
        raise _fail(str(error)) from None


def _fit_all(files: list[Path], out: Path, settings: "Config", aim: "Aim | None" = None) -> "list[Outcome]":
    from ..merl_io.binary import MerlError
    from .compilation import use_persistent_cache
    from .report import Outcome, accuracy_line
    from .run import fit_file

    use_persistent_cache()
    _writable_folder(out)
    twice = [name for name, count in Counter(path.stem for path in files).items() if count > 1]
    if twice:
        raise _fail(f"several files are named {twice[0]}, and each result is named after its file: fit them apart")
    taken, finish = (aim.settings, aim.finish) if aim else (settings, None)
    outcomes = []
    with _progress() as progress:
        for k, path in enumerate(files, 1):
            task = progress.add_task(path.name)
            label = f"[{k}/{len(files)}] {path.stem}"
            try:
                result = fit_file(path, out, taken, _reporter(progress, task, label), finish)
                outcomes.append(Outcome(path, result))
                console.print(f"{label}: {result.fit.status}, {result.seconds['total']:.1f} s", markup=False)
                if result.accuracy is not None:
                    console.print(f"{label}: {accuracy_line(result.accuracy)}", markup=False, soft_wrap=True)
            except MerlError as error:
                outcomes.append(Outcome(path, None, str(error), bad_input=True))
                _fail(str(error))
            except Exception as error:  # whatever one file ran into, the others are fitted
                said = f"{path}: failed unexpectedly: {type(error).__name__}: {error}"
                outcomes.append(Outcome(path, None, said))
                _fail(said)
            progress.remove_task(task)
    return outcomes


def _progress() -> Progress:
    """What is being done and for how long, on a terminal."""
    return Progress(
        SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip


def _writable_folder(out: Path) -> None:
    """Make the folder now: an hour of fits is not to end with nowhere to go."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise _fail(f"{out}: results cannot be written there ({error.strerror or error})") from None


def _reporter(progress: Progress, task: TaskID, label: str) -> Callable[[str], None]:
    """Stages to the progress display on a terminal, to plain lines elsewhere (a new stage, not every step)."""
    last = [""]

    def report(stage: str) -> None:
        progress.update(task, description=f"{label}: {stage}")
        if not console.is_terminal and stage.split(":")[0] != last[0]:
            last[0] = stage.split(":")[0]
            console.print(f"{label}: {stage}", markup=False)

    return report


def _summarise(outcomes: "list[Outcome]") -> None:
    from .report import summary_table

    console.print(summary_table(outcomes))
    for o in outcomes:
        if o.result is not None and not o.result.fit.succeeded:
            console.print(f"{o.path.stem}: {o.result.fit.message}", markup=False)
    if any(o.bad_input for o in outcomes):
        raise typer.Exit(BAD_INPUT)
    if any(o.result is None or not o.result.fit.succeeded for o in outcomes):
        raise typer.Exit(FAILED_FIT)


@app.command(epilog="Example: merlfit synth nickel --source sgd -o nickel-sgd.binary")
def synth(
    material: Annotated[str, typer.Argument(help="MATERIAL of a published table, or RESULT.json of a fit.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The .binary file to write.", show_default=False)],
    source: Annotated[
        str | None, typer.Option(help="Published table, see `merlfit materials` [default: sgd].", show_default=False)
    ] = None,
) -> None:
    """Write a MERL file from a published parameter set or from a fit (without the acquisition's grazing loss)."""
    from ..merl_io.binary import MerlError, write
    from .compilation import use_persistent_cache
    from .export import ResultError
    from .synthesis import from_published, from_result

    use_persistent_cache()
    fitted = material.endswith(".json")
    if fitted and source is not None:
        raise _fail(f"--source names a published table; {material} is a fit: leave it out")
    try:
        values, said = from_result(Path(material)) if fitted else from_published(material, source or "sgd")
        write(out, values)
    except (MerlError, ResultError, KeyError, ValueError) as error:
        raise _fail(error.args[0] if isinstance(error, KeyError) else str(error)) from None
    console.print(f"{out}: {said}", markup=False, soft_wrap=True)


@app.command(epilog="Example: merlfit materials")
def materials() -> None:
    """List the published tables that `merlfit synth` knows, and their materials."""
    from .synthesis import describe_sources

    console.print(describe_sources(), markup=False, soft_wrap=True)


@app.command(epilog="Example: merlfit inspect fits/nickel.json")
def inspect(
    result: Annotated[Path, typer.Argument(help="RESULT.json of a fit.", show_default=False)],
    file: Annotated[Path | None, typer.Option(help="The MERL file, if it moved since the fit.")] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for the pictures [default: beside it].")
    ] = None,
) -> None:
    """Print a fit's parameters with intervals; write its lobe plot and the corner plot of its posterior."""
    from .export import ResultError, read_result

    try:
        read = read_result(result)
    except ResultError as error:
        raise _fail(str(error)) from None
    if not _show(result, read, file or Path(read.source.path), out or result.parent) and file is not None:
        raise typer.Exit(BAD_INPUT)


def _show(path: Path, result: "Result", file: Path, out: Path) -> bool:
    """Print and draw; whether the MERL file was of use."""
    from ..merl_io.binary import MerlError
    from ..merl_io.binary import read as read_merl
    from . import plots
    from .compilation import use_persistent_cache
    from .report import print_result

    use_persistent_cache()
    print_result(console, result)
    _writable_folder(out)
    pictures = {}
    try:
        pictures["corner"] = plots.corner_figure(result, path.parent)
    except plots.NoPicture as error:
        errors.print(f"merlfit: no corner plot: {error}", markup=False, soft_wrap=True)
    try:
        measurement = read_merl(file)
        if measurement.sha1 != result.source.sha1:
            raise MerlError(f"{file}: is not the file that was fitted (other SHA-1)")
        if result.model is not None:
            pictures["lobes"] = plots.lobe_figure(result, measurement)
    except MerlError as error:
        errors.print(f"merlfit: no lobe plot: {error}; name the file with --file", markup=False, soft_wrap=True)
    for name, figure in pictures.items():
        target = out / f"{result.source.material}.{name}.png"
        try:
            plots.save(figure, target)
        except OSError as error:
            raise _fail(f"{target}: cannot be written ({error.strerror or error})") from None
        console.print(f"wrote {target}", markup=False, soft_wrap=True)
    return "lobes" in pictures or result.model is None


@app.command(epilog="Example: merlfit cost -o cost")
def cost(
    file: Annotated[
        Path | None, typer.Argument(help="A MERL .binary file to measure on [default: synthetic materials].")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for JSON, table and plot.")] = Path("cost"),
    repeats: Annotated[int, typer.Option(min=1, help="Fits that a time is the median of.")] = 1,
) -> None:
    """Measure on this machine what accuracy costs, evaluated and fitted; `merlfit fit --accuracy, --time` go by it.

    Takes half an hour; if interrupted, the same command goes on from there. Of a FILE it is the calibration of one
    material: it is written, and no fit goes by it.
    """
    from ..merl_io.binary import MerlError
    from .compilation import cache_folder
    from .cost import CostError, measure, tidy
    from .cost_plot import frontier_figure
    from .cost_report import gains, tables, write_markdown
    from .frontier import keep
    from .plots import save

    _writable_folder(out)
    try:
        with _progress() as progress:
            frontier = measure(file, out, repeats, _reporter(progress, progress.add_task("cost"), "cost"))
        kept = [keep(frontier, folder) for folder in (out, *([] if file else [cache_folder()]))]
        write_markdown(frontier, out / "cost.md")
        save(frontier_figure(frontier), out / "cost.png")
        tidy(out)
    except MerlError as error:
        raise _fail(str(error)) from None
    except OSError as error:
        raise _fail(f"{error}; what was measured is kept, the same command goes on from there") from None
    except CostError as error:
        _fail(str(error))
        raise typer.Exit(FAILED_FIT) from None
    for table in tables(frontier):
        console.print(table)
    console.print(gains(frontier), markup=False, soft_wrap=True)
    used = "" if file else f"; fits go by {kept[1]}"
    console.print(f"wrote {kept[0]}, cost.md, cost.png and rows.json beside it{used}", markup=False, soft_wrap=True)


@app.command(epilog="Example: merlfit demo -o demo-out")
def demo(out: Out = Path("demo-out"), seed: Seed = None) -> None:
    """Synthesise one published material as a MERL file, fit it with its posterior, and show the outcome."""
    from ..merl_io.binary import write
    from .synthesis import DEMO, from_published

    start = time.perf_counter()
    _writable_folder(out)
    material, table = DEMO
    values, said = from_published(material, table)
    path = out / f"{material}.binary"
    write(path, values)
    console.print(f"{path}: {said}", markup=False, soft_wrap=True)
    outcomes = _fit_all([path], out, _settings(None, None, None, None, seed))
    if outcomes[0].result is not None:
        _show(out / f"{material}.json", outcomes[0].result, path, out)
    _summarise(outcomes)
    console.print(f"demo done in {time.perf_counter() - start:.0f} s; results in {out}/")
