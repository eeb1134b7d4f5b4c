"""Results as spheres: each beside its file, or a grid of them with parameters changed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ...merl_io.binary import Measurement
from ...merl_io.samples import folded
from ...merl_io.source import is_regular
from ...model.parameters import Parameter
from ...scene import images
from ...scene.colour import coloured, difference, displayed
from ...scene.description import Camera, Environment, Scene, SceneError, Source, Sphere
from ...scene.effects import Given
from ...scene.render import Film, pictures, stage
from ...scene.surface import drawn, measurement
from ..fit.scattered_errors import LEAST_SHOWN, shown_by
from ..pipeline.editing import edited, edited_file
from ..results.schema import Result
from ..results.storage import read_result
from ..show.inspection import file_of
from ..show.labelled import labelled
from ..show.style import save
from ..show.subject import BETWEEN, on_bins
from ..support.choices import THETA_MAX
from ..support.compilation import use_persistent_cache
from ..support.outputs import refuse_others
from ..support.terminal import (
    BAD_INPUT,
    console,
    fail,
    note,
    progress_display,
    reporter,
    why_ended,
    writable_folder,
)  # fmt: skip
from .scenes import Say, changed, grey, of_result

LARGEST_SHOWN = 10.0  # CIELAB distance that is white in a picture of differences
STUDIO = Scene(
    camera=Camera(position=(0.0, 0.0, 6.0), field_of_view_deg=20.0), environment=Environment(kind="studio"),
    sphere=[Sphere(material="shown")], materials={"shown": Source(model="two-scale")}, samples=64,
)  # fmt: skip
"""A sphere under the studio's windows, in which results are shown."""


def sphere_of(given: Given, scene: Scene) -> np.ndarray:
    """A material as a sphere in the studio, (height, width, 3) over white, with all effects."""
    film = Film(scene, stage(scene))
    material = given.of(given.model) if given.model is not None else given.finest()
    (found,) = pictures(film, [drawn(material)])
    return found


def beside(measured: np.ndarray, fitted: np.ndarray, data: str, what: str = "fit") -> Figure:
    """Measured, fitted, and their CIELAB distance (white: 10), side by side: HP17 Fig. 12 and 13.

    The fit is shown as the apparatus would have seen it, which loses light at grazing angles; else the rim would show
    what the file lacks, and not what the fit misses.

    Args:
        data: of which material the file is, and what it is. what: is beside it.
    """
    away = grey(difference(measured, fitted) / LARGEST_SHOWN)
    pixels = np.concatenate([displayed(measured), displayed(fitted), away], 1)
    return labelled(pixels, ("file", what, f"CIELAB distance, white: {LARGEST_SHOWN:g}"), across=data)


def factors_of(text: str) -> tuple[str, list[float]]:
    """A parameter and factors, from ``sigma_s=0.5,1,2``.

    Raises:
        SceneError: it is not that.
    """
    name, _, numbers = text.partition("=")
    try:
        found = [float(x) for x in numbers.split(",")]
        if not all(0 < x < np.inf for x in found):
            raise ValueError
    except ValueError:
        raise SceneError(f"--vary {text!r}: give a parameter and factors of its value, as in sigma_s=0.5,1,2") from None
    return name.strip(), found


def varied(result: Result, path: Path, vary: Sequence[str], scene: Scene, say: Say) -> Figure:
    """Spheres of a fit with one parameter or two multiplied by factors, as HP17 Fig. 16 and 17.

    The first parameter goes across, the second down; what value each row and column has stands beside it.
    """
    if len(vary) > 2:
        raise SceneError("--vary is given at most twice: across and down")
    axes = [factors_of(each) for each in vary]
    (across, columns), (down, rows) = axes[0], axes[1] if len(axes) > 1 else ("", [1.0])
    if len({across, down}) < len(axes):
        raise SceneError(f"--vary names {across} twice")
    whole = of_result(path.stem, result, path)
    assert whole.model is not None
    declared, values, made_of = {q.name: q for q in whole.model.parameters}, result.values(), []
    for name, factors in axes:
        if name not in declared:
            why = " for a picture of the material, without the apparatus" if name in values else ""
            raise SceneError(f"{path}: has no parameter {name}{why}; it has {', '.join(declared)}")
        for factor in factors:
            _tell_if_outside(declared[name], np.asarray(values[name]) * factor, factor)
    for row in rows:
        line = []
        for column in columns:
            factors = {across: column, **({down: row} if down else {})}
            changed = {name: np.asarray(values[name]) * factor for name, factor in factors.items()}
            say(", ".join(f"{name} x {factor:g}" for name, factor in factors.items()))
            given = of_result(path.stem, result, path, changed)
            line.append(displayed(sphere_of(given, scene)))
        made_of.append(np.concatenate(line, 1))

    def words(name: str, factor: float) -> str:
        value = np.asarray(values[name]) * factor
        return f"{value:.3g} (\u00d7 {factor:g})" if value.ndim == 0 else f"\u00d7 {factor:g}"

    def axis(name: str) -> str:
        unit = declared[name].unit
        return f"{name}: {declared[name].meaning}" + ("" if unit == "1" else f" ({unit})")

    edit = f", {result.edited_words}" if result.edited_from else ""
    of = f"fit of {result.source.material} ({result.data_words}){edit}"
    title = f"{of}, without the grazing loss. Across: {axis(across)}"
    return labelled(
        np.concatenate(made_of), [words(across, factor) for factor in columns],
        [words(down, factor) for factor in rows] if down else (), title, axis(down) if down else "",
    )  # fmt: skip


