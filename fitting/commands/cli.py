"""The command line: parses, calls, prints."""

import logging
import os
import time
from contextlib import nullcontext
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from ..support.affinity import cores_of
from ..support.allocation import few_arenas
from ..support.terminal import Commands, console, fail, run, writable_folder
from .options import (
    Dims,
    Files,
    Force,
    Jobs,
    Measured,
    Models,
    Out,
    Pages,
    Quantity,
    Result,
    SameWeights,
    Seed,
    Set,
    Settings,
    Weights,
)

# the commands import what they need: `merlfit --help` does not wait for JAX
app = typer.Typer(
    name="merlfit", cls=Commands, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode="rich",
    help="Fit reflectance models to measured BRDFs, with error bars: MERL files, tables, other programs' files.",
)  # fmt: skip


def main() -> None:
    """Entry point of the ``merlfit`` command."""
    _fill_streams()
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where it keeps its fonts concerns nobody
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # all cores have threads of ours, which its own would hinder
    few_arenas(len(cores_of()))
    run(app)


def _fill_streams() -> None:
    """Put nothing in the place of standard streams that are closed: pipes to workers would get their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number, for workers as well


def _version(asked: bool) -> None:
    if asked:
        console.print(f"merlfit {metadata.version('merlfit')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    if (asked := os.environ.get("JAX_PLATFORMS")) and "cpu" not in asked.split(","):
        _refuse_missing(asked)


def _refuse_missing(platforms: str) -> None:
    """End with a line if JAX was told to compute on a device that is not here; it raises errors without words."""
    import jax

    try:
        jax.devices()
    except (RuntimeError, AssertionError):
        raise fail(f"JAX_PLATFORMS={platforms}: JAX finds no such device here; unset it, or set it to cpu") from None


@app.command(epilog="Example: merlfit check nickel.binary gold-metallic-paint2.binary")
def check(files: Files, dims: Dims = None, quantity: Quantity = None) -> None:
    """Print what files hold: bins or samples, bad numbers, largest values, and whether they are genuine MERL files."""
    from ..settings.config import load
    from .checked import check_files

    settings = load(dims=dims, quantity=quantity).input
    check_files(files, settings.allowed, settings.quantity)


@app.command(epilog="Example: merlfit fit nickel.binary gray-plastic.binary -o fits --no-posterior")
def fit(
    files: Files,
    out: Out = Path("fits"),
    config: Settings = None,
    dims: Dims = None,
    quantity: Quantity = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model to fit, one of `merlfit models`, a sum such as ggx+epd or coat(ggx)+epd, or auto: the "
            "two-scale model, and sums over it where these describe a file much better; given several times, they are "
            "compared \\[default: two-scale]."
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(help="Two-scale model: what is simulated, hp17, conserving, free, microfacet, preview or fast."),
    ] = None,
    index: Annotated[
        str | None,
        typer.Option(help="Two-scale model: index of refraction, auto, complex (metal), real (plastic, coat) or film."),
    ] = None,
    body: Annotated[
        str | None,
        typer.Option(help="Two-scale model: what lies under the surface, auto, none, lambert, plastic or subsurface."),
    ] = None,
    weights: Weights = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter that is not fitted, with its value or one for each channel: eta=1.5, n=0.2,0.9,1.1."
        ),
    ] = None,
    bounds: Annotated[
        list[str] | None, typer.Option(help="Bounds of a parameter, within the model's: p=0.5:2, b=1: .")
    ] = None,
    start: Annotated[list[str] | None, typer.Option(help="Where the first fit starts: beta=0.1.")] = None,
    tie: Annotated[list[str] | None, typer.Option(help="Parameter with one value for all channels: eta.")] = None,
    posterior: Annotated[bool | None, typer.Option("--posterior/--no-posterior", help="Sample the posterior.")] = None,
    seed: Seed = None,
    origin: Annotated[
        str | None, typer.Option(help="What the files are, in words that results and pages repeat: synthetic, say.")
    ] = None,
    accuracy: Annotated[
        float | None, typer.Option(help="Choose the fastest settings that are this accurate, such as 1e-2 (relative).")
    ] = None,
    within: Annotated[
        str | None,
        typer.Option("--time", help="Choose the most accurate settings within this time for each file: 20s, 1.5min."),
    ] = None,
    jobs: Jobs = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave alone what is done, of the same file, settings and versions.")
    ] = False,
    executor: Annotated[
        str | None, typer.Option(help="Fit on a cluster, dask://HOST:PORT or dask-slurm; see docs/clusters.md.")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(help="gpu: fit all files together on a GPU (docs/howto/fit.md); cpu \\[default: cpu]."),
    ] = None,
) -> None:
    """Fit each file and write OUT/NAME.json, OUT/logs/NAME.log and a line of OUT/manifest.jsonl.

    Exit code: 0 if all succeeded, 1 if a fit failed, 2 if input was bad.
    """
    from ..settings.config import load
    from .settings import parameters_given, programs_of

    settings = load(
        config, dims=dims, origin=origin, quantity=quantity, model=model, preset=preset, index=index,
        body=body, weights=weights, posterior=posterior, seed=seed,
        parameters=parameters_given(fix, bounds, start, tie),
    )  # fmt: skip
    alone = len(files) == 1 and not resume and accuracy is within is executor is device is None
    with programs_of(settings, files[0]) if alone else nullcontext():
        from .fit import aims_of, device_of, fit_files, summarise

        given = [option for option, x in {"--accuracy": accuracy, "--time": within}.items() if x is not None]
        chosen = device_of(device, settings, *given, *(["--executor"] if executor is not None else []))
        aims = aims_of(settings, accuracy, within, files)
        outcomes = fit_files(files, out, settings, aims, jobs, resume, executor, chosen)
    summarise(outcomes)


@app.command(epilog="Example: merlfit compare nickel.binary red-plastic.binary --models two-scale,ggx,sgd -o compared")
def compare(
    files: Files,
    models: Models = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the tables and all results.")] = Path("compared"),
    config: Settings = None,
    dims: Dims = None,
    weights: SameWeights = None,
    published: Annotated[
        bool, typer.Option("--published/--no-published", help="Beside the fits, published parameters of the material.")
    ] = True,
    force: Force = False,
) -> None:
    """Fit several models to each file; write one table (CSV, Markdown, HTML) and a plot of all their errors.

    Results are in OUT/MODEL/NAME.json; those that are there already are kept if they are of the same file and settings.
    """
    from ..settings.config import load

    settings = load(config, dims=dims, weights=weights, posterior=False)
    from .compare import compare_files

    compare_files(files, models, out, settings, published, force)


@app.command(epilog="Example: merlfit which nickel.binary")
def which(
    file: Annotated[Path, typer.Argument(help="The file, as of `merlfit fit`.", readable=False)],
    models: Models = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder to keep the results in \\[default: they are not kept].")
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(help="Write tables that follow the file as nearly as may be to this MERL file.", metavar="FILE"),
    ] = None,
    posterior: Annotated[
        bool,
        typer.Option(
            "--posterior",
            help="Sample the three of lowest BIC, and print total integrated scatter with intervals that include the "
            "choice among them; minutes.",
        ),
    ] = False,
    dims: Dims = None,
    weights: SameWeights = None,
    force: Force = False,
) -> None:
    """Say which model is the least that explains a material, and how the others compare."""
    from tempfile import TemporaryDirectory

    from ..settings.config import load

    settings = load(None, dims=dims, weights=weights, posterior=False)
    from .compare import which_model

    with TemporaryDirectory(prefix="merlfit-") as scratch:
        which_model(file, models, out or Path(scratch), settings, table, force, posterior, out is not None)


@app.command(epilog="Example: merlfit metrics fits/nickel.json --against nickel.binary")
def metrics(
    results: Annotated[list[Path], typer.Argument(help="RESULT.json of fits.", readable=False)],
    against: Annotated[Path, typer.Option(help="The MERL file to compare with.", readable=False)],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for metrics.csv and the RMSE by theta_i as CSV and PNG.")
    ] = None,
    force: Force = False,
) -> None:
    """Print all errors of fits against a file: RMSE, sMAPE, cube root, log, CIELAB of spheres, peak."""
    from .metrics import metrics_of

    metrics_of(results, against, out, force)


@app.command(epilog="Example: merlfit sample fits/nickel.json")
def sample(
    result: Result,
    file: Measured = None,
    max_steps: Annotated[
        int | None,
        typer.Option(min=1, help="Most steps, beside those of a finished chain \\[default: as the fit was told]."),
    ] = None,
) -> None:
    """Sample the posterior of a fit, or continue the chain that lies beside it, and update both files."""
    from .sample import sample_result

    sample_result(result, file, max_steps)


@app.command(epilog="Example: merlfit synth nickel --source sgd -o nickel-sgd.binary")
def synth(
    material: Annotated[str, typer.Argument(help="MATERIAL of a published table, or RESULT.json of a fit.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The .binary file to write.")],
    source: Annotated[
        str | None, typer.Option(help="Published table, see `merlfit materials` \\[default: sgd].")
    ] = None,
    loss: Annotated[
        bool,
        typer.Option(
            "--with-grazing-loss",
            help="Of a fit: with the light missing that MERL's apparatus loses at grazing angles.",
        ),
    ] = False,
    edit: Set = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
) -> None:
    """Write a MERL file from a published parameter set, or from a fit (of the material, without the apparatus)."""
    from ..pipeline.synthesis import synthesise
    from .settings import values_given

    synthesise(material, out, source, loss, values_given(edit), force)


@app.command(epilog="Example: merlfit materials")
def materials() -> None:
    """List the published tables that `merlfit synth` knows, and their materials."""
    from ..pipeline.synthesis import describe_sources

    console.print(describe_sources())


@app.command(epilog="Example: merlfit models")
def models() -> None:
    """List the reflectance models: their parameters, and where they are from."""
    from .catalogue import models_table

    console.print(models_table())


@app.command(epilog="Example: merlfit inspect fits/nickel.json")
def inspect(
    result: Result,
    file: Measured = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for the pictures \\[default: beside it].")
    ] = None,
    pictures: Annotated[
        str | None,
        typer.Option(
            help="Which pictures, with commas between: lobes,corner; none for the numbers alone \\[default: all]."
        ),
    ] = None,
    beside: Annotated[
        list[str] | None,
        typer.Option(help="Value from elsewhere, beta=0.12 or n=1.2,1.1,1.0, to be printed beside the fit's interval."),
    ] = None,
    kind: Annotated[str, typer.Option("--format", help="png, pdf or svg.")] = "png",
    title: Annotated[
        bool, typer.Option("--title", help="Say above pictures what they are of; their metadata say it always.")
    ] = False,
    force: Force = False,
) -> None:
    """Print a fit's parameters with intervals; write pictures of it, each fit to be printed in a column of a paper.

    Spheres, lobes, isolines, peak, residuals, errors, effects; with a posterior corner plots and a trace.
    """
    from ..show.inspection import inspect_result
    from .settings import values_given

    inspect_result(result, file, out, pictures, kind, force, title, values_given(beside, "--beside"))


@app.command(epilog="Example: merlfit view fits/nickel.json")
def view(
    results: Annotated[list[Path], typer.Argument(help="RESULT.json of fits, side by side.", readable=False)],
    file: Measured = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for what is saved \\[default: beside each result].")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; 0 is any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Look at fits in the browser and edit them: spheres beside the file's, lobes, a slider for each parameter.

    No other machine can reach the page, and it asks nothing of a network. It needs the extra "view".
    """
    from .view import view_results

    view_results(results, file, out, port, browser)


