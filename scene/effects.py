"""Which effects a scene calls for: each is left out in turn, on the directions that the scene really uses.

For every material pixels are drawn by chance, beside the brightest ones, and the light that they get is followed once.
Then the material is evaluated there with all effects, and with fewer: what a pixel is off by is measured, not estimated
from parameters. Effects are tried in a fixed order, those that take most time first, and one is left out if all pixels
looked at stay within the tolerance, together with what has been left out before. A set of effects by which more than
two pixels in a thousand are off by more than the tolerance, at :data:`SAMPLES` directions a pixel, passes with a
probability of 0.998^6336, 3e-6, and one of the ten that are tried with ten times that. A material that
covers fewer pixels is looked at in all of them.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ..merl_io.bands import MERL, Bands
from ..model.part import Part
from ..model.reflectance import Reflectance
from ..model.sampling import Sampler
from ..model.two_scale import TwoScale
from . import colour
from .description import Scene, Tolerance
from .render import Film, Numbers, Rays, Stage, lit, numbers, radiance
from .surface import Material, Surface, drawn, surface

ORDER, COARSE = 64, 12  # of the convolution: of the reference, and where it need not be that fine
SETTLED = ("masking_curve", "variance_curve", "lobe_surface")  # tables that are the same whatever else is left out
FINEST = "finest blur"
PIXELS, SAMPLES = 6912, 16  # looked at, and directions of each light in each
BRIGHTEST, FEW = 12, 4  # one in so many is of the brightest, found by so many samples: highlights may be small
DARK = 0.01  # of white: radiance below it is compared with it
REPEATS = 5  # of a timing


@dataclass(frozen=True)
class Effect:
    """An effect and what takes its place: ``changes`` of the two-scale model's settings, or a part that goes.

    Attributes:
        name: for tables. instead: what there is without it, in words.
    """

    name: str
    instead: str
    changes: tuple[tuple[str, object], ...] = ()
    lobe: str | None = None
    body: bool = False


TWO_SCALE = (
    Effect(FINEST, f"{COARSE} nodes", (("order", COARSE),)),
    Effect("energy split", "that of the paper", (("split", "printed"),)),
    Effect("diffraction", "none", (("diffraction", "off"),)),
    Effect("masking", "none", (("masking", "none"),)),
    Effect("renormalisation", "none", (("renormalised", False),)),
    Effect("blur of diffraction", "plain lobe", (("diffraction", "lobe"),)),
    Effect("specular reflection", "none", lobe="specular"),
    Effect("colour of diffraction", "that of reflection", (("colour", "fresnel"),)),
    Effect("body", "none", (("body", "none"),)),
    Effect("exact Fresnel", "Schlick's", (("fresnel", "schlick"),)),
)
"""In the order in which they are tried: roughly by what they take, tables included."""


def effects_of(model: Reflectance) -> tuple[Effect, ...]:
    """Those that a material has."""
    if not isinstance(model, TwoScale):
        parts = tuple(Effect(f"{lobe} lobe", "none", lobe=lobe) for lobe in model.lobes)
        return (*parts, Effect("body", "none", body=True))
    known = [effect for effect in TWO_SCALE if model.index != "film" or ("fresnel", "schlick") not in effect.changes]
    return tuple(effect for effect in known if without(model, [effect]) != model)


def without(model: Reflectance, effects: Sequence[Effect]) -> Reflectance:
    """A material with these effects left out; settings that nothing is left to heed take their cheapest value."""
    gone = {effect.lobe for effect in effects} - {None}
    if not isinstance(model, TwoScale):
        kept = tuple(lobe for lobe in model.lobes if lobe not in gone)
        body = not any(effect.body for effect in effects)
        return model if kept == (*model.lobes,) and body else Part(model, kept, body)
    changes = dict(change for effect in reversed(effects) for change in effect.changes)
    if model.diffraction != "quadrature" and changes.get("diffraction") == "lobe":
        del changes["diffraction"]  # another tier is what the material was fitted with
    index = {"index": model.index}  # that of "usual" depends on the body
    found = model.changed(**index, **changes)
    kept = tuple(lobe for lobe in found.lobes if lobe not in gone)
    if kept == (*found.lobes,):
        return found
    cheapest = {} if model.index == "film" else {"fresnel": "schlick"}
    if not kept:
        found = found.changed(diffraction="off", masking="none", split=_split(found), **cheapest)
    elif found.colour != "fresnel":
        found = replace(found, fresnel="schlick")  # of the specular term alone
    return Part(found, kept)


def _split(model: TwoScale) -> str:
    """A body under the conserving split is what the surface lets through; nothing else heeds it."""
    return "printed" if model.body == "none" else model.split


Tried = Callable[[Reflectance, Sequence[Effect]], tuple[float, float]]


@dataclass(frozen=True)
class Row:
    """What was found of an effect.

    Attributes:
        effect: which. kept: whether the plan has it. alone: how far off the worst pixel is without it, all others kept.
        together: the same without it and all that had been left out before; None where nothing was left of it.
        nanoseconds: saved a direction by leaving it out alone.
    """

    effect: Effect
    kept: bool
    alone: float
    together: float | None
    nanoseconds: float


@dataclass(frozen=True)
class Plan:
    """What a scene calls for of one material.

    Attributes:
        name: of the material in the scene. chosen: what is simulated; None of what was measured. rows: by effect.
        off_by: how far off the worst pixel is. pixels: that were looked at, of ``of``.
        nanoseconds: a direction takes, with all effects and with those chosen.
    """

    name: str
    chosen: Reflectance | None
    rows: tuple[Row, ...]
    off_by: float
    pixels: int
    of: int
    nanoseconds: tuple[float, float]


@dataclass(frozen=True)
class Given:
    """A material of a scene before anything is left out: a model with values, or a measurement (``model`` None)."""

    name: str
    model: Reflectance | None
    values: Mapping[str, ArrayLike]
    bands: Bands = MERL
    measured: Material | None = None

    def finest(self) -> Material:
        """With all effects, at the finest tier."""
        if self.model is None:
            assert self.measured is not None
            return self.measured
        return self.of(finest(self.model))

    def of(self, model: Reflectance, known: Mapping[str, jax.Array] | None = None) -> Surface:
        """The same values with another choice of effects; ``known``: tables of it."""
        return surface(model, self.values, self.bands, known or {})


def finest(model: Reflectance) -> Reflectance:
    """The same effects by the finest tier that a picture can wait for."""
    if isinstance(model, TwoScale) and model.diffraction == "quadrature":
        return replace(model, order=max(ORDER, model.order))
    return model


def off_by(reference: np.ndarray, other: np.ndarray, tolerance: Tolerance) -> np.ndarray:
    """How far pixels differ, in units of the tolerance's kind; radiance over white, (..., 3)."""
    if tolerance.cielab is not None:
        return colour.difference(np.clip(reference, 0, 1), np.clip(other, 0, 1))  # as a screen shows them
    return np.max(np.abs(reference - other) / np.maximum(reference, DARK), -1)


