"""Settings of a run: declared with their defaults, read from TOML, unknown keys refused by name. Without jax.

`models` makes the models to fit of them.
"""

import difflib
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from ...merl_io.source import MerlError, toml
from ...model.apparatus import APPARATUS, Apparatus
from ...model.priors import PRIORS, Constraint, Priors
from ..support.choices import WEIGHT_SCHEDULES, Exponent
from .sections import (
    AcquisitionSection,
    EffectsSection,
    FitSection,
    InputSection,
    ModelSection,
    PosteriorSection,
    effects_section,
    model_section,
    parameter_section,
)

UNIONS = {
    "acquisition.grazing_loss": "'auto', 'off', 'free', 'derived' or a number in [0, 1]",
    "model.name": "a model's name, or a list of them",
    "posterior.enabled": "true, false or 'auto'",
}
LEAST_FACTOR = 1.1  # of a prior: what is known better than that is fixed


class ConfigError(MerlError):
    """Settings that cannot be used; the message is one line that names the key and the mend."""


@dataclass(frozen=True)
class Config:
    """All settings. ``seed`` fixes the sampler's random numbers; fits use none."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    input: InputSection = field(default_factory=InputSection)
    model: Annotated[ModelSection, BeforeValidator(model_section)] = field(default_factory=ModelSection)
    effects: Annotated[EffectsSection, BeforeValidator(effects_section)] = field(default_factory=EffectsSection)
    acquisition: AcquisitionSection = field(default_factory=AcquisitionSection)
    apparatus: Apparatus = APPARATUS
    priors: Priors = PRIORS
    parameters: dict[str, Annotated[Constraint, BeforeValidator(parameter_section)]] = field(default_factory=dict)
    fit: FitSection = field(default_factory=FitSection)
    posterior: PosteriorSection = field(default_factory=PosteriorSection)

    def __post_init__(self) -> None:
        """A setting that was changed and would have no effect is refused: it is a mistake."""
        if self.apparatus != APPARATUS and self.acquisition.grazing_loss != "derived":
            raise ValueError("[apparatus] has an effect only where acquisition.grazing_loss is derived: leave it out")
        usual = EffectsSection()
        changed = [key.name for key in fields(usual) if getattr(self.effects, key.name) != getattr(usual, key.name)]
        if not self.model.with_two_scale and changed:
            raise ValueError(
                f"effects.{changed[-1]} is a setting of the two-scale model, which is not among the models to fit "
                f"({', '.join(self.model.names)}): leave it out, or add the two-scale model to them"
            )
        if not self.has_lobes and self.acquisition != AcquisitionSection():
            raise ValueError("acquisition.grazing_loss has an effect only on sharp lobes, of which the model has none")
        priors = {f"priors.{key.name}": getattr(self.priors, key.name) for key in fields(self.priors)}
        priors |= {f"parameters.{name}.prior": each.prior for name, each in self.parameters.items() if each.prior}
        for place, prior in priors.items():
            if prior.factor < LEAST_FACTOR:
                raise ValueError(f"{place}.factor should be {LEAST_FACTOR} or more, not {prior.factor:g}")

    @property
    def has_lobes(self) -> bool:
        """Whether a model to fit has sharp lobes, as the two-scale one always does."""
        return self.model.with_two_scale or any(model.lobes for model in self.model.rivals)

    @property
    def exponents(self) -> tuple[Exponent, ...]:
        """Weights of the last grid, one after the other."""
        return WEIGHT_SCHEDULES[self.fit.weights]

    @property
    def for_scattered(self) -> "Config":
        """The same for scattered directions: without MERL's loss unless it is asked for."""
        if self.acquisition.grazing_loss != "auto" or not self.has_lobes:
            return self
        return replace(self, acquisition=AcquisitionSection(grazing_loss="off"))

    def occasion(self, kind: str) -> str:
        """What programs a fit of a file with this ending needs depends on."""
        return repr((kind, self.model, self.effects, self.posterior.enabled, self.fit))

    def plain(self) -> dict[str, Any]:
        """As plain data of JSON, from which `parse` makes the same."""
        data = _SETTINGS.dump_python(self, mode="json")
        data["model"] |= data["model"].pop("settings")
        return data


_SETTINGS = TypeAdapter(Config)


class Replaced(TypedDict, total=False):
    """What the command line, or a call from Python, gives beside a file of settings; None for nothing."""

    dims: str | None
    origin: str | None
    quantity: str | None
    model: str | list[str] | None
    preset: str | None
    index: str | None
    body: str | None
    weights: str | None
    posterior: bool | None
    seed: int | None
    parameters: Mapping[str, Mapping[str, Any]] | None