def _tell_if_outside(kind: Parameter, value: np.ndarray, factor: float) -> None:
    """Say what is outside the bounds of fits, where nothing is known of the accuracy; the impossible is refused."""
    if np.any((value < kind.lower) | (value > kind.upper)) and factor != 1:
        shown = ", ".join(f"{x:.3g}" for x in np.ravel(value))
        note(
            f"--vary {kind.name}: \u00d7 {factor:g} makes it {shown}, outside the bounds of fits "
            f"({kind.lower:g} to {kind.upper:g}): the picture may be wrong"
        )


def render_results(
    paths: Sequence[Path], out: Path, vary: Sequence[str], changes: Mapping[str, ArrayLike], samples: int | None,
    seed: int | None, force: bool = False,
) -> None:  # fmt: skip
    """`merlfit render RESULT...`: each beside its file, or varied; exits with 2 after bad input.

    Args:
        changes: values of parameters to set; pictures are of the result's name, and ``.edited``. force: write over any
            file.
    """
    use_persistent_cache()
    writable_folder(out)
    code, written = 0, set()
    varied_by = "-".join(each.partition("=")[0].strip() for each in vary) + "." * bool(vary)
    scene = changed(STUDIO, samples=samples, seed=seed)
    if vary and len(paths) > 1:
        raise fail("--vary is for one fit at a time")
    with progress_display() as progress:
        for path in paths:
            say = reporter(progress, progress.add_task(path.name, total=None), path.stem)
            try:
                stem = edited_file(path).stem if changes else path.stem
                target = out / f"{stem}.{varied_by}png"
                if target in written:
                    raise SceneError(f"{path}: {target} is of another result of this command: render them one by one")
                refuse_others([target], force)
                _render_result(path, target, vary, changes, scene, say)
                written.add(target)
                console.print(f"wrote {target}")
            except Exception as error:  # of any kind: the next result has its turn
                code = BAD_INPUT
                fail(why_ended(path, error))
    if code:
        raise typer.Exit(code)


def _render_result(
    path: Path, target: Path, vary: Sequence[str], changes: Mapping[str, ArrayLike], scene: Scene, say: Say
) -> None:
    if path.suffix == ".toml":
        raise SceneError(f"{path}: one scene at a time, and no result beside it")
    result = edited(path, read_result(path), changes)
    if vary:
        save(varied(result, path, vary, scene, say), target)
        return
    file = file_of(path, result)
    if not is_regular(file):
        note(f"{path}: the fit alone; the measured file {file} is not there")
        images.write_png(target, sphere_of(of_result(path.stem, result, path), scene))
        return
    say("fit")
    fitted = sphere_of(of_result(path.stem, result, path, as_measured=True), scene)
    say("file")
    read_again = result.source.read(file)
    words = f"{result.source.material}, {result.data_words}"
    if not isinstance(read_again, Measurement):
        read_again, words = on_bins(read_again, read_again.values), words + BETWEEN
        if (share := shown_by(folded(read_again)[1], result.theta_max or THETA_MAX)) < LEAST_SHOWN:
            note(f"{path}: the fit alone; the samples of {file} cover {share:.0%} of what a sphere shows")
            images.write_png(target, fitted)
            return
    values, valid = folded(read_again)
    measured = Given(path.stem, None, {}, measured=measurement(coloured(values, read_again.bands), valid))
    if result.edited_from is not None:
        words += f"; {result.edited_words}"
    save(beside(sphere_of(measured, scene), fitted, words, "edited" if result.edited_from else "fit"), target)
