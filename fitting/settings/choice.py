"""Settings of a fit that trade accuracy for time, and those combinations of them that are worth having."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from ...model.effects import Diffraction
from ..support.choices import Precision
from .config import Config


class Choice(BaseModel):
    """Settings of a fit that trade accuracy for time; as in ``[effects]`` and ``[fit]`` of the configuration.

    Attributes:
        diffraction: tier of the diffraction lobe.
        order: radial nodes of its quadrature.
        grid: rows of theta_h and theta_d that the last steps use.
        azimuths: nodes in which a row of azimuths is gathered.
        precision: of the model.
        starts: starting points that run the second lap of the race on the coarse grid.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    diffraction: Diffraction
    order: int
    grid: Literal["fine", "medium", "coarse"]
    azimuths: int
    precision: Precision
    starts: int

    def __str__(self) -> str:
        tier = f"{self.diffraction} {self.order}" if self.diffraction == "quadrature" else self.diffraction
        starts = "1 start" if self.starts == 1 else f"{self.starts} starts"
        return f"{tier}, {self.grid} grid, {self.azimuths} azimuths, {self.precision}, {starts}"

    def settings(self, config: Config) -> Config:
        """The configuration with these settings; a tier of diffraction other than quadrature stays as it was asked."""
        ours = self.model_dump()
        keys = ("diffraction", "order") if config.effects.diffraction == "quadrature" else ()
        last = {key: ours[key] for key in FITTED}
        effects = config.effects.model_copy(update={key: ours[key] for key in keys})
        return config.model_copy(update={"effects": effects, "fit": config.fit.model_copy(update=last)})

    def continued(self, choice: "Choice") -> "Choice":
        """A finer choice as it is reached from here: its last steps, but no other start."""
        return choice.model_copy(update={"starts": self.starts})

    def applied(self, config: Config) -> "Choice":
        """What it comes to in a configuration that may have asked for another tier."""
        return choice_of(self.settings(config))

    def refines(self, other: "Choice") -> bool:
        """Whether it is coarser in nothing, starts apart."""
        mine, theirs = (
            [*(known.index(getattr(q, key)) for key, known in FINENESS.items()), q.order, q.azimuths]
            for q in (self, other)
        )
        return all(a >= b for a, b in zip(mine, theirs, strict=True))


FINENESS = {
    "diffraction": ("lobe", "quadrature"), "grid": ("coarse", "medium", "fine"), "precision": ("float32", "float64"),
}  # fmt: skip
FITTED = {"grid", "azimuths", "precision", "starts"}  # those of [fit]


def choice_of(config: Config) -> Choice:
    """What a configuration has chosen."""
    effects = config.effects
    return Choice(diffraction=effects.diffraction, order=effects.order, **config.fit.model_dump(include=FITTED))


def _choice(tier: str, grid: str, azimuths: int, precision: Precision, starts: int) -> Choice:
    diffraction, _, order = tier.partition(" ")
    given: dict[str, Any] = {"diffraction": diffraction, "order": int(order or Config().effects.order), "grid": grid}
    return Choice(**given, azimuths=azimuths, precision=precision, starts=starts)


POINTS = (
    _choice("lobe", "coarse", 4, "float32", 1),
    _choice("quadrature 16", "coarse", 4, "float32", 1),
    _choice("quadrature 16", "coarse", 4, "float64", 8),
    _choice("quadrature 16", "medium", 8, "float32", 1),
    _choice("quadrature 16", "medium", 8, "float64", 4),
    _choice("quadrature 16", "medium", 8, "float64", 8),
    _choice("quadrature 16", "fine", 8, "float32", 1),
    _choice("quadrature 32", "fine", 8, "float32", 4),
    _choice("quadrature 32", "fine", 8, "float64", 1),
    _choice("quadrature 32", "fine", 8, "float64", 4),
    _choice("quadrature 32", "fine", 8, "float64", 8),
    _choice("quadrature 64", "fine", 16, "float64", 8),
)
"""Worth having, coarsest last steps first.

What a fit's coarse stage takes, starts apart, is no choice (``run.COARSE``)."""
REFERENCE = POINTS[-1]
"""The finest; the reference of a calibration is where it comes to if its last steps are taken once more
(`accuracy.resume_fit`)."""


def default_choice() -> Choice:
    """What a fit takes that was asked for neither accuracy nor time."""
    return choice_of(Config())
