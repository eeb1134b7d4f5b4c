"""The sections of a run's settings: what each key may be, its default, and what it is for."""

import importlib.util
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from ...merl_io.azimuth import AZIMUTHS
from ...merl_io.binary import Dims, dims_of
from ...model.apparatus import Apparatus, GrazingLoss
from ...model.effects import PRESETS, TWO_SCALE, Colour, Diffraction, Effects, Fresnel, Masking, Split, refuse_gone
from ...model.priors import PRIORS, Constraint, LogNormal
from ..support.choices import THETA_MAX, Backend, Precision, Weights

if TYPE_CHECKING:
    from ...model.reflectance import Reflectance


class Section(BaseModel):
    """A section refuses unknown keys, and values that it would have to convert."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class InputSection(Section):
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


class ModelSection(Section):
    """[model]: which reflectance models are fitted.

    Attributes:
        name: of one of ``merlfit models``, or a list of several, which are compared. Other keys are settings of the
            model; those of the two-scale model are in [effects].
    """

    model_config = ConfigDict(extra="allow")
    name: str | list[str] = TWO_SCALE

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
        if self.model_extra and self.names == [TWO_SCALE]:
            raise ValueError(
                f"{next(iter(self.model_extra))!r} is none of its keys: it has 'name', and settings of the two-scale "
                "model belong in [effects]"
            )
        _ = self.rivals
        return self

    @property
    def rivals(self) -> "list[Reflectance]":
        """Models beside the two-scale one, with their settings. They compute with jax: read only where one is named.

        Raises:
            ValueError: there is no such model, or setting, or value of it.
        """
        names = [name for name in self.names if name != TWO_SCALE]
        if not names:
            return []
        from ...model.registry import made

        return [made(name, self.model_extra or {}) for name in names]


class EffectsSection(Section):
    """[effects]: which effects are simulated, as :class:`merlfit.model.effects.Effects` describes them.

    Attributes:
        preset: effects by name (``merlfit.model.effects.PRESETS``); keys given beside it replace its own.
        index, body: ``auto`` compares those of ``model.effects.KINDS`` that agree with what is given here.
    """

    preset: Literal["hp17", "conserving", "microfacet", "preview", "fast"] = "hp17"
    index: Literal["auto", "complex", "real"] = "auto"
    body: Literal["auto", "none", "lambert", "plastic", "subsurface"] = "auto"
    diffraction: Diffraction = Effects.diffraction
    order: Annotated[int, Field(ge=6, le=256)] = Effects.order
    fresnel: Fresnel = Effects.fresnel
    masking: Masking = Effects.masking
    renormalised: bool = Effects.renormalised
    split: Split = Effects.split
    colour: Colour = Effects.colour

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, data: object) -> object:
        if isinstance(data, dict):
            refuse_gone(data)
        name = data.get("preset", "hp17") if isinstance(data, dict) else None
        if not isinstance(data, dict) or not isinstance(name, str) or name not in PRESETS:
            return data  # which the fields will complain about
        preset = asdict(PRESETS[name])
        if "exact" in (preset["diffraction"], data.get("diffraction")):
            raise ValueError("exact is a reference that takes hours on MERL's grid: fit with quadrature")
        return {**{k: v for k, v in preset.items() if k not in ("index", "body")}, **data}


class AcquisitionSection(Section):
    """[acquisition]: what the apparatus does to a material (:class:`merlfit.model.measured.Measured`).

    Attributes:
        grazing_loss: ``auto`` is ``free`` on files like MERL's and ``off`` on scattered directions, which another
            apparatus measured.
    """

    grazing_loss: Literal["auto"] | GrazingLoss | Annotated[float, Field(ge=0, le=1)] = "auto"


class ApparatusSection(Section):
    """[apparatus]: what a ``derived`` grazing loss assumes (:class:`merlfit.model.apparatus.Apparatus`)."""

    sphere_radius_px: Annotated[float, Field(gt=0)] = Apparatus.sphere_radius_px
    pixel_sigma_px: Annotated[float, Field(gt=0)] = Apparatus.pixel_sigma_px
    lamp_sigma_rad: Annotated[float, Field(ge=0)] = Apparatus.lamp_sigma_rad
    camera_nearness: Annotated[float, Field(ge=0, lt=1)] = Apparatus.camera_nearness
    lamp_nearness: Annotated[float, Field(ge=0)] = Apparatus.lamp_nearness


class LogNormalSection(Section):
    """A log-normal prior: median, and the factor of one standard deviation up or down."""

    median: Annotated[float, Field(gt=0)]
    factor: Annotated[float, Field(ge=1.1)]


def _prior(name: str) -> LogNormalSection:
    return LogNormalSection(**asdict(getattr(PRIORS, name)))


class PriorsSection(Section):
    """[priors]: what is known of the parameters beforehand (:class:`merlfit.model.priors.Priors`)."""

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


class ParameterSection(Section):
    """[parameters.NAME]: what is known, or wanted, of one parameter of the models to fit.

    Of a model only variants that have the parameter are fitted: a fixed ``eta`` leaves dielectrics. `merlfit models`
    lists the names.

    Attributes:
        fixed: its value, or a list with one for each channel; it is not fitted then.
        lower, upper: bounds, within those of the model. start: where the first fit starts.
        prior: log-normal one of the parameter itself (of eta and c less 1) instead of that in [priors].
        tied: one value for all channels.
    """

    fixed: float | list[float] | None = None
    lower: float | None = None
    upper: float | None = None
    start: float | None = None
    prior: LogNormalSection | None = None
    tied: bool = False

    @field_validator("fixed", mode="before")
    @classmethod
    def _listed(cls, fixed: object) -> object:
        """Several values may come as a tuple."""
        return list(fixed) if isinstance(fixed, tuple) else fixed

    @model_validator(mode="after")
    def _refuse_idle(self) -> "ParameterSection":
        idle = [key for key, field in type(self).model_fields.items() if getattr(self, key) != field.default]
        if self.fixed is not None and (idle := [key for key in idle if key != "fixed"]):
            raise ValueError(f"{', '.join(idle)} would have no effect on what is fixed: leave it out")
        return self

    @property
    def constraint(self) -> Constraint:
        """The same as a layout takes it."""
        fixed = self.fixed if self.fixed is None or isinstance(self.fixed, list) else [self.fixed]
        prior = None if self.prior is None else LogNormal(**self.prior.model_dump())
        return Constraint(None if fixed is None else tuple(fixed), self.lower, self.upper, self.start, prior, self.tied)


class FitSection(Section):
    """[fit]: the solver, and what accuracy it works with.

    Attributes:
        starts: starting points of the second round of the search on the coarse grid; the first has three times as many.
        coarse_steps, max_steps: evaluations at the most, a start on the coarse grid and on the last one.
        weights: of the bins: ``compressive`` (HP17 Eq. 57-58), ``log``, ``none``, or ``adaptive``, which tries several
            exponents of the compressive weight and keeps the nearest picture (``choices.WEIGHT_SCHEDULES``).
        theta_max: light or viewer past this angle (rad) are left out, of the objective and of all errors.
        grid: rows of theta_h and theta_d that the last steps use (``run.GRIDS``): all of them, a seventh, a 21st.
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


class PosteriorSection(Section):
    """[posterior]: the sampler.

    Attributes:
        enabled: whether to sample at all. max_steps: at the most, after those of tuning; sampling stops when
            the chain is good enough.
    """

    enabled: bool = True
    max_steps: Annotated[int, Field(ge=10)] = 6000