@app.command(epilog="Example: merlfit table fits")
def table(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS", help="A folder, or for latex and html RESULT.json of some.", readable=False),
    ],
    kind: Annotated[
        str,
        typer.Option(
            "--format",
            help="csv (all numbers of a folder, a row a result), latex or html (parameters with 90 % intervals, a "
            "column a result).",
        ),
    ] = "csv",
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The file to write \\[default: table.csv, .tex or .html in the folder]."),
    ] = None,
    force: Force = False,
) -> None:
    """Write results as one table: for a spreadsheet errors, times, parameters, intervals; for a paper the parameters.

    For a spreadsheet it has a row for each result, and one for each file that has none, with the error. Columns:
    docs/result.md.
    """
    from ..show.results_table import ENDINGS, write_parameters, write_table

    if kind not in ENDINGS:
        raise fail(f"--format {kind}: should be {', '.join(ENDINGS)}")
    first = results[0] if results[0].is_dir() else results[0].parent
    path = out or first / f"table.{ENDINGS[kind]}"
    if kind != "csv":
        write_parameters(results, path, kind, force)
    elif len(results) > 1:
        raise fail("--format csv is of one folder; latex and html are of any results")
    else:
        write_table(results[0], out or results[0] / "table.csv", force)


@app.command(epilog="Example: merlfit report fits")
def report(
    folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Folder of results.", readable=False)],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for the pages \\[default: RUN_DIR/report].")
    ] = None,
    files: Annotated[
        Path | None, typer.Option(help="Folder with the MERL files, if they moved since the fits.", readable=False)
    ] = None,
    origin: Annotated[str | None, typer.Option(help="What the files are, in words, if the fits were not told.")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Print a sheet of each result, too: sheets/NAME.pdf.")] = False,
    title: Annotated[str | None, typer.Option(help="Title of the sheet.")] = None,
    sample: Annotated[
        str | None, typer.Option(help="What was measured, on the sheet \\[default: the file's name].")
    ] = None,
    operator: Annotated[str | None, typer.Option(help="Who measured it, on the sheet.")] = None,
    jobs: Pages = None,
    force: Force = False,
) -> None:
    """Write pages that open from disk: an index of all results with pictures, and a page for each one.

    Spheres of file, fit and their difference, lobes, scans, errors over all angles, parameters, posterior. No network
    is used. --pdf prints a sheet for whom it was measured, by Chrome, Chromium or Edge.
    """
    from ..show.sheet import Head
    from .report import report_on

    if not pdf and (title or sample or operator):
        raise fail("--title, --sample and --operator are of the sheet that --pdf prints: add --pdf")
    head = Head(title, sample, operator) if pdf else None
    report_on(folder, out or folder / "report", files, jobs, origin, force, head)


