"""The sections of a run's settings: what each key may be, its default, and what it is for.

What the program has already (`Effects`, `Apparatus`, `Priors`, `Constraint`) is a section as it is.
"""

import importlib.util
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ...merl_io.azimuth import AZIMUTHS
from ...merl_io.binary import Dims, dims_of
from ...merl_io.scattered import Quantity
from ...model.apparatus import GrazingLoss
from ...model.effects import PRESETS, TWO_SCALE, Effects, idle
from ..support.choices import THETA_MAX, Backend, Precision, Weights

if TYPE_CHECKING:
    from ...model.reflectance import Reflectance

AUTO = "auto"  # in place of a model's name: the two-scale model, and sums over it


def _usable(backend: Any) -> Any:  # noqa: ANN401 - whatever stands there
    if backend == "optimistix":  # of results from before the trust region had no need of it
        return "trust-region"
    if backend == "jaxopt" and importlib.util.find_spec(backend) is None:
        raise ValueError(f"{backend} is not installed (pip install 'merlfit[crosscheck]')")
    return backend


@dataclass(frozen=True)
class InputSection:
    """[input]: what files may hold.

    Attributes:
        dims: numbers of bins of theta_h, theta_d and phi_d, as in "45x45x90", that MERL-like files may have beside
            MERL's own 90x90x180; empty for no others.
        origin: what files that are not genuine MERL are, in words, such as "neural reconstructions"; results, pictures
            and pages repeat it.
        quantity: what the values of a table are: ``brdf`` (1/sr), ``brdf_cos`` (times cos theta_o), or
            ``reflectance_factor`` (times pi).
    """

    dims: str = ""
    origin: Annotated[str, Field(max_length=200)] = ""
    quantity: Quantity = "brdf"

    def __post_init__(self) -> None:
        """Refuse numbers of bins that are none."""
        _ = self.allowed

    @property
    def allowed(self) -> Dims | None:
        """As numbers."""
        return dims_of(self.dims) if self.dims else None


