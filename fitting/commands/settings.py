"""What commands are told of parameters."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ..settings.config import Config, parameters_of
from ..settings.sections import AUTO
from ..support.terminal import fail

Options = Sequence[str] | None


def parameters_given(fix: Options, bounds: Options, start: Options, tie: Options) -> dict[str, dict[str, Any]]:
    """What --fix, --bounds, --start and --tie say of parameters."""
    fixed = {name: _numbers("--fix", said, said.split(",")) for name, said in _named("--fix", fix)}
    bounded, started = {}, {}
    for name, said in _named("--bounds", bounds):
        if said.count(":") != 1:
            raise fail(f"--bounds {name}={said}: should be {name}=LOWER:UPPER, either of which may be left out")
        if said.strip() == ":":
            raise fail(f"--bounds {name}=: bounds nothing: give LOWER, UPPER or both")
        bounded[name] = tuple(_numbers("--bounds", said, [end])[0] if end else None for end in said.split(":"))
    for name, said in _named("--start", start):
        started[name] = _numbers("--start", said, [said])[0]
    for name in _once("--tie", tie or ()):
        if "=" in name:
            raise fail(f"--tie {name}: should be a parameter's name")
    single = {name: values[0] if len(values) == 1 else values for name, values in fixed.items()}
    return parameters_of(single, bounded, started, [name.strip() for name in tie or ()])


def programs_of(settings: Config, file: Path) -> AbstractContextManager[None]:
    """The time in which programs that a fit of this file needs are loaded, while libraries are still imported."""
    from ..support.kept import loaded_ahead  # and JAX, which settings do without

    return loaded_ahead(settings.occasion(file.suffix), settings.model.name != AUTO)


def values_given(given: Options, option: str = "--set") -> dict[str, list[float]]:
    """What --set, or another option, says of parameters: numbers by name."""
    return {name: _numbers(option, said, said.split(",")) for name, said in _named(option, given)}


def _named(option: str, given: Options) -> list[tuple[str, str]]:
    """Name and what follows the equals sign, of every time that the option is given."""
    found = [said.partition("=") for said in given or ()]
    for name, equals, value in found:
        if not (name and equals and value):
            raise fail(f"{option} {name}{equals}{value}: should be a parameter's name, = and what is said of it")
    _once(option, [name for name, _, _ in found])
    return [(name.strip(), value.strip()) for name, _, value in found]


def _once(option: str, names: Sequence[str]) -> Sequence[str]:
    """Names, none of which is given twice."""
    if twice := [name for name in names if names.count(name) > 1]:
        raise fail(f"{option} {twice[0]}: is given twice")
    return names


def _numbers(option: str, said: str, words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise fail(f"{option} {said}: {', '.join(words)} should be numbers") from None