@app.command(epilog="Example: merlfit effects configs/scenes/metal.toml")
def effects(scene: Annotated[Path, typer.Argument(help="SCENE.toml (docs/scenes.md).", readable=False)]) -> None:
    """Find out which effects a scene calls for: each is left out in turn, on the directions that the scene uses."""
    from .scenes import plan_scene

    plan_scene(scene)


@app.command(epilog="Example: merlfit render configs/scenes/metal.toml -o pictures")
def render(
    what: Annotated[list[Path], typer.Argument(help="SCENE.toml, or RESULT.json of fits.", readable=False)],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the pictures.")] = Path("pictures"),
    every: Annotated[bool, typer.Option("--all-effects", help="Leave no effect out.")] = False,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Of a scene: render it with all effects, too, and compare.")
    ] = True,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Of each pixel \\[default: the scene's; of fits as noise wants it].")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the samples.")] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(help="Of one fit: a parameter and factors of its value, as in b=0.5,1,2; given twice, a grid."),
    ] = None,
    environment: Annotated[
        Path | None,
        typer.Option(
            help="Of fits: the light, a picture of latitude and longitude (.exr, .hdr, .npy) \\[default: a studio].",
            readable=False,
        ),
    ] = None,
    size: Annotated[
        int | None, typer.Option(min=16, max=4096, help="Of fits: width of a sphere in pixels \\[default: 256].")
    ] = None,
    exposure: Annotated[float, typer.Option(help="Of fits: in stops; 1 is twice as bright.", min=-30, max=30)] = 0.0,
    edit: Set = None,
    force: Force = False,
) -> None:
    """Render a scene with the effects that it calls for, or fits as spheres beside what was measured.

    A scene's picture is written as picture.exr and .png; with --check the picture of all effects and the difference lie
    beside it, and render.json says what took how long. Exit code: 1 if they differ by more than the tolerance.
    """
    from .scenes import render_scene
    from .settings import values_given
    from .sphere_sheets import Studio, render_results

    if what[0].suffix == ".toml":
        if len(what) > 1 or vary or edit or environment or size or exposure:
            of_fits = "--vary, --set, --environment, --size and --exposure are for the RESULT.json of a fit"
            raise fail(f"one scene at a time; {of_fits}")
        render_scene(what[0], out, every, check, samples, seed, force)
    else:
        studio = Studio.of(environment, size, exposure, samples, seed)
        render_results(what, out, vary or [], values_given(edit), studio, force)


