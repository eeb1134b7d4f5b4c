"""All models by name: the two-scale one, and every :class:`Reflectance` of a file in ``rivals/``."""

import difflib
import inspect
import re
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from .effects import ANY, BODIES, FILMS, KINDS
from .reflectance import Reflectance
from .sum import Sum, lowest, over
from .two_scale import TwoScale


@cache
def models() -> Mapping[str, type[Reflectance]]:
    """Classes of models by name, the two-scale one first; a new file in ``rivals/`` is found without being named."""
    by_name: dict[str, type[Reflectance]] = {TwoScale.name: TwoScale}
    for path in sorted((Path(__file__).parent / "rivals").glob("[!_]*.py")):
        module = import_module(f".rivals.{path.stem}", __package__)
        kinds = [kind for _, kind in inspect.getmembers(module, inspect.isclass) if kind.__module__ == module.__name__]
        for kind in kinds:
            if issubclass(kind, Reflectance) and not (inspect.isabstract(kind) or kind.__name__.startswith("_")):
                if kind.name in by_name:
                    raise ValueError(f"two reflectance models are named {kind.name}: {by_name[kind.name]}, {kind}")
                by_name[kind.name] = kind
    return MappingProxyType(by_name)


def made(name: str, settings: Mapping[str, Any]) -> Reflectance:
    """A model by its name and its settings, as a result or a configuration has them.

    Raises:
        ValueError: there is no such model, or setting, or value of it, or none that can be fitted; the message is one
            line that says what there is.
    """
    known = models()
    if "+" in name:
        return _sum(name, settings)
    if name.startswith("coat("):
        raise ValueError(f"{name!r}: a coat comes first, above another model, as in 'coat(ggx)+epd'")
    if name not in known:
        near = difflib.get_close_matches(name.casefold(), known, n=1)
        nearest = f"; the nearest is {near[0]!r}" if near else ""
        raise ValueError(f"there is no {name!r}{nearest} (`merlfit models` lists the models)")
    declared, hints = [field.name for field in fields(known[name])], get_type_hints(known[name])  # pyright: ignore[reportArgumentType] - models are dataclasses
    checked = {}
    for key, value in settings.items():
        if key not in declared:
            known_settings = f"its settings are {', '.join(declared)}" if declared else "it has no settings"
            raise ValueError(f"{name} has no setting {key!r}: {known_settings}")
        checked[key] = _checked(f"{name}: {key}", value, hints[key])
    model = known[name](**checked)
    if isinstance(model, TwoScale) and model.body == ANY:
        raise ValueError(f"body should be {', '.join(BODIES)}, not {ANY!r}")
    if isinstance(model, TwoScale) and model.diffraction == "exact":
        raise ValueError("diffraction 'exact' is a reference that takes hours; no fit uses it")
    return model


def _sum(name: str, settings: Mapping[str, Any]) -> Sum:
    """Of ``ggx+epd`` or ``coat(ggx)+epd``; settings of the first part are in ``top``, those of the rest in ``base``."""
    first, _, rest = name.partition("+")
    coat = re.fullmatch(r"coat\(([^()]*)\)", first)
    top, coated = coat[1] if coat else first, coat is not None
    if unknown := settings.keys() - {"top", "base", "coated"}:
        raise ValueError(f"{name} has no setting {min(unknown)!r}: its settings are top and base, those of its parts")
    if settings.get("coated", coated) != coated:
        raise ValueError(f"{name}: coated should be {coated}, as the name says")
    return Sum(made(top, settings.get("top", {})), made(rest, settings.get("base", {})), coated)


def variants(name: str) -> tuple[Reflectance, ...]:
    """Those variants of a model that a fit may compare, the simplest first, and then those with a film."""
    model = made(name, {})
    if not isinstance(lowest(model), TwoScale):
        return (model,)
    kinds = [TwoScale(body, index=index) for index, body in (*KINDS, *FILMS)]
    return tuple(over(model, kind) if isinstance(model, Sum) else kind for kind in kinds)


def _checked(where: str, value: object, kind: Any) -> object:  # noqa: ANN401 - a type, or a form of several
    """The value, refused if it is none of a setting's choices, or of another type; a choice "2" may be the number 2."""
    if get_origin(kind) is Literal:
        value = str(value) if type(value) is int else value
        if value not in get_args(kind):
            raise ValueError(f"{where} {value!r} is none of {', '.join(map(str, get_args(kind)))}")
    elif not (type(value) is kind or (kind is float and type(value) is int)):
        raise ValueError(f"{where} {value!r} should be of type {getattr(kind, '__name__', kind)}")
    return value
