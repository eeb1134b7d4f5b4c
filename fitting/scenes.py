"""Scenes from the command line: materials from results and files, plans, pictures, and what is said of them."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import typer
from pydantic import ValidationError
from rich.table import Table

from ..merl_io.binary import Measurement, MerlError, read
from ..merl_io.samples import folded
from ..model.parameters import WAVELENGTHS_UM
from ..model.reflectance import Reflectance
from ..model.registry import made
from ..scene import images
from ..scene.colour import difference, displayed
from ..scene.description import Camera, Environment, Scene, SceneError, Source, Sphere, load
from ..scene.effects import Given, Plan, allowed, off_by, plan
from ..scene.render import Film, pictures, stage
from ..scene.surface import Drawn, drawn, measurement
from .output.inspection import file_of
from .results.export import ResultError, read_result
from .results.schema import Result
from .support.clock import Stage
from .support.compilation import make_room, use_persistent_cache
from .support.terminal import (
    BAD_INPUT,
    FAILED_FIT,
    console,
    fail,
    note,
    progress_display,
    reporter,
    writable_folder,
)

SHARE = 0.999  # of the pixels that are to be within the tolerance
LARGEST_SHOWN = 10.0  # CIELAB distance that is white in a picture of differences
STUDIO = Scene(
    camera=Camera(position=(0.0, 0.0, 6.0), field_of_view_deg=20.0), environment=Environment(kind="studio"),
    sphere=[Sphere(material="shown")], materials={"shown": Source(model="two-scale")}, samples=64,
)  # fmt: skip
"""A sphere under the studio's windows, in which results are shown."""
Say = Callable[[str], None]


def given_of(name: str, source: Source, folder: Path) -> Given:
    """A scene's material from where it comes.

    Raises:
        SceneError: what it names is missing or cannot be used.
    """
    where = f"materials.{name}"
    try:
        if source.measured is not None:
            return Given(name, None, {}, WAVELENGTHS_UM, measurement(*folded(read(folder / source.measured))))
        if source.result is not None:
            result = read_result(folder / source.result)
            return of_result(name, result, folder / source.result, source.parameters)
        assert source.model is not None
        model = made(source.model, source.settings)
        if model.objection is not None:
            raise SceneError(f"{where}: {model.objection}")
        return Given(name, model, values_of(model, source.parameters, where), WAVELENGTHS_UM)
    except (MerlError, ResultError, ValueError) as error:
        raise SceneError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def of_result(
    name: str, result: Result, path: Path, changed: Mapping[str, Any] | None = None, as_measured: bool = False
) -> Given:
    """A fitted material with some parameters changed; without the apparatus, or as it saw it."""
    if result.model is None:
        raise SceneError(f"{path}: the fit failed ({result.fit.status}), it has no material")
    if len(result.model.channels) != 3:
        raise SceneError(f"{path}: has {len(result.model.channels)} channels; a picture needs R, G and B")
    model = result.model.measured if as_measured else result.model.material
    values = {**result.values(), **(changed or {})}
    return Given(name, model, values_of(model, values, name), tuple(result.model.wavelengths_um))


def values_of(model: Reflectance, given: Mapping[str, Any], where: str) -> dict[str, np.ndarray]:
    """Parameters checked: all there, as many as there are channels, within what is possible."""
    declared = {q.name: q for q in model.parameters}
    if unknown := given.keys() - declared.keys() - model.ignored():
        raise SceneError(f"{where}: {model} has no parameter {min(unknown)}; it has {', '.join(declared)}")
    found = {}
    for name, q in declared.items():
        if name not in given:
            raise SceneError(f"{where}: {model} needs {name}, {q.meaning}")
        value = np.asarray(given[name], float)
        if value.shape not in ((), (1,), (3,)) or (value.size == 3 and not q.per_channel):
            wanted = "one number, or three" if q.per_channel else "one number"
            raise SceneError(f"{where}: {name} should be {wanted}, not {given[name]}")
        log = q.scale == "log" and name != "k"  # of a metal without absorption k is 0
        least, most = (q.offset if log else min(q.lower, 0.0)), np.inf if q.scale == "log" else max(q.upper, 1.0)
        if not np.all(np.isfinite(value) & (value >= least) & (value <= most)) or (log and np.any(value <= least)):
            least_said = f"{'above' if log else 'at least'} {least:g}"
            most_said = "" if most == np.inf else f" and at most {most:g}"
            raise SceneError(f"{where}: {name} should be {least_said}{most_said}, not {given[name]}")
        found[name] = np.broadcast_to(value.reshape(-1), (3,)).copy() if q.per_channel else value.reshape(())
    return found


