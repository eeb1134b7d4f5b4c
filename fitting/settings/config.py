"""Settings of a run: declared with their defaults, read from TOML, unknown keys refused by name. Without jax.

`models` makes the models to fit of them.
"""

import difflib
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from ...merl_io.source import MerlError, toml
from ...model.effects import PRESETS, TWO_SCALE, idle
from ...model.priors import Constraint
from ..support.choices import WEIGHT_SCHEDULES, Exponent
from .sections import (
    AcquisitionSection,
    ApparatusSection,
    EffectsSection,
    FitSection,
    InputSection,
    ModelSection,
    ParameterSection,
    PosteriorSection,
    PriorsSection,
    Section,
)

UNIONS = {
    "acquisition.grazing_loss": "'auto', 'off', 'free', 'derived' or a number in [0, 1]",
    "model.name": "a model's name, or a list of them",
}

MOVED = {"effects.acquisition": "acquisition.grazing_loss"}


class ConfigError(MerlError):
    """Settings that cannot be used; the message is one line that names the key and the mend."""


class Config(Section):
    """All settings. ``seed`` fixes the sampler's random numbers; fits use none."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    input: InputSection = InputSection()
    model: ModelSection = ModelSection()
    effects: EffectsSection = EffectsSection()
    acquisition: AcquisitionSection = AcquisitionSection()
    apparatus: ApparatusSection = ApparatusSection()
    priors: PriorsSection = PriorsSection()
    parameters: dict[str, ParameterSection] = {}  # noqa: RUF012 - pydantic copies it
    fit: FitSection = FitSection()
    posterior: PosteriorSection = PosteriorSection()

    @model_validator(mode="after")
    def _refuse_idle_keys(self) -> "Config":
        """A setting that was changed from the preset and would have no effect is refused: it is a mistake."""
        effects = self.effects
        for key, where in idle(effects.diffraction).items():
            if getattr(effects, key) != getattr(PRESETS[effects.preset], key):
                raise ValueError(f"effects.{key} has an effect only where effects.{where}: leave it out")
        if effects.index == "complex" and effects.body in ("plastic", "subsurface"):
            raise ValueError(f"effects.body {effects.body!r} has a real index: leave effects.index out")
        if self.apparatus != ApparatusSection() and self.acquisition.grazing_loss != "derived":
            raise ValueError("[apparatus] has an effect only where acquisition.grazing_loss is derived: leave it out")
        if TWO_SCALE not in self.model.names and (changes := _changed(effects)):
            raise ValueError(
                f"effects.{changes[0]} is a setting of the two-scale model, which is not among the models to fit "
                f"({', '.join(self.model.names)}): leave it out, or add the two-scale model to them"
            )
        for model in self.model.rivals:
            if model.objection is not None:
                raise ValueError(f"{model.name}: {model.objection}")
        if not self.has_lobes and self.acquisition != AcquisitionSection():
            raise ValueError("acquisition.grazing_loss has an effect only on sharp lobes, of which the model has none")
        return self

    @property
    def has_lobes(self) -> bool:
        """Whether a model to fit has sharp lobes, as the two-scale one always does."""
        return TWO_SCALE in self.model.names or any(model.lobes for model in self.model.rivals)

    @property
    def constraints(self) -> dict[str, Constraint]:
        """What is said of parameters, by their names."""
        return {name: section.constraint for name, section in self.parameters.items()}

    @property
    def exponents(self) -> tuple[Exponent, ...]:
        """Weights of the last grid, one after the other."""
        return WEIGHT_SCHEDULES[self.fit.weights]

    @property
    def for_scattered(self) -> "Config":
        """The same for scattered directions: without MERL's loss unless it is asked for, and without a posterior."""
        found = self.model_copy(update={"posterior": self.posterior.model_copy(update={"enabled": False})})
        if self.acquisition.grazing_loss != "auto" or not self.has_lobes:
            return found
        return found.model_copy(update={"acquisition": AcquisitionSection(grazing_loss="off")})


def _changed(effects: EffectsSection) -> list[str]:
    """Keys that are not as they are by default."""
    return [key for key in EffectsSection.model_fields if getattr(effects, key) != getattr(EffectsSection(), key)]


class Replaced(TypedDict, total=False):
    """What the command line, or a call from Python, gives beside a file of settings; None for nothing."""

    dims: str | None
    origin: str | None
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
        "dims": ("input", "dims"), "origin": ("input", "origin"), "model": ("model", "name"),
        "preset": ("effects", "preset"), "index": ("effects", "index"),
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


def parse(data: dict[str, Any], where: str) -> Config:
    """Settings from plain data; raises :class:`ConfigError` naming ``where`` and the key."""
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        for union, wanted in UNIONS.items():  # each alternative complains apart
            if key.startswith(f"{union}."):
                raise ConfigError(f"{where}: {union}: should be {wanted}, not {first.get('input')!r}") from None
        if re.fullmatch(r"parameters\.[^.]+\.fixed\..*", key):
            place = key.rsplit(".fixed", 1)[0]
            said = f"should be a number, or a list with one for each channel, not {first.get('input')!r}"
            raise ConfigError(f"{where}: {place}.fixed: {said}") from None
        if first["type"] == "value_error":  # raised here, complete
            said = first["msg"].removeprefix("Value error, ")
            raise ConfigError(f"{where}: {said}" if not key else f"{where}: {key}: {said}") from None
        if first["type"] == "extra_forbidden":
            if key in MOVED:
                raise ConfigError(f"{where}: {key!r} is called {MOVED[key]!r} now") from None
            if key.startswith("parameters.") and key.count(".") == 2:
                of, wrong = key.rsplit(".", 1)
                (near,) = difflib.get_close_matches(wrong, ParameterSection.model_fields, n=1, cutoff=0.0)
                raise ConfigError(
                    f"{where}: unknown key {key!r}; the nearest known one is {f'{of}.{near}'!r}"
                ) from None
            near = difflib.get_close_matches(key, known_keys(), n=1, cutoff=0.3) or difflib.get_close_matches(
                str(first["loc"][-1]), [k.rsplit(".", 1)[-1] for k in known_keys()], n=1, cutoff=0.0
            )
            raise ConfigError(f"{where}: unknown key {key!r}; the nearest known one is {near[0]!r}") from None
        raise ConfigError(f"{where}: {key}: {_in_words(first)}") from None


def _in_words(error: ErrorDetails) -> str:
    """What is wrong with a value, without the names of our classes."""
    if error["type"] == "missing":
        return "is missing"
    given = "a section" if isinstance(error["input"], dict) else repr(error["input"])
    if error["type"] in ("model_type", "dict_type"):
        return f"should be a section with keys of its own, not {given}"
    said = error["msg"].replace("Input should be", "should be").replace("a valid integer", "an integer")
    return f"{said.replace('a valid ', 'a ')}, not {given}"


def known_keys() -> list[str]:
    """Every key with its section."""
    keys = []
    for name, field in Config.model_fields.items():
        kind = field.annotation
        inner = getattr(kind, "model_fields", None)
        keys += [f"{name}.{k}" for k in inner] if inner else [name]
        keys += [name] if inner else []
    return keys