def allowed(tolerance: Tolerance) -> float:
    """The number."""
    found = tolerance.cielab if tolerance.cielab is not None else tolerance.radiance
    assert found is not None
    return found


@eqx.filter_jit
def _lit(stage: Stage, sampler: Sampler, index: jax.Array, pixel: jax.Array, numbers: Numbers) -> Rays:
    return lit(stage, sampler, index, pixel, numbers.of(pixel))


_radiance = eqx.filter_jit(radiance)


class _Trial:
    """Pixels of one material and the light that they get."""

    def __init__(self, scene: Scene, film: Film, given: Given, index: int) -> None:
        self.scene, self.given = scene, given
        self.seen = film.pixels(index)
        rng = np.random.default_rng([scene.seed, index])
        whole = drawn(given.finest())
        chosen = self.seen
        if len(self.seen) > PIXELS:
            quick = Film(scene, film.stage, FEW)
            seen = np.concatenate([part[0] for part in quick.shade(whole, (), index, self.seen)])
            brightest = np.argsort(-seen.max(-1), kind="stable")
            first = PIXELS // BRIGHTEST
            by_chance = rng.choice(brightest[first:], PIXELS - first, replace=False)
            chosen = self.seen[np.concatenate([brightest[:first], by_chance])]
        self.count = len(chosen)
        filled = np.resize(chosen, PIXELS) if self.count else np.zeros(PIXELS, int)
        few = numbers(scene, SAMPLES)
        material, sampler = whole
        self.rays = _lit(film.stage, sampler, jnp.asarray(index), jnp.asarray(filled, jnp.int32), few)
        values = material.values if isinstance(material, Surface) else {}
        self.tables = {name: x for name, x in values.items() if name in SETTLED}
        self.reference, self.slow = self._measure(material)

    def _measure(self, material: Material) -> tuple[np.ndarray, float]:
        """Radiance over white, and nanoseconds a direction."""
        found = np.asarray(_radiance(material, self.rays))[: self.count] / self.scene.white
        seconds = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            jax.block_until_ready(_radiance(material, self.rays))
            seconds.append(time.perf_counter() - start)
        return found, 1e9 * min(seconds) / self.rays.i[..., 0].size

    def without(self, model: Reflectance, effects: Sequence[Effect]) -> tuple[float, float]:
        """How far off the worst pixel is, and nanoseconds a direction."""
        chosen = without(model, effects)
        again = "lobe_surface" if any(effect.name == FINEST for effect in effects) else None
        known = {name: self.tables[name] for name in SETTLED if name in chosen.tables(scattered=True) and name != again}
        found, nanoseconds = self._measure(self.given.of(chosen, known))
        return float(np.max(off_by(self.reference, found, self.scene.tolerance), initial=0.0)), nanoseconds