@app.command(epilog="Example: merlfit export fits/nickel.json --to mitsuba -o exported")
def export(
    result: Annotated[
        Path, typer.Argument(help="RESULT.json of a fit; --to mitsuba and rgl also a MERL file.", readable=False)
    ],
    to: Annotated[
        str,
        typer.Option(
            help="mitsuba (scene and tables), rgl (tables that Mitsuba and pbrt-v4 read as they are), merl (.binary), "
            "json (parameters alone), principled (Mitsuba's plugin), gltf, openpbr or blender (parameters of a fit of "
            "disney or openpbr; nearest GGX of others), zemax (table of scatter), abg or k-correlation (parameters by "
            "incidence)."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the files.")] = Path("exported"),
    edit: Set = None,
    force: Force = False,
) -> None:
    """Write a fitted material for another program.

    A scene for Mitsuba 3 renders at once: python -m merlfit.scene.mitsuba OUT/NAME.xml (it needs the extra "mitsuba").
    """
    from .export import export as write_export
    from .settings import values_given

    write_export(result, to, out, values_given(edit), force)


@app.command(epilog="Example: merlfit cost -o cost")
def cost(
    file: Annotated[
        Path | None, typer.Argument(help="A MERL .binary file to measure on \\[default: synthetic materials].")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for JSON, table and plot.")] = Path("cost"),
    repeats: Annotated[int, typer.Option(min=1, help="Fits to measure each time with; their median is taken.")] = 1,
    force: Force = False,
) -> None:
    """Measure on this machine how much time accuracy takes. `merlfit fit --accuracy` and `--time` choose by the result.

    Takes half an hour; if it is interrupted, the same command continues.

    With a FILE it measures that material only and writes the result, but `merlfit fit` does not use it.
    """
    from .cost import measure_on

    measure_on(file, out, repeats, force)


@app.command(epilog="Example: merlfit demo -o demo-out")
def demo(
    out: Out = Path("demo-out"),
    seed: Seed = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
) -> None:
    """Make a synthetic material of known parameters as a MERL file, fit it, and show how near the fit comes to them."""
    from ..pipeline.place import claimed
    from ..show.inspection import show
    from ..support.compilation import use_persistent_cache
    from .demo import SAID, make, settings, truth_table, verdict
    from .fit import fit_files, summarise

    start = time.perf_counter()
    writable_folder(out)
    use_persistent_cache()
    with claimed(out, alone=False):
        path = make(out, force)
    console.print(f"{path}: {SAID}")
    outcomes = fit_files([path], out, settings(seed))
    result = outcomes[0].result
    if result is not None:
        show(out / f"{path.stem}.json", result, path, out, force=force)
    summarise(outcomes)
    if result is not None and result.model is not None:
        console.print(truth_table(result))
        console.print(verdict(result))
    console.print(f"demo done in {time.perf_counter() - start:.0f} s; results in {out}/")