def load(
    path: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    **replaced: Unpack[Replaced],
) -> Config:
    """Settings of a TOML file or of a mapping like it, or the defaults; keys left out keep their defaults.

    What is given beside the file, by the command line, replaces the file's own: a preset its ``effects.preset``, while
    keys that stand beside that in the file go on replacing those of the preset.

    Raises:
        ConfigError: missing file, bad TOML, unknown key (the nearest known one is named), value out of range.
    """
    if path is None or isinstance(path, Mapping):
        data = _copied(path or {})
    else:
        data = toml(Path(path), "settings", ConfigError)
    if unknown := replaced.keys() - Replaced.__annotations__.keys():
        raise TypeError(f"no setting is called {', '.join(sorted(unknown))}: {', '.join(Replaced.__annotations__)}")
    places = {
        "dims": ("input", "dims"), "origin": ("input", "origin"), "quantity": ("input", "quantity"),
        "model": ("model", "name"), "preset": ("effects", "preset"), "index": ("effects", "index"),
        "body": ("effects", "body"), "weights": ("fit", "weights"), "posterior": ("posterior", "enabled"),
    }  # fmt: skip
    for name, (section, key) in places.items():
        value = replaced.get(name)
        value = list(value) if isinstance(value, tuple) else value  # as the command line gives several
        if value not in (None, []) and isinstance(data.setdefault(section, {}), dict):
            data[section][key] = value
    if (seed := replaced.get("seed")) is not None:
        data["seed"] = seed
    if (given := replaced.get("parameters")) and isinstance(own := data.setdefault("parameters", {}), dict):
        data["parameters"] = own | {name: _merged(own.get(name, {}), said) for name, said in given.items()}
    return parse(data, "command line" if path is None else "settings" if isinstance(path, Mapping) else str(path))


def _merged(own: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """What a file of settings says of a parameter, and what is given beside it: a value takes the place of all else."""
    if "fixed" in given:
        return dict(given)
    return {**{key: x for key, x in own.items() if key != "fixed"}, **given}


def parameters_of(
    fix: Mapping[str, ArrayLike] | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    start: Mapping[str, float] | None = None,
    tie: Iterable[str] = (),
) -> dict[str, dict[str, Any]]:
    """The section [parameters] of what a call from Python or the command line says, by parameter name."""
    found: dict[str, dict[str, Any]] = {}
    for name, value in (fix or {}).items():
        found.setdefault(name, {})["fixed"] = np.asarray(value, float).tolist()
    for name, ends in (bounds or {}).items():
        if len(ends) != 2:
            raise ConfigError(f"bounds of {name} should be a lower and an upper one, None for the model's own")
        found.setdefault(name, {}).update(
            {key: float(x) for key, x in zip(("lower", "upper"), ends, strict=True) if x is not None}
        )
    for name, value in (start or {}).items():
        found.setdefault(name, {})["start"] = float(value)
    for name in tie:
        found.setdefault(name, {})["tied"] = True
    return found


def _copied(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: dict(value) if isinstance(value, Mapping) else value for key, value in data.items()}


def parse(data: Mapping[str, Any], where: str) -> Config:
    """Settings from plain data; raises :class:`ConfigError` naming ``where`` and the key."""
    try:
        text = json.dumps(_plain(data, ""))  # of JSON sections are objects, and no other value
    except RecursionError:
        raise ConfigError(f"{where}: its lists or sections lie in each other too deeply") from None
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None
    try:
        return _SETTINGS.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{where}: {_in_words(key, first)}") from None


def _plain(value: object, key: str) -> object:
    """The value of a key as JSON has it: numbers and arrays of NumPy become Python's.

    Raises:
        ValueError: it is of a type that no setting has; the message names the key.
    """
    if isinstance(value, Mapping):
        return {str(name): _plain(inner, f"{key}.{name}" if key else str(name)) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner, key) for inner in value]
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, np.ndarray | np.generic) and not isinstance(python := value.tolist(), np.generic):
        return _plain(python, key)
    raise ValueError(f"{key}: should be a number, a text, true or false, a list or a section, not {value!r}")


def _in_words(key: str, error: ErrorDetails) -> str:
    """What is wrong with a value, without the names of our classes."""
    for union, wanted in UNIONS.items():  # each alternative complains apart
        if key.startswith(f"{union}."):
            return f"{union}: should be {wanted}, not {error['input']!r}"
    if place := re.fullmatch(r"(parameters\.[^.]+\.fixed)\.\d+", key):
        return f"{place[1]}: should be a number, or a list with one for each channel, not {error['input']!r}"
    said = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":  # raised here, complete
        return f"{key}: {said}" if key else said
    if error["type"] == "unexpected_keyword_argument":
        return f"unknown key {key!r}; the nearest known one is {_nearest(key)!r}"
    if error["type"] == "missing":
        return f"{key}: is missing"
    given = "a section" if isinstance(error["input"], dict) else repr(error["input"])
    if error["type"] in ("dataclass_type", "dict_type"):
        return f"{key}: should be a section with keys of its own, not {given}"
    said = said.replace("Input should be", "should be").replace("a valid integer", "an integer")
    return f"{key}: {said.replace('a valid ', 'a ')}, not {given}"


def _nearest(key: str) -> str:
    """The known key that is most like one that is none."""
    if key.startswith("parameters.") and key.count(".") == 2:
        of, wrong = key.rsplit(".", 1)
        return f"{of}.{difflib.get_close_matches(wrong, [each.name for each in fields(Constraint)], cutoff=0.0)[0]}"
    known = known_keys()
    near = difflib.get_close_matches(key, known, cutoff=0.3)
    last = key.rsplit(".", 1)[-1]
    return (near or difflib.get_close_matches(last, [k.rsplit(".", 1)[-1] for k in known], cutoff=0.0))[0]


def known_keys() -> list[str]:
    """Every key with its section."""
    usual, keys = Config(), []
    for section in fields(usual):
        inner = getattr(usual, section.name)
        keys.append(section.name)
        if is_dataclass(inner):
            keys += [f"{section.name}.{each.name}" for each in fields(inner)]
    keys.remove("model.settings")  # its keys stand in the section itself
    return keys
