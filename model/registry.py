"""All models by name: the two-scale one, and every :class:`Reflectance` of a file in ``rivals/``."""

import inspect
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from .reflectance import Reflectance
from .two_scale import TwoScale


@cache
def models() -> Mapping[str, type[Reflectance]]:
    """Classes of models by name, the two-scale one first; a new file in ``rivals/`` is found without being named."""
    found: dict[str, type[Reflectance]] = {TwoScale.name: TwoScale}
    for path in sorted((Path(__file__).parent / "rivals").glob("[!_]*.py")):
        module = import_module(f".rivals.{path.stem}", __package__)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if issubclass(kind, Reflectance) and kind.__module__ == module.__name__ and not inspect.isabstract(kind):
                if kind.name in found:
                    raise ValueError(f"two reflectance models are named {kind.name}: {found[kind.name]}, {kind}")
                found[kind.name] = kind
    return MappingProxyType(found)