@dataclass(frozen=True)
class ModelSection:
    """[model]: which reflectance models are fitted.

    Attributes:
        name: of one of ``merlfit models`` or a sum of them, or a list of several, which are compared; ``auto``: the
            two-scale model, and sums over it where these describe a file much better.
        settings: of the model, the other keys of the section; those of the two-scale model are in [effects].
    """

    name: str | list[str] = TWO_SCALE
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse models and settings that there are not."""
        if not self.names or len(set(self.names)) < len(self.names):
            raise ValueError(f"name {self.name!r} should be one model, or several different ones")
        for key in self.settings:
            if len(self.names) > 1:
                raise ValueError(f"{key} is a setting of one model, and several are compared")
            if self.names == [TWO_SCALE]:
                raise ValueError(
                    f"{key!r} is none of its keys: it has 'name', and settings of the two-scale model belong in "
                    "[effects]"
                )
        if AUTO in self.names:
            raise ValueError(f"{AUTO!r} compares models by itself: it is named alone")
        if "base" in self.settings and self.names[0].count("+") == 1 and self.with_two_scale:
            raise ValueError(f"base: settings of the two-scale model below {self.names[0]} belong in [effects]")
        _ = self.rivals

    @property
    def names(self) -> list[str]:
        """As a list, of those that are compared from the beginning."""
        if self.name == AUTO:
            return [TWO_SCALE]
        return [self.name] if isinstance(self.name, str) else self.name

    @property
    def with_two_scale(self) -> bool:
        """Whether the two-scale model is among them, or a sum over it."""
        return any(name.split("+")[-1] == TWO_SCALE for name in self.names)

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

        return [made(name, self.settings) for name in names]


def model_section(data: Any) -> Any:  # noqa: ANN401 - whatever stands there
    """Keys of [model] as `ModelSection` has them; a list of one model is that one."""
    if not isinstance(data, Mapping):
        return data
    settings = dict(data)
    name = settings.pop("name", TWO_SCALE)
    return {"name": name[0] if isinstance(name, list) and len(name) == 1 else name, "settings": settings}


@dataclass(frozen=True)
class EffectsSection(Effects):
    """[effects]: which effects are simulated, as :class:`merlfit.model.effects.Effects` describes them.

    Attributes:
        preset: effects by name (``merlfit.model.effects.PRESETS``); keys given beside it replace its own.
        index, body: ``auto`` compares those of ``model.effects.KINDS`` that agree with what is given here.
    """

    preset: Literal["hp17", "conserving", "free", "microfacet", "preview", "fast"] = "hp17"
    index: Literal["auto", "complex", "real", "film"] = "auto"  # pyright: ignore[reportIncompatibleVariableOverride]
    body: Literal["auto", "none", "lambert", "plastic", "subsurface"] = "auto"  # pyright: ignore[reportIncompatibleVariableOverride]


def effects_section(data: Any) -> Any:  # noqa: ANN401 - whatever stands there
    """Keys of [effects] beside those of its preset that have an effect; what is wrong is left for who looks at each."""
    name = data.get("preset", "hp17") if isinstance(data, Mapping) else None
    if not isinstance(name, str) or name not in PRESETS:
        return data
    preset = asdict(PRESETS[name])
    tier = data.get("diffraction", preset["diffraction"])
    if tier == "exact":
        raise ValueError("exact is a reference that takes hours on MERL's grid: fit with quadrature")
    dropped = ("index", "body", *idle(tier, preset["split"]))
    return {**{key: x for key, x in preset.items() if key not in dropped}, **data}


@dataclass(frozen=True)
class AcquisitionSection:
    """[acquisition]: what the apparatus does to a material (:class:`merlfit.model.measured.Measured`).

    Attributes:
        grazing_loss: ``auto`` is ``free`` on files like MERL's and ``off`` on scattered directions, which another
            apparatus measured.
    """

    grazing_loss: Literal["auto"] | GrazingLoss | Annotated[float, Field(ge=0, le=1)] = "auto"


def parameter_section(data: Any) -> Any:  # noqa: ANN401 - whatever stands there
    """Keys of [parameters.NAME] as `Constraint` has them: one fixed value is a tuple of one."""
    if not isinstance(data, Mapping) or (fixed := data.get("fixed")) is None:
        return data
    if unused := [key for key, x in data.items() if key != "fixed" and x not in (None, False)]:
        raise ValueError(f"{', '.join(unused)} would have no effect on what is fixed: leave it out")
    return {**data, "fixed": tuple(fixed) if isinstance(fixed, list) else (fixed,)}


@dataclass(frozen=True)
class FitSection:
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
        backend: solver; others than our trust region are for cross-checks.
    """

    starts: Annotated[int, Field(ge=1, le=32)] = 8
    coarse_steps: Annotated[int, Field(ge=1)] = 80
    max_steps: Annotated[int, Field(ge=1)] = 200
    weights: Weights = "compressive"
    theta_max: Annotated[float, Field(ge=0.5, le=1.571)] = THETA_MAX
    grid: Literal["fine", "medium", "coarse"] = "fine"
    azimuths: Annotated[int, Field(ge=2, le=90)] = AZIMUTHS
    precision: Precision = "float64"
    backend: Annotated[Backend, BeforeValidator(_usable)] = "trust-region"


AFFORDABLE = 40  # free numbers: a chain of as many takes half an hour, of those of thirty wavelengths a day


@dataclass(frozen=True)
class PosteriorSection:
    """[posterior]: the sampler.

    Attributes:
        enabled: whether to sample at all; ``auto`` is yes of no more than `AFFORDABLE` free numbers,
            whatever the file, and no in Python.
        max_steps: at the most, after those of tuning; sampling stops when the chain is good enough.
    """

    enabled: bool | Literal["auto"] = "auto"
    max_steps: Annotated[int, Field(ge=10)] = 6000

    def samples(self, free: int) -> bool:
        """Whether the posterior of so many free numbers is sampled."""
        return free <= AFFORDABLE if self.enabled == "auto" else self.enabled