@dataclass(frozen=True)
class Staged:
    """A scene with its materials, ready for plans and pictures."""

    scene: Scene
    film: Film
    given: tuple[Given, ...]


def staged(path: Path, **changes: Any) -> Staged:  # noqa: ANN401 - settings of a scene
    """A scene from its file, with some settings changed: samples, seed, camera.

    Raises:
        SceneError: the scene, a material or the environment's map cannot be used.
    """
    scene = changed(load(path), **changes)
    given = tuple(given_of(name, source, path.parent) for name, source in scene.materials.items())
    around, found = scene.environment, None
    if around is not None and around.file is not None:
        found = images.read_map(path.parent / around.file)
    film = Film(scene, stage(scene, found))
    if hidden := [each.name for k, each in enumerate(given) if not len(film.pixels(k))]:
        raise SceneError(f"{path}: no pixel sees {hidden[0]}: move the camera, or take its shapes out")
    return Staged(scene, film, given)


def changed(scene: Scene, **changes: Any) -> Scene:  # noqa: ANN401 - settings of a scene
    """The same with some settings changed, those that are None left as they are."""
    given = {name: value for name, value in changes.items() if value is not None}
    try:
        return Scene.model_validate({**scene.model_dump(), **given})
    except ValidationError as error:
        first = error.errors()[0]
        raise SceneError(f"--{first['loc'][0]}: {first['msg'].replace('Input should be', 'should be')}") from None


def plans_of(ready: Staged, say: Say) -> list[Plan]:
    """What the scene calls for of each material."""
    found = []
    for k, each in enumerate(ready.given):
        make_room()
        found.append(plan(ready.scene, ready.film, each, k, lambda effect, name=each.name: say(f"{name}: {effect}")))
    return found


def plan_table(plans: Sequence[Plan], scene: Scene) -> Table:
    """For people."""
    kind = "CIELAB" if scene.tolerance.cielab is not None else "of the radiance"
    table = Table(title=f"effects within {allowed(scene.tolerance):g} ({kind}), worst of the pixels looked at")
    for heading, justify in (
        ("material", "left"), ("effect", "left"), ("", "left"), ("alone", "right"), ("with those before", "right"),
        ("saves", "right"), ("instead", "left"),
    ):  # fmt: skip
        table.add_column(heading, justify=justify)  # pyright: ignore[reportArgumentType] - left or right
    for each in plans:
        for row in each.rows:
            moot = row.together is None
            together = "nothing left of it" if moot else f"{row.together:.3g}"
            table.add_row(
                each.name, row.effect.name, "kept" if row.kept else "moot" if moot else "dropped", f"{row.alone:.3g}",
                together, f"{row.nanoseconds:.0f} ns", "" if row.kept else row.effect.instead,
            )  # fmt: skip
        looked = "all" if each.pixels == each.of else f"{each.pixels} of"
        said = "measured, as it is" if each.reference is None else f"off by {each.off_by:.3g}"
        slow, fast = each.nanoseconds
        table.add_row(
            each.name, f"[all: {said}]", "", "", f"{looked} {each.of} pixels", f"{slow - fast:.0f} ns",
            f"{slow:.0f} -> {fast:.0f} ns a direction", end_section=True,
        )  # fmt: skip
    return table


def as_json(plans: Sequence[Plan]) -> list[dict[str, Any]]:
    """For programs."""
    return [
        {
            "material": each.name, "off_by": each.off_by, "pixels": each.pixels, "of": each.of,
            "nanoseconds": {"all": each.nanoseconds[0], "chosen": each.nanoseconds[1]},
            "simulated": None if each.chosen is None else repr(each.chosen),
            "effects": [
                {"effect": row.effect.name, "kept": row.kept, "alone": row.alone, "together": row.together,
                 "nanoseconds": row.nanoseconds, "instead": row.effect.instead}
                for row in each.rows
            ],
        }
        for each in plans
    ]  # fmt: skip


@dataclass(frozen=True)
class Rendered:
    """What a render found out: seconds of both ways, and by how much their pictures differ."""

    seconds: dict[str, float]
    difference: dict[str, float]
    within: bool


def _drawn(ready: Staged, plans: Sequence[Plan] | None) -> list[Drawn]:
    """Materials with their tables: of the plan, or with all effects."""
    found = []
    for k, each in enumerate(ready.given):
        chosen = plans[k].chosen if plans is not None else None
        found.append(drawn(each.of(chosen) if chosen is not None else each.finest()))
    return jax.block_until_ready(found)