def plan(scene: Scene, film: Film, given: Given, index: int, report: Callable[[str], None] = lambda _: None) -> Plan:
    """What the scene calls for of the material ``index``."""
    trial = _Trial(scene, film, given, index)
    if given.model is None:
        return Plan(given.name, None, (), 0.0, trial.count, len(trial.seen), (trial.slow, trial.slow))
    whole = finest(given.model)
    rows, chosen, worst, fast = left_out(whole, trial.without, trial.slow, allowed(scene.tolerance), report)
    return Plan(given.name, chosen, rows, worst, trial.count, len(trial.seen), (trial.slow, fast))


def left_out(
    whole: Reflectance, tried: Tried, slow: float, limit: float, report: Callable[[str], None] = lambda _: None
) -> tuple[tuple[Row, ...], Reflectance, float, float]:
    """Leave each effect out in turn, together with those before, as long as no pixel is off by more than the limit.

    Args:
        tried: how far off the worst pixel of a material is without some effects, and nanoseconds a direction; ``slow``
            are those with all.

    Returns:
        what was found of each; what is left of the material; how far off the worst pixel is then, and nanoseconds.
    """
    gone: list[Effect] = []
    worst, fast, rows = 0.0, slow, []
    for effect in effects_of(whole):
        report(effect.name)
        alone, quick = tried(whole, [effect])
        if without(whole, [*gone, effect]) == without(whole, gone):
            together, dropped = None, True
        else:
            together, time_of_both = tried(whole, [*gone, effect]) if gone else (alone, quick)
            dropped = together <= limit
            if dropped:
                gone.append(effect)
                worst, fast = together, time_of_both
        rows.append(Row(effect, not dropped, alone, together, slow - quick))
    return tuple(rows), without(whole, gone), worst, fast
