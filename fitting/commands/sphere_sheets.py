"""Results as spheres: each beside its file, or a grid of them with parameters changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

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
from ...scene.surface import Drawn, drawn, measurement
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
from ..support.numbers import counted, distance
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
from .scenes import Say, grey, of_result

LARGEST_SHOWN = 10.0  # CIELAB distance that is white in a picture of differences
QUIET, MOST = 0.3, 256  # CIELAB noise at which spheres are fine, and samples of a pixel at which they have to be
STUDIO = Scene(
    camera=Camera(position=(0.0, 0.0, 6.0), field_of_view_deg=20.0), environment=Environment(kind="studio"),
    sphere=[Sphere(material="shown")], materials={"shown": Source(model="two-scale")}, samples=64,
)  # fmt: skip
"""A sphere under the studio's windows, in which results are shown."""


@dataclass(frozen=True)
class Studio:
    """Where spheres are shown.

    Attributes:
        scene: with samples of a round. radiance: of the environment's map (H, W, 3), if it has one. most: rounds, at
            the most, until the noise is at `QUIET`.
    """

    scene: Scene = STUDIO
    radiance: np.ndarray | None = None
    most: int = 2

    @classmethod
    def of(
        cls, environment: Path | None, size: int | None, exposure: float, samples: int | None, seed: int | None
    ) -> "Studio":
        """The usual one with a map all around, another size, exposure in stops, and samples that are two rounds.

        Raises:
            SceneError: the map cannot be read.
        """
        camera = STUDIO.camera.model_copy(update={"width": size, "height": size}) if size else STUDIO.camera
        around = Environment(kind="map", file=str(environment)) if environment else STUDIO.environment
        whole = samples or STUDIO.samples
        scene = STUDIO.model_copy(update={
            "camera": camera, "environment": around, "white": 2.0**-exposure, "samples": max(whole // 2, 1),
            "seed": STUDIO.seed if seed is None else seed,
        })  # fmt: skip
        radiance = None if environment is None else images.read_map(environment)
        return cls(scene, radiance, 2 if samples else MOST // scene.samples)

    def sphere(self, given: Given) -> "Rendered":
        """A material as a sphere, with all effects, in rounds until the noise is low."""
        material, halves, done = _material(given), np.zeros((2, *self._shape)), 0
        while True:
            for _ in range(max(done, 2)):  # twice as many as before, half of them for each half
                scene = self.scene.model_copy(update={"seed": (self.scene.seed + done) % 2**32})
                halves[done % 2] += _sphere(material, scene, self.radiance)
                done += 1
            one, other = 2 * halves / done
            noise = _noise(one, other)
            if noise <= QUIET or 2 * done > self.most:
                return Rendered((one + other) / 2, noise, done * self.scene.samples)

    @property
    def _shape(self) -> tuple[int, int, int]:
        return self.scene.camera.height, self.scene.camera.width, 3


class Rendered(NamedTuple):
    """A sphere: radiance over white (height, width, 3), its noise (CIELAB, mean over the sphere), samples a pixel."""

    picture: np.ndarray
    noise: float
    samples: int


def _noise(one: np.ndarray, other: np.ndarray) -> float:
    """Noise of the mean of two pictures that are independent: half of how far they are apart, as a screen shows them.

    Errors of both are alike, so that of the mean is as large as half of their difference.
    """
    seen = np.any((one > 0) | (other > 0), -1)
    apart = difference(np.clip(one[seen], 0, 1), np.clip(other[seen], 0, 1))
    return float(apart.mean() / 2) if apart.size else 0.0


def _material(given: Given) -> Drawn:
    return drawn(given.of(given.model) if given.model is not None else given.finest())


def _sphere(material: Drawn, scene: Scene, radiance: np.ndarray | None = None) -> np.ndarray:
    (found,) = pictures(Film(scene, stage(scene, radiance)), [material])
    return found


def sphere_of(given: Given, scene: Scene) -> np.ndarray:
    """A material as a sphere in the studio, (height, width, 3) over white, with all effects and the scene's samples."""
    return _sphere(_material(given), scene)


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


def varied(result: Result, path: Path, vary: Sequence[str], studio: Studio, say: Say) -> tuple[list[Rendered], Figure]:
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
    every: list[Rendered] = []
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
            every.append(studio.sphere(given))
            line.append(displayed(every[-1].picture))
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
    return every, labelled(
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
    paths: Sequence[Path], out: Path, vary: Sequence[str], changes: Mapping[str, ArrayLike], studio: Studio,
    force: bool = False,
) -> None:  # fmt: skip
    """`merlfit render RESULT...`: each beside its file, or varied; exits with 2 after bad input.

    Args:
        changes: values of parameters to set; pictures are of the result's name, and ``.edited``. studio: under an
            environment's map the material alone is written as EXR, too. force: write over any file.
    """
    use_persistent_cache()
    writable_folder(out)
    code, written = 0, set()
    varied_by = "-".join(each.partition("=")[0].strip() for each in vary) + "." * bool(vary)
    if vary and len(paths) > 1:
        raise fail("--vary is for one fit at a time")
    with progress_display() as progress:
        for path in paths:
            say = reporter(progress, progress.add_task(path.name, total=None), path.stem)
            try:
                if path.suffix == ".toml":
                    raise SceneError(f"{path}: one scene at a time, and no result beside it")
                result = edited(path, read_result(path), changes)
                stem = edited_file(path).stem if changes and result.edited_from else path.stem
                targets = [out / f"{stem}.{varied_by}png"]
                if studio.radiance is not None and not vary:
                    targets.append(out / f"{stem}.exr")
                if written & {*targets}:
                    raise SceneError(
                        f"{path}: {targets[0]} is of another result of this command: render them one by one"
                    )
                refuse_others(targets, force)
                found = _render_result(path, result, targets, vary, studio, say)
                written |= {*targets}
                console.print(f"wrote {', '.join(map(str, targets))}; {_said(found)}")
            except Exception as error:  # of any kind: the next result has its turn
                code = BAD_INPUT
                fail(why_ended(path, error))
    if code:
        raise typer.Exit(code)


def _said(found: Sequence[Rendered]) -> str:
    """Noise and samples of the worst of some spheres."""
    worst = max(found, key=lambda each: each.noise)
    return f"noise {distance(worst.noise)} (CIELAB, mean over the sphere) by {counted(worst.samples, 'sample')} a pixel"


def _render_result(
    path: Path, result: Result, targets: Sequence[Path], vary: Sequence[str], studio: Studio, say: Say
) -> list[Rendered]:
    """Write the sheet of a result, and under an environment's map the material alone; all spheres on them."""
    if vary:
        found, figure = varied(result, path, vary, studio, say)
        save(figure, targets[0])
        return found
    beside, sheet = _sheet(path, result, studio, say)
    if len(targets) == 1 and sheet is not None:
        save(sheet, targets[0])
        return beside
    say("material")
    alone = studio.sphere(of_result(path.stem, result, path))
    if sheet is None:
        images.write_png(targets[0], alone.picture)
    else:
        save(sheet, targets[0])
    for target in targets[1:]:
        images.write_exr(target, alone.picture * studio.scene.white)
    return [*beside, alone]


def _sheet(path: Path, result: Result, studio: Studio, say: Say) -> tuple[list[Rendered], Figure | None]:
    """The fit beside its file; None where there is none to show, which a line tells."""
    file = file_of(path, result)
    if not is_regular(file):
        note(f"{path}: the fit alone; the measured file {file} is not there")
        return [], None
    read_again = result.source.read(file)
    words = f"{result.source.material}, {result.data_words}"
    if not isinstance(read_again, Measurement):
        read_again, words = on_bins(read_again, read_again.values), words + BETWEEN
        if (share := shown_by(folded(read_again)[1], result.theta_max or THETA_MAX)) < LEAST_SHOWN:
            note(f"{path}: the fit alone; the samples of {file} cover {share:.0%} of what a sphere shows")
            return [], None
    say("fit")
    fitted = studio.sphere(of_result(path.stem, result, path, as_measured=True))
    say("file")
    values, valid = folded(read_again)
    own = Given(path.stem, None, {}, measured=measurement(coloured(values, read_again.bands), valid))
    measured = studio.sphere(own)
    if result.edited_from is not None:
        words += f"; {result.edited_words}"
    what = "edited" if result.edited_from else "fit"
    return [fitted, measured], beside(measured.picture, fitted.picture, words, what)