def _timed(ready: Staged, plans: Sequence[Plan] | None, report: Callable[[float], None]) -> tuple[np.ndarray, float]:
    """A picture and its seconds, tables included; programs are compiled before, on the first pixels of each."""
    for k, each in enumerate(_drawn(ready, plans)):
        for _ in ready.film.shade(each, (), k, ready.film.pixels(k)[:1]):
            pass
    start = time.perf_counter()
    (found,) = pictures(ready.film, _drawn(ready, plans), (), report)
    return found, time.perf_counter() - start


def render(
    ready: Staged, out: Path, plans: Sequence[Plan] | None, check: bool, say: Callable[[str, float], None]
) -> Rendered:
    """Write the picture, and beside it that with all effects and their difference.

    Args:
        plans: which effects; None for all. check: whether to render with all effects, too.
    """
    seconds, found = {}, {}
    if plans is not None:
        picture, seconds["plan"] = _timed(ready, plans, lambda share: say("picture", share))
        _write(out, "picture", picture)
    if plans is None or check:
        whole, seconds["all effects"] = _timed(ready, None, lambda share: say("all effects", share))
        _write(out, "picture" if plans is None else "all_effects", whole)
    if plans is not None and check:
        others = [
            [each.of(p.chosen) if p.chosen is not None else each.finest()]
            for each, p in zip(ready.given, plans, strict=True)
        ]
        whole, same = pictures(ready.film, _drawn(ready, None), others, lambda share: say("difference", share))
        away = off_by(whole, same, ready.scene.tolerance)
        seen = np.zeros(away.size, bool)
        for k in range(len(ready.given)):
            seen[ready.film.pixels(k)] = True
        of_shapes = away.ravel()[seen]
        found = {
            "mean": float(of_shapes.mean()), f"{100 * SHARE:g} % of pixels": float(np.quantile(of_shapes, SHARE)),
            "largest": float(of_shapes.max()), "tolerance": allowed(ready.scene.tolerance),
        }  # fmt: skip
        images.write_png(out / "difference.png", _grey(away / (10 * allowed(ready.scene.tolerance))))
        images.write_exr(out / "difference.exr", np.repeat(away[..., None], 3, -1))
    within = not found or found[f"{100 * SHARE:g} % of pixels"] <= found["tolerance"]
    report = {"seconds": seconds, "difference": found, "within": within, "plan": as_json(plans or ())}
    (out / "render.json").write_text(json.dumps(report, indent=2) + "\n")
    return Rendered(seconds, found, within)


def _write(out: Path, name: str, picture: np.ndarray) -> None:
    images.write_exr(out / f"{name}.exr", picture)
    images.write_png(out / f"{name}.png", picture)


def _grey(share: np.ndarray) -> np.ndarray:
    """8 bits of a number that is white at 1."""
    return np.repeat(np.round(255 * np.clip(share, 0, 1)).astype(np.uint8)[..., None], 3, -1)


def sphere_of(given: Given, scene: Scene) -> np.ndarray:
    """A material as a sphere in the studio, (height, width, 3) over white, with all effects."""
    film = Film(scene, stage(scene))
    material = given.of(given.model) if given.model is not None else given.finest()
    (found,) = pictures(film, [drawn(material)])
    return found


