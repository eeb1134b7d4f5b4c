"""Scenes from the command line: materials from results and files, plans, pictures, and what is said of them."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer
from pydantic import ValidationError
from rich.table import Table

from ...merl_io.atomic import write_text
from ...merl_io.binary import read
from ...merl_io.samples import folded
from ...model.reflectance import Reflectance, innermost
from ...model.registry import made
from ...scene import images
from ...scene.description import Scene, SceneError, Source, load
from ...scene.effects import Given, Plan, allowed, off_by, plan
from ...scene.render import Film, pictures, stage
from ...scene.surface import Material, drawn, measurement
from ..results.schema import Result
from ..results.storage import read_result
from ..support.clock import Stage
from ..support.compilation import make_room, use_persistent_cache
from ..support.numbers import counted
from ..support.outputs import refuse_others
from ..support.tables import table
from ..support.terminal import FAILED_FIT, console, fail, reporting, writable_folder

SHARE = 0.999  # of the pixels that are to be within the tolerance
Say = Callable[[str], None]


def given_of(name: str, source: Source, folder: Path) -> Given:
    """A scene's material from where it comes.

    Raises:
        SceneError: what it names is missing or cannot be used.
    """
    where = f"materials.{name}"
    try:
        if source.measured is not None:
            return Given(name, None, {}, measured=measurement(*folded(read(folder / source.measured))))
        if source.result is not None:
            result = read_result(folder / source.result)
            return of_result(name, result, folder / source.result, source.parameters)
        assert source.model is not None
        model = made(source.model, source.settings)
        return Given(name, model, values_of(model, source.parameters, where))
    except ValueError as error:
        raise SceneError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def of_result(
    name: str, result: Result, path: Path, changed: Mapping[str, Any] | None = None, as_measured: bool = False
) -> Given:
    """A fitted material with some parameters changed; without the apparatus, or as it saw it."""
    if result.model is None:
        raise SceneError(f"{path}: the fit failed ({result.fit.status}), it has no material")
    model = result.model.measured if as_measured else result.model.material
    values = {**result.values(), **(changed or {})}
    bands = result.model.bands
    return Given(name, model, values_of(model, values, name, len(bands)), bands)


def values_of(model: Reflectance, given: Mapping[str, Any], where: str, channels: int = 3) -> dict[str, np.ndarray]:
    """Parameters checked: all there, as many as there are channels, within what is possible."""
    declared = {q.name: q for q in model.parameters}
    if unknown := given.keys() - declared.keys() - innermost(model).passed_over:
        raise SceneError(f"{where}: {model} has no parameter {min(unknown)}; it has {', '.join(declared)}")
    found = {}
    for name, q in declared.items():
        if name not in given:
            raise SceneError(f"{where}: {model} needs {name}, {q.meaning}")
        value = np.asarray(given[name], float)
        if value.shape not in ((), (1,), (channels,)) or (value.size > 1 and not q.per_channel):
            wanted = f"one number, or {'three' if channels == 3 else channels}" if q.per_channel else "one number"
            raise SceneError(f"{where}: {name} should be {wanted}, not {given[name]}")
        log = q.scale == "log" and name != "k"  # of a metal without absorption k is 0
        least, most = (q.offset if log else min(q.lower, 0.0)), np.inf if q.scale == "log" else max(q.upper, 1.0)
        if not np.all(np.isfinite(value) & (value >= least) & (value <= most)) or (log and np.any(value <= least)):
            least_said = f"{'above' if log else 'at least'} {least:g}"
            most_said = "" if most == np.inf else f" and at most {most:g}"
            raise SceneError(f"{where}: {name} should be {least_said}{most_said}, not {given[name]}")
        found[name] = np.broadcast_to(value.reshape(-1), (channels,)).copy() if q.per_channel else value.reshape(())
    return found


Staged = tuple[Film, tuple[Given, ...]]
"""A scene and its materials, ready for plans and pictures."""


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
    return film, given


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
    film, given = ready
    found = []
    for k, each in enumerate(given):
        make_room()
        found.append(plan(film.scene, film, each, k, lambda effect, name=each.name: say(f"{name}: {effect}")))
    return found


def plan_tables(plans: Sequence[Plan], scene: Scene) -> list[Table]:
    """For people, one a material."""
    found, kind = [], "CIELAB" if scene.tolerance.cielab is not None else "of the radiance"
    for each in plans:
        off = "measured, as it is" if each.chosen is None else f"off by {each.off_by:.3g}"
        looked = "all" if each.pixels == each.of else f"{each.pixels} of"
        slow, fast = each.nanoseconds
        title = (
            f"{each.name}: {off} (allowed {allowed(scene.tolerance):g}, {kind}, worst of {looked} "
            f"{counted(each.of, 'pixel')}); {slow:.0f} -> {fast:.0f} ns a direction"
        )
        heads = ("effect", "", "alone", "with those\nbefore", "saves\n(ns)", "instead")
        found.append(table(title, heads, ("effect", "", "instead"), (
            (row.effect.name, "kept" if row.kept else "moot" if row.together is None else "dropped",
             f"{row.alone:.3g}", "-" if row.together is None else f"{row.together:.3g}", f"{row.nanoseconds:.0f}",
             "" if row.kept else row.effect.instead)
            for row in each.rows
        )))  # fmt: skip
    return found


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


def _materials(ready: Staged, plans: Sequence[Plan] | None) -> list[Material]:
    """With their tables: as planned, or with all effects."""
    chosen = [each.chosen for each in plans] if plans is not None else [None] * len(ready[1])
    return [given.finest() if c is None else given.of(c) for given, c in zip(ready[1], chosen, strict=True)]


def _timed(ready: Staged, plans: Sequence[Plan] | None, report: Callable[[float], None]) -> tuple[np.ndarray, float]:
    """A picture and its seconds, tables included; programs are compiled before, on the first pixels of each."""
    film, _ = ready
    for k, each in enumerate(map(drawn, _materials(ready, plans))):
        for _ in film.shade(each, (), k, film.pixels(k)[:1]):
            pass
    start = time.perf_counter()
    (found,) = pictures(film, [drawn(each) for each in _materials(ready, plans)], (), report)
    return found, time.perf_counter() - start


def render(
    ready: Staged, out: Path, plans: Sequence[Plan] | None, check: bool, say: Callable[[str, float], None]
) -> dict[str, Any]:
    """Write the picture, and beside it that with all effects, their difference, and ``render.json``.

    Args:
        plans: which effects; None for all. check: whether to render with all effects, too.

    Returns:
        as in the JSON: seconds of both ways, by how much their pictures differ, whether that is within the tolerance.
    """
    film, given = ready
    seconds, found, limit = {}, {}, allowed(film.scene.tolerance)
    if plans is not None:
        picture, seconds["plan"] = _timed(ready, plans, lambda share: say("picture", share))
        _write(out, "picture", picture)
    if plans is None or check:
        whole, seconds["all effects"] = _timed(ready, None, lambda share: say("all effects", share))
        _write(out, "picture" if plans is None else "all_effects", whole)
    if plans is not None and check:
        reference = [drawn(each) for each in _materials(ready, None)]
        others = [[each] for each in _materials(ready, plans)]
        whole, same = pictures(film, reference, others, lambda share: say("difference", share))
        away = off_by(whole, same, film.scene.tolerance)
        of_shapes = away.ravel()[np.unique(np.concatenate([film.pixels(k) for k in range(len(given))]))]
        found = {
            "mean": float(of_shapes.mean()), f"{100 * SHARE:g} % of pixels": float(np.quantile(of_shapes, SHARE)),
            "largest": float(of_shapes.max()), "tolerance": limit,
        }  # fmt: skip
        images.write_png(out / "difference.png", grey(away / (10 * limit)))
        images.write_exr(out / "difference.exr", np.repeat(away[..., None], 3, -1))
    within = not found or found[f"{100 * SHARE:g} % of pixels"] <= limit
    report = {"seconds": seconds, "difference": found, "within": within, "plan": as_json(plans or ())}
    write_text(out / REPORT, json.dumps(report, indent=2) + "\n")
    return report


def _write(out: Path, name: str, picture: np.ndarray) -> None:
    images.write_exr(out / f"{name}.exr", picture)
    images.write_png(out / f"{name}.png", picture)


def grey(share: np.ndarray) -> np.ndarray:
    """8 bits of a number that is white at 1."""
    return np.repeat(np.round(255 * np.clip(share, 0, 1)).astype(np.uint8)[..., None], 3, -1)


def plan_scene(path: Path) -> None:
    """`merlfit effects`: print what a scene calls for; exits with 2 after bad input."""
    if path.suffix == ".json":
        raise fail(f"{path}: is no scene (SCENE.toml: docs/scenes.md); of a result there is `merlfit render {path}`")
    use_persistent_cache()
    with reporting(path.name, path.stem) as say:
        ready = staged(path)
        found = plans_of(ready, say)
    console.print(*plan_tables(found, ready[0].scene))


REPORT = "render.json"
OUTPUTS = *(f"{name}.{kind}" for name in ("picture", "all_effects", "difference") for kind in ("exr", "png")), REPORT


def render_scene(
    path: Path, out: Path, every: bool, check: bool, samples: int | None, seed: int | None, force: bool = False
) -> None:
    """`merlfit render SCENE`: exits with 2 after bad input, with 1 if the difference exceeds the tolerance.

    Args:
        force: write over any file.
    """
    use_persistent_cache()
    writable_folder(out)
    refuse_others([out / name for name in OUTPUTS], force)
    with reporting(path.name, path.stem) as say:
        ready = staged(path, samples=samples, seed=seed)
        plans = None if every else plans_of(ready, lambda effect: say(f"effects: {effect}"))
        found = render(ready, out, plans, check, lambda what, share: say(Stage(what, share)))
    scene = ready[0].scene
    if plans is not None:
        console.print(*plan_tables(plans, scene))
    console.print(f"wrote {out / 'picture.exr'} and .png: " + said_of(found["seconds"], found["difference"], scene))
    if not found["within"]:
        fail("the picture differs by more than the tolerance from that with all effects: use --all-effects")
        raise typer.Exit(FAILED_FIT)


def said_of(seconds: Mapping[str, float], difference: Mapping[str, float], scene: Scene) -> str:
    """Times and difference in a sentence."""
    times = ", ".join(f"{name} {x:.2f} s" for name, x in seconds.items())
    if not difference:
        return times
    ratio = seconds["all effects"] / seconds["plan"]
    rest = ", ".join(f"{name} {x:.3g}" for name, x in difference.items())
    kind = "CIELAB" if scene.tolerance.cielab is not None else "relative radiance"
    return f"{times} ({ratio:.1f} times as fast); difference ({kind}): {rest}"
