"""What the live view shows of one result: spheres beside the file's, and lobes, as often as a hand moves a slider.

A frame is computed as the report's pictures are: tables of the material, its values on bins, and a sparse matrix that
makes pixels of them (`scene.spheres`). While something moves there are fewer bins, fewer pixels under the environment,
which is smooth, and fewer nodes of the blur of diffracted light; when it rests, those of the report.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from ...merl_io.binary import Dims
from ...merl_io.inputs import Input
from ...merl_io.samples import folded
from ...model.measured import with_material
from ...model.reflectance import Reflectance, of_order
from ...scene.colour import cielab, coloured
from ...scene.effects import COARSE, Effect, Row, effects_of, left_out, without
from ...scene.spheres import BLACK, Lighting
from ..fit.weights import within
from ..pipeline.editing import as_set
from ..results.schema import Result
from ..settings.config import ConfigError
from ..show import prediction
from ..show.inspection import file_of
from ..show.prediction import Fitted
from ..show.scans import beside_plane
from ..show.spheres import COMPUTED
from ..show.subject import Subject, subject_of
from .discs import QUICK, disc

QUICK_BINS = 30, 24  # of theta_d and phi_d, at the most
BETWEEN = 121  # viewers of a lobe beside those that see a row of theta_h
TOLERANCE = 1.0  # CIELAB: effects that no pixel shows by more may be left out while something moves
REPEATS = 9  # of a timing
BEYOND = 1e-9  # relative: by so much a number may lie beyond its bounds, having been written in decimals
Planes = np.ndarray
"""Values on folded bins, (C, H, D, P/2), 1/sr."""
Radiance = dict[Lighting, np.ndarray]
"""Of the pixels inside a sphere, over white, (N, 3) by lighting."""
Found = TypeVar("Found")


@dataclass(frozen=True)
class Look:
    """What is looked at: a material by all its numbers, and without some effects.

    Attributes:
        values: in the order of the result's ``parameters``. off: names of effects that are left out. moving: whether a
            hand moves something, so that a frame in time is worth more than a fine one.
    """

    values: tuple[float, ...]
    off: tuple[str, ...] = ()
    moving: bool = False


class Shown:
    """A result, its file if that is there, and the last frame of it.

    Raises:
        merlfit.ResultError: it is none. merlfit.NoPicture: the fit failed.
    """

    def __init__(self, path: Path, result: Result, file: Path | Input | None = None) -> None:
        self.path, self.result = path, result
        self.subject: Subject = subject_of(result, path, file or file_of(path, result))
        self.model = self.subject.model
        self.whole: Reflectance = self.model.material
        self.effects: tuple[Effect, ...] = effects_of(self.whole)
        self.planned: Reflectance | None = None  # of which a frame is that moves, once effects were tried
        self._last: dict[str, tuple[object, Any]] = {}

    def numbers(self, given: Mapping[str, float]) -> tuple[float, ...]:
        """In the order of the result's ``parameters``: those given, what is tied to them, the others as fitted.

        Raises:
            ConfigError: there is no such free parameter, or a number is outside its bounds.
        """
        free = {q.name: q for q in self.result.parameters if q.fitted == "free"}
        for name, value in given.items():
            if (q := free.get(name)) is None:
                raise ConfigError(f"there is no free parameter {name!r}; there are {', '.join(free)}")
            slack = BEYOND * max(abs(q.lower), abs(q.upper))
            if not q.lower - slack <= value <= q.upper + slack:
                raise ConfigError(f"{name}: {value:g} is outside its bounds, {q.lower:g} to {q.upper:g}")
        given = {name: min(max(value, free[name].lower), free[name].upper) for name, value in given.items()}
        leading = {q.parameter: given[q.name] for q in free.values() if q.name in given}
        tied = {
            q.name: leading[q.parameter]
            for q in self.result.parameters
            if q.fitted == "tied" and q.parameter in leading
        }
        return tuple({**given, **tied}.get(q.name, q.value) for q in self.result.parameters)

    def changes(self, given: Mapping[str, float]) -> dict[str, float]:
        """What differs from the result, as `editing.edited` takes it."""
        numbers = zip(self.result.parameters, self.numbers(given), strict=True)
        return as_set(self.result, {q.name: value for q, value in numbers if value != q.value})

    def material(self, look: Look) -> Fitted:
        """The material with its tables."""
        return self._once("material", look, lambda: self._of(self._simulated(look), look.values))

    def _simulated(self, look: Look) -> Reflectance:
        """Which effects: all but those that are off; while something moves those that are seen, by a coarser blur."""
        off = [effect for effect in self.effects if effect.name in look.off]
        if not look.moving:
            return without(self.whole, off) if off else self.whole
        seen = self.planned if self.planned is not None and not off else without(self.whole, off)
        return of_order(seen, COARSE)

    def _of(self, material: Reflectance, values: Sequence[float]) -> Fitted:
        seen = with_material(self.model.measured, material)
        return Fitted.of_effects(seen, tuple(self.model.wavelengths_um), self.result.values(np.asarray(values)))

    def radiance(self, look: Look) -> Radiance:
        """Of the material's spheres, as the apparatus would have seen it, where the file has data."""
        return self._once("radiance", look, lambda: self._radiance(self.material(look), look.moving))

    def _radiance(self, fitted: Fitted, moving: bool) -> Radiance:
        dims, sides = self.dims(moving), QUICK if moving else COMPUTED
        planes = np.where(self._used(dims), prediction.all_bins(fitted, dims), 0.0)
        return {lighting: self._lit(lighting, sides[lighting], dims, planes) for lighting in sides}

    def _lit(self, lighting: Lighting, side: int, dims: Dims, planes: Planes) -> np.ndarray:
        found = disc(lighting, side, dims).weights @ planes.reshape(len(planes), -1).T.astype(np.float32)
        return coloured(found.T, self.model.bands).T

    def dims(self, moving: bool) -> Dims:
        """Bins of which spheres are made."""
        rows, *others = self.subject.dims
        theta_d, phi_d = map(min, others, QUICK_BINS) if moving else others
        return rows, theta_d, phi_d

    def _used(self, dims: Dims) -> np.ndarray:
        """Folded bins that are pictured: those that the file has data in and that the fit was of."""
        planes = self._pictured
        rows = (
            ((np.arange(n) + 0.5) * m / n).astype(int)
            for n, m in zip((dims[1], dims[2] // 2), planes.shape[1:], strict=True)
        )
        return planes[np.ix_(np.arange(planes.shape[0]), *rows)]

    @cached_property
    def _pictured(self) -> np.ndarray:
        if self.subject.measurement is None:
            return self.subject.grid.above[..., : self.subject.dims[2] // 2]
        valid = folded(self.subject.measurement)[1]
        return valid & within(self.subject.grid, self.subject.theta_max)[..., : valid.shape[-1]]

    @cached_property
    def measured(self) -> Radiance | None:
        """Of the file's spheres; None without a file."""
        if self.subject.measurement is None:
            return None
        planes = np.where(self._pictured, folded(self.subject.measurement)[0], 0.0)
        return {lighting: self._lit(lighting, COMPUTED[lighting], self.subject.dims, planes) for lighting in COMPUTED}

    def apart(self, found: Radiance) -> dict[str, float] | None:
        """Mean CIELAB distance from the file's spheres over pixels that are lit in either, by lighting."""
        if self.measured is None:
            return None
        return {lighting: _mean_distance(self.measured[lighting], found[lighting]) for lighting in COMPUTED}

    def lobe(self, look: Look, theta_i: float) -> dict[str, Any]:
        """Curves in the plane of incidence for plots, each a list by channel: what is not there is None.

        ``angles`` of viewers (deg); ``fit`` as it is looked at and ``before`` as fitted; ``low`` and ``high`` of the
        posterior's predictions, unless something moves; ``file`` with its own ``at``, where it has data.
        """
        i, o, still = self._once("still", theta_i, lambda: self._still(theta_i))
        own = self._once("lobe", (look, theta_i), lambda: _lists(prediction.predicted_lobe(self.material(look), i, o)))
        bands = {} if look.moving else self._once("bands", theta_i, lambda: self._bands(i, o))
        return {"theta_i": theta_i, "fit": own, **still, **bands}

    def _still(self, theta_i: float) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        """What does not change with the parameters."""
        angles, is_datum = prediction.viewers(theta_i, np.degrees(self.subject.grid.theta_h), BETWEEN)
        i, o = prediction.plane_of_incidence(np.radians(theta_i), np.radians(angles))
        found: dict[str, Any] = {"angles": np.round(angles, 3).tolist()}
        found["before"] = _lists(prediction.predicted_lobe(self.subject.fitted, i, o))
        if (measurement := self.subject.measurement) is not None:
            where = prediction.half_difference(i[is_datum], o[is_datum])
            found["at"] = np.round(angles[is_datum], 3).tolist()
            found["file"] = _lists(prediction.measured_lobe(measurement, self.subject.grid, *where))
        if (m := self.subject.scattered) is not None:  # its own samples rather than what lies between them
            theta_s, near = beside_plane(m, np.radians(theta_i))
            found["at"] = np.round(theta_s[near], 3).tolist()
            found["file"] = _lists(m.values[:, near])
        return i, o, found

    def _bands(self, i: np.ndarray, o: np.ndarray) -> dict[str, Any]:
        if self.subject.likely is None:
            return {}
        low, high = prediction.band(self.subject.likely, prediction.from_vectors(i, o))
        return {"low": _lists(low), "high": _lists(high)}

    def tried(self, values: Sequence[float], alone: Lock) -> tuple[tuple[Row, ...], Reflectance, float]:
        """What each effect changes and costs here, and what is left without those that no pixel shows.

        Args:
            alone: held while times are measured: no frame is made meanwhile.

        Returns:
            rows, material and nanoseconds a direction as of `scene.effects.left_out`; with all effects.
        """
        reference, slow = self._timed(self.whole, values, alone)

        def tried(whole: Reflectance, effects: Sequence[Effect]) -> tuple[float, float]:
            found, nanoseconds = self._timed(without(whole, effects), values, alone)
            apart = (np.linalg.norm(a - b, axis=-1).max() for a, b in zip(found, reference, strict=True))
            return float(max(apart)), nanoseconds

        rows, left, *_ = left_out(self.whole, tried, slow, TOLERANCE)
        return rows, left, slow

    def _timed(self, material: Reflectance, values: Sequence[float], alone: Lock) -> tuple[list[np.ndarray], float]:
        """Spheres as screens show them while something moves, CIELAB, and nanoseconds a direction, tables included."""
        found = [cielab(np.clip(x, 0, 1)) for x in self._radiance(self._of(material, values), True).values()]
        dims, seconds = self.dims(True), []
        with alone:
            for _ in range(REPEATS):
                start = time.perf_counter()
                prediction.all_bins(self._of(material, values), dims)
                seconds.append(time.perf_counter() - start)
        return found, 1e9 * min(seconds) / (np.prod(dims[:2]) * prediction.AZIMUTHS)

    def _once(self, what: str, key: object, make: Callable[[], Found]) -> Found:
        """What was made last, if it is of the same."""
        if what not in self._last or self._last[what][0] != key:
            self._last[what] = key, make()
        return self._last[what][1]


def _mean_distance(one: np.ndarray, other: np.ndarray) -> float:
    ours, theirs = cielab(one), cielab(other)
    seen = np.maximum(ours[:, 0], theirs[:, 0]) > BLACK
    return float(np.linalg.norm(ours - theirs, axis=-1)[seen].mean()) if seen.any() else 0.0


def _lists(curves: np.ndarray) -> list[list[float | None]]:
    """Four digits of each, None for what is no number."""
    return [[float(f"{x:.4g}") if np.isfinite(x) else None for x in curve] for curve in curves.tolist()]