def beside(measured: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Measured, fitted, and their CIELAB distance (white: 10), side by side, 8 bits: HP17 Fig. 12 and 13.

    The fit is shown as the apparatus would have seen it, which loses light at grazing angles; else the rim would show
    what the file lacks, and not what the fit misses.
    """
    away = _grey(difference(measured, fitted) / LARGEST_SHOWN)
    return np.concatenate([displayed(measured), displayed(fitted), away], 1)


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


def varied(result: Result, path: Path, vary: Sequence[str], scene: Scene, say: Say) -> np.ndarray:
    """Spheres of a fit with one parameter or two multiplied by factors, as HP17 Fig. 16 and 17, 8 bits.

    The first parameter goes across, the second down.
    """
    if len(vary) > 2:
        raise SceneError("--vary is given at most twice: across and down")
    axes = [factors_of(each) for each in vary]
    (across, columns), (down, rows) = axes[0], axes[1] if len(axes) > 1 else ("", [1.0])
    values, made_of = result.values(), []
    for name in (name for name in (across, down) if name):
        if name not in values:
            raise SceneError(f"{path}: has no parameter {name}; it has {', '.join(values)}")
    for row in rows:
        line = []
        for column in columns:
            factors = {across: column, **({down: row} if down else {})}
            if len({across, down}) < len(axes):
                raise SceneError(f"--vary names {across} twice")
            changed = {name: np.asarray(values[name]) * factor for name, factor in factors.items()}
            say(", ".join(f"{name} x {factor:g}" for name, factor in factors.items()))
            given = of_result(path.stem, result, path, changed)
            line.append(displayed(sphere_of(given, scene)))
        made_of.append(np.concatenate(line, 1))
    return np.concatenate(made_of)


def plan_scene(path: Path) -> None:
    """`merlfit effects`: print what a scene calls for; exits with 2 after bad input."""
    use_persistent_cache()
    try:
        with progress_display() as progress:
            say = reporter(progress, progress.add_task(path.name, total=None), path.stem)
            ready = staged(path)
            found = plans_of(ready, say)
    except (SceneError, OSError) as error:
        raise fail(str(error)) from None
    console.print(plan_table(found, ready.scene))


def render_scene(path: Path, out: Path, every: bool, check: bool, samples: int | None, seed: int | None) -> None:
    """`merlfit render SCENE`: exits with 2 after bad input, with 1 if the difference exceeds the tolerance."""
    use_persistent_cache()
    writable_folder(out)
    try:
        with progress_display() as progress:
            say = reporter(progress, progress.add_task(path.name, total=None), path.stem)
            ready = staged(path, samples=samples, seed=seed)
            plans = None if every else plans_of(ready, lambda effect: say(f"effects: {effect}"))
            found = render(ready, out, plans, check, lambda what, share: say(Stage(what, share)))
    except (SceneError, OSError) as error:
        raise fail(str(error)) from None
    if plans is not None:
        console.print(plan_table(plans, ready.scene))
    console.print(f"wrote {out / 'picture.exr'} and .png: " + said_of(found, ready.scene), soft_wrap=True)
    if not found.within:
        fail("the picture differs by more than the tolerance from that with all effects: use --all-effects")
        raise typer.Exit(FAILED_FIT)


def said_of(found: Rendered, scene: Scene) -> str:
    """Times and difference in a sentence."""
    times = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in found.seconds.items())
    if not found.difference:
        return times
    ratio = found.seconds["all effects"] / found.seconds["plan"]
    rest = ", ".join(f"{name} {x:.3g}" for name, x in found.difference.items())
    kind = "CIELAB" if scene.tolerance.cielab is not None else "relative radiance"
    return f"{times} ({ratio:.1f} times as fast); difference ({kind}): {rest}"


def render_results(
    paths: Sequence[Path], out: Path, vary: Sequence[str], samples: int | None, seed: int | None
) -> None:
    """`merlfit render RESULT...`: each beside its file, or varied; exits with 2 after bad input."""
    use_persistent_cache()
    writable_folder(out)
    code = 0
    try:
        scene = changed(STUDIO, samples=samples, seed=seed)
    except SceneError as error:
        raise fail(str(error)) from None
    if vary and len(paths) > 1:
        raise fail("--vary is for one fit at a time")
    with progress_display() as progress:
        for path in paths:
            say = reporter(progress, progress.add_task(path.name, total=None), path.stem)
            try:
                target = _render_result(path, out, vary, scene, say)
                console.print(f"wrote {target}", soft_wrap=True)
            except (SceneError, ResultError, MerlError, OSError) as error:
                code = BAD_INPUT
                fail(str(error))
    if code:
        raise typer.Exit(code)


def _render_result(path: Path, out: Path, vary: Sequence[str], scene: Scene, say: Say) -> Path:
    if path.suffix == ".toml":
        raise SceneError(f"{path}: one scene at a time, and no result beside it")
    result = read_result(path)
    if vary:
        target = out / f"{path.stem}.{'-'.join(each.partition('=')[0].strip() for each in vary)}.png"
        images.write_png(target, varied(result, path, vary, scene, say))
        return target
    target = out / f"{path.stem}.png"
    file = file_of(path, result)
    if not file.is_file():
        note(f"{path}: the fit alone; the measured file {file} is not there")
        images.write_png(target, sphere_of(of_result(path.stem, result, path), scene))
        return target
    say("fit")
    fitted = sphere_of(of_result(path.stem, result, path, as_measured=True), scene)
    say("file")
    read_again = result.source.read(file)
    if not isinstance(read_again, Measurement):
        note(f"{path}: the fit alone; {file} holds scattered directions, of which no picture is rendered")
        images.write_png(target, fitted)
        return target
    measured = Given(path.stem, None, {}, WAVELENGTHS_UM, measurement(*folded(read_again)))
    images.write_png(target, beside(sphere_of(measured, scene), fitted))
    return target
