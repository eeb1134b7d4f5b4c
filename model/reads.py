"""Which parameters and tables the factors of a model look up: what they are differentiated by."""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from .effects import LEAST_ORDER
from .geometry import Geometry
from .parameters import WAVELENGTHS_UM, WHICH_BODY
from .reflectance import Reflectance, Values, of_order, setting, shaped


class _Recorder(Mapping[str, Array]):
    """Values, and which of them were looked up.

    It is empty to iterate over: type checkers go over all values, and every factor would seem to read all of them.
    """

    def __init__(self, values: Values) -> None:
        self._values = values
        self.asked: set[str] = set()

    def __getitem__(self, name: str) -> Array:
        value = self._values[name]
        self.asked.add(name)
        return value

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


class Reads(NamedTuple):
    """What factors and tables look up, by their names: parameters, and tables."""

    parameters: Mapping[str, tuple[str, ...]]
    tables: Mapping[str, tuple[str, ...]]


def reads(model: Reflectance, scattered: bool = False) -> Reads:
    """Recorded while they are evaluated once, abstractly; who looks up a table reads the table's parameters, too.

    Args:
        scattered: as of `Reflectance.tables`.
    """
    cheap = of_order(model, LEAST_ORDER)  # on which it does not depend, unless that has other factors
    return _reads(cheap if cheap.factors().keys() == model.factors().keys() else model, scattered)


@cache
def _reads(model: Reflectance, scattered: bool) -> Reads:
    names, tables, factors = [q.name for q in model.parameters], model.tables(scattered), model.factors()
    angle = np.full((1, 1, 1), 0.3)
    example = {
        q.name: np.full(len(WAVELENGTHS_UM), q.default) if q.per_channel else q.default for q in model.parameters
    }
    asked: dict[tuple[str, str], set[str]] = {}

    def look(params: Mapping[str, Array]) -> list[Array]:
        s = setting(Geometry.from_half_difference(angle, angle, angle))
        values = shaped(model, params, s)
        results: dict[tuple[str, str], Array] = {}
        for kind, functions in (("table", tables), ("factor", factors)):
            for name, compute in functions.items():
                recorder = _Recorder(values)
                results[kind, name] = compute(recorder, s)
                asked[kind, name] = recorder.asked
            values |= {name: results["table", name] for name in tables}
        return [*results.values()]

    jax.eval_shape(look, {**example, WHICH_BODY: 0})
    looked_up = {name: tuple(t for t in tables if t in asked["factor", name]) for name in factors}
    read = {name: asked["factor", name].union(*(asked["table", t] for t in looked_up[name])) for name in factors} | {
        name: asked["table", name] for name in tables
    }
    return Reads({name: tuple(q for q in names if q in looked) for name, looked in read.items()}, looked_up)
