"""Settings of a run: declared with their defaults, read from TOML, unknown keys refused by name."""

import difflib
import importlib.util
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, Unpack

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from ...merl_io.bands import MERL, Bands
from ...merl_io.binary import Dims, dims_of
from ...model.acquisition import Apparatus
from ...model.measured import GrazingLoss, Measured
from ...model.parameters import PRIORS, LogNormal, Priors
from ...model.reflectance import Reflectance
from ...model.registry import made
from ...model.two_scale import KINDS, PRESETS, Colour, Diffraction, Fresnel, Kind, Masking, Split, TwoScale
from ..objective.problem import AZIMUTHS, Precision
from ..objective.transforms import Layout, layout_of
from ..objective.weights import RUNGS, THETA_MAX, Bend, Weights
from ..solve.levenberg_marquardt import Backend

UNIONS = {
    "acquisition.grazing_loss": "'auto', 'off', 'free', 'derived' or a number in [0, 1]",
    "model.name": "a model's name, or a list of them",
}
MOVED = {"effects.acquisition": "acquisition.grazing_loss"}


class ConfigError(ValueError):
    """Settings that cannot be used; the message is one line that names the key and the mend."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class InputSection(_Section):
    """[input]: what files may hold.

    Attributes:
        dims: numbers of bins of theta_h, theta_d and phi_d, as in "45x45x90", that MERL-like files may have beside
            MERL's own 90x90x180; empty for no others.
        origin: what files that are not genuine MERL are, in words, such as "neural reconstructions"; results, pictures
            and pages repeat it.
    """

    dims: str = ""
    origin: Annotated[str, Field(max_length=200)] = ""

    @field_validator("dims")
    @classmethod
    def _read(cls, dims: str) -> str:
        if dims:
            dims_of(dims)
        return dims

    @property
    def allowed(self) -> Dims | None:
        """As numbers."""
        return dims_of(self.dims) if self.dims else None


class ModelSection(_Section):
    """[model]: which reflectance models are fitted.

    Attributes:
        name: of one of ``merlfit models``, or a list of several, which are compared. Other keys are settings of the
            model; those of the two-scale model are in [effects].
    """

    model_config = ConfigDict(extra="allow")
    name: str | list[str] = TwoScale.name

    @property
    def names(self) -> list[str]:
        """As a list."""
        return [self.name] if isinstance(self.name, str) else self.name

    @field_validator("name", mode="before")
    @classmethod
    def _one(cls, name: object) -> object:
        """A list of one is that one."""
        return name[0] if isinstance(name, (list, tuple)) and len(name) == 1 else name

    @model_validator(mode="after")
    def _known(self) -> "ModelSection":
        if not self.names or len(set(self.names)) < len(self.names):
            raise ValueError(f"name {self.name!r} should be one model, or several different ones")
        if self.model_extra and len(self.names) > 1:
            raise ValueError(f"{next(iter(self.model_extra))} is a setting of one model, and several are compared")
        if self.model_extra and self.names == [TwoScale.name]:
            raise ValueError(
                f"{next(iter(self.model_extra))!r} is none of its keys: it has 'name', and settings of the two-scale "
                "model belong in [effects]"
            )
        for name in self.names:
            made(name, self.model_extra or {})
        return self


class EffectsSection(_Section):
    """[effects]: which effects are simulated, as :class:`merlfit.model.two_scale.TwoScale` describes them.

    Attributes:
        preset: effects by name (``merlfit.model.two_scale.PRESETS``); keys given beside it replace its own.
        index, body: ``auto`` compares those of ``model.two_scale.KINDS`` that agree with what is given here.
    """

    preset: Literal["hp17", "conserving", "microfacet", "preview", "fast"] = "hp17"
    index: Literal["auto", "complex", "real"] = "auto"
    body: Literal["auto", "none", "lambert", "plastic", "subsurface"] = "auto"
    diffraction: Diffraction = TwoScale.diffraction
    order: Annotated[int, Field(ge=6, le=256)] = TwoScale.order
    zonal_order: Annotated[int, Field(ge=1, le=1000)] = TwoScale.zonal_order
    fresnel: Fresnel = TwoScale.fresnel
    masking: Masking = TwoScale.masking
    renormalised: bool = TwoScale.renormalised
    split: Split = TwoScale.split
    colour: Colour = TwoScale.colour

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, data: object) -> object:
        name = data.get("preset", "hp17") if isinstance(data, dict) else None
        if not isinstance(data, dict) or not isinstance(name, str) or name not in PRESETS:
            return data  # which the fields will complain about
        preset = asdict(PRESETS[name])
        if "exact" in (preset["diffraction"], data.get("diffraction")):
            raise ValueError("exact is a reference that takes hours on MERL's grid: fit with quadrature")
        return {**{k: v for k, v in preset.items() if k not in ("index", "body")}, **data}


class AcquisitionSection(_Section):
    """[acquisition]: what the apparatus does to a material (:class:`merlfit.model.measured.Measured`).

    Attributes:
        grazing_loss: ``auto`` is ``free`` on files like MERL's and ``off`` on scattered directions, which another
            apparatus measured.
    """

    grazing_loss: Literal["auto"] | GrazingLoss | Annotated[float, Field(ge=0, le=1)] = "auto"


class ApparatusSection(_Section):
    """[apparatus]: what a ``derived`` grazing loss assumes (:class:`merlfit.model.acquisition.Apparatus`)."""

    sphere_radius_px: Annotated[float, Field(gt=0)] = Apparatus.sphere_radius_px
    pixel_sigma_px: Annotated[float, Field(gt=0)] = Apparatus.pixel_sigma_px
    lamp_sigma_rad: Annotated[float, Field(ge=0)] = Apparatus.lamp_sigma_rad
    camera_nearness: Annotated[float, Field(ge=0, lt=1)] = Apparatus.camera_nearness
    lamp_nearness: Annotated[float, Field(ge=0)] = Apparatus.lamp_nearness


class LogNormalSection(_Section):
    """A log-normal prior: median, and the factor of one standard deviation up or down."""

    median: Annotated[float, Field(gt=0)]
    factor: Annotated[float, Field(ge=1.1)]


def _prior(name: str) -> LogNormalSection:
    return LogNormalSection(**asdict(getattr(PRIORS, name)))


class PriorsSection(_Section):
    """[priors]: what is known of the parameters beforehand (:class:`merlfit.model.parameters.Priors`)."""

    half_width: LogNormalSection = _prior("half_width")
    p: LogNormalSection = _prior("p")
    b: LogNormalSection = _prior("b")
    c: LogNormalSection = _prior("c")
    sigma_rel: LogNormalSection = _prior("sigma_rel")
    n: LogNormalSection = _prior("n")
    k: LogNormalSection = _prior("k")
    eta: LogNormalSection = _prior("eta")
    dispersion: LogNormalSection = _prior("dispersion")
    odds: LogNormalSection = _prior("odds")


class FitSection(_Section):
    """[fit]: the solver, and what accuracy it works with.

    Attributes:
        starts: of the coarse grid's race: three times as many starting points run its first lap, so many the second.
        coarse_steps, max_steps: evaluations at the most, a start on the coarse grid and on the last one.
        weights: of the bins: ``compressive`` (HP17 Eq. 57-58), ``log``, ``none``, or ``adaptive``, which tries several
            exponents of the compressive weight and keeps the nearest picture (``weights.RUNGS``).
        theta_max: light or viewer past this angle (rad) are left out, of the objective and of all errors.
        grid: rows of theta_h and theta_d that the last steps use (``run.GRIDS``): all of them, a seventh, a 22nd.
        azimuths: nodes that a row of azimuths is gathered in (``merl_io.azimuth``).
        precision: of the model; sums are always taken in float64.
        backend: solver; others than optimistix are for cross-checks.
    """

    starts: Annotated[int, Field(ge=1, le=32)] = 8
    coarse_steps: Annotated[int, Field(ge=1)] = 80
    max_steps: Annotated[int, Field(ge=1)] = 200
    weights: Weights = "compressive"
    theta_max: Annotated[float, Field(ge=0.5, le=1.571)] = THETA_MAX
    grid: Literal["fine", "medium", "coarse"] = "fine"
    azimuths: Annotated[int, Field(ge=2, le=90)] = AZIMUTHS
    precision: Precision = "float64"
    backend: Backend = "optimistix"

    @field_validator("backend")
    @classmethod
    def _installed(cls, backend: Backend) -> Backend:
        if importlib.util.find_spec(backend) is None:
            raise ValueError(f"{backend} is not installed (pip install 'merlfit[crosscheck]')")
        return backend


class PosteriorSection(_Section):
    """[posterior]: the sampler.

    Attributes:
        enabled: whether to sample at all. max_steps: at the most, after those of tuning; sampling stops when
            the chain is good enough.
    """

    enabled: bool = True
    max_steps: Annotated[int, Field(ge=10)] = 6000


class Config(_Section):
    """All settings. ``seed`` fixes the sampler's random numbers; fits use none."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    input: InputSection = InputSection()
    model: ModelSection = ModelSection()
    effects: EffectsSection = EffectsSection()
    acquisition: AcquisitionSection = AcquisitionSection()
    apparatus: ApparatusSection = ApparatusSection()
    priors: PriorsSection = PriorsSection()
    fit: FitSection = FitSection()
    posterior: PosteriorSection = PosteriorSection()

    @model_validator(mode="after")
    def _refuse_idle_keys(self) -> "Config":
        """What was changed from the preset and would have no effect is a mistake, better told than passed over."""
        effects, lit = self.effects, self.effects.diffraction != "off"
        useful = {
            "order": (effects.diffraction in ("quadrature", "scaled"), "effects.diffraction is quadrature or scaled"),
            "zonal_order": (effects.diffraction == "zonal", "effects.diffraction is zonal"),
            "renormalised": (lit, "effects.diffraction is not off"),
            "colour": (lit, "effects.diffraction is not off"),
        }
        for key, (used, when) in useful.items():
            if not used and getattr(effects, key) != getattr(PRESETS[effects.preset], key):
                raise ValueError(f"effects.{key} has an effect only where {when}: leave it out")
        if effects.index == "complex" and effects.body in ("plastic", "subsurface"):
            raise ValueError(f"effects.body {effects.body!r} has a real index: leave effects.index out")
        if self.apparatus != ApparatusSection() and self.acquisition.grazing_loss != "derived":
            raise ValueError("[apparatus] has an effect only where acquisition.grazing_loss is derived: leave it out")
        if TwoScale.name not in self.model.names and (idle := _changed(effects)):
            raise ValueError(
                f"effects.{idle[0]} is a setting of the two-scale model, which is not among the models to fit "
                f"({', '.join(self.model.names)}): leave it out, or add the two-scale model to them"
            )
        for model in self.candidates:
            if model.material.objection is not None:
                raise ValueError(f"{model.material.name}: {model.material.objection}")
        losing = [model for model in self.candidates if model.lobes]
        if not losing and self.acquisition != AcquisitionSection():
            raise ValueError("acquisition.grazing_loss has an effect only on sharp lobes, of which the model has none")
        return self

    @property
    def candidates(self) -> list[Measured]:
        """Models to compare, those with the fewest parameters first; of the two-scale model every kind asked for."""
        found: list[Measured] = []
        for name in self.model.names:
            if name == TwoScale.name:
                found += [self.two_scale(kind) for kind in self._kinds]
            else:
                found.append(self.measured(made(name, self.model.model_extra or {})))
        return sorted(found, key=lambda model: _numbers(model.material))

    @property
    def _kinds(self) -> list[Kind]:
        """Interfaces and bodies to compare, the simplest first."""
        given = self.effects.index, self.effects.body
        found = [kind for kind in KINDS if all(g in ("auto", k) for g, k in zip(given, kind, strict=True))]
        return found or [("real", "none")]  # the only other one that `TwoScale` allows

    @property
    def rungs(self) -> tuple[Bend, ...]:
        """Weights of the last grid, one after the other."""
        return RUNGS[self.fit.weights]

    def two_scale(self, kind: Kind) -> Measured:
        """The two-scale model to fit with one interface and body."""
        chosen = self.effects.model_copy(update=dict(zip(("index", "body"), kind, strict=True)))
        return self.measured(TwoScale(**chosen.model_dump(exclude={"preset"})))

    def measured(self, material: Reflectance) -> Measured:
        """A material as the apparatus sees it."""
        loss = self.acquisition.grazing_loss
        return Measured(material, "free" if loss == "auto" else loss, Apparatus(**self.apparatus.model_dump()))

    @property
    def for_scattered(self) -> "Config":
        """The same for scattered directions: without MERL's loss unless it is asked for, and without a posterior."""
        found = self.model_copy(update={"posterior": self.posterior.model_copy(update={"enabled": False})})
        if self.acquisition.grazing_loss != "auto" or not any(model.lobes for model in self.candidates):
            return found
        return found.model_copy(update={"acquisition": AcquisitionSection(grazing_loss="off")})

    def layout_of(self, model: Reflectance, bands: Bands = MERL) -> Layout:
        """The parameters of a model to fit, in the coordinates that the priors make."""
        priors = Priors(**{name: LogNormal(**given) for name, given in self.priors.model_dump().items()})
        return layout_of(model, priors, bands)

    def variant(self, name: str, variant: str) -> Measured:
        """One of the models to compare.

        Raises:
            KeyError: it is not among them.
        """
        for model in self.candidates:
            if (model.material.name, model.variant) == (name, variant):
                return model
        raise KeyError(f"{name} {variant} is none of {', '.join(map(str, self.candidates))}")


def _changed(effects: EffectsSection) -> list[str]:
    """Keys that are not as they are by default."""
    return [key for key in EffectsSection.model_fields if getattr(effects, key) != getattr(EffectsSection(), key)]


def _numbers(material: Reflectance) -> int:
    """How many numbers its parameters are, of three channels."""
    return sum(3 if q.per_channel else 1 for q in material.parameters)


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
    data = _copied(path) if isinstance(path, Mapping) else {} if path is None else _read(Path(path))
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
    return parse(data, "command line" if path is None else "settings" if isinstance(path, Mapping) else str(path))


def _copied(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: dict(value) if isinstance(value, Mapping) else value for key, value in data.items()}


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # some editors put a byte order mark first
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path}: its lists or tables lie in each other too deeply for settings") from None


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
        if first["type"] == "value_error":  # raised here, complete
            said = first["msg"].removeprefix("Value error, ")
            raise ConfigError(f"{where}: {said}" if not key else f"{where}: {key}: {said}") from None
        if first["type"] == "extra_forbidden":
            if key in MOVED:
                raise ConfigError(f"{where}: {key!r} is called {MOVED[key]!r} now") from None
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
