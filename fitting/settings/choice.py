"""Settings of a fit that trade accuracy for time, and those combinations of them that are worth having."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from ...model.effects import Diffraction
from ..support.choices import Precision
from .config import Config

FITTED = {"grid", "azimuths", "precision", "starts"}  # those of [fit]


class Choice(BaseModel):
    """Settings of a fit that trade accuracy for time; as in ``[effects]`` and ``[fit]`` of the configuration.

    Attributes:
        diffraction: tier of the diffraction lobe.
        order: radial nodes of its quadrature.
        grid: rows of theta_h and theta_d that the last steps use.
        azimuths: nodes in which a row of azimuths is gathered.
        precision: of the model.
        starts: starting points that go the second round of the search on the coarse grid.
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
        effects, fit = self.model_dump(exclude=FITTED), self.model_dump(include=FITTED)
        if config.effects.diffraction != "quadrature":
            effects = {}
        parts = {"effects": config.effects.model_copy(update=effects), "fit": config.fit.model_copy(update=fit)}
        return config.model_copy(update=parts)

    def finest(self) -> "Choice":
        """The reference as it is reached from here: its last steps, but no other start."""
        return REFERENCE.model_copy(update={"starts": self.starts})


def choice_of(config: Config) -> Choice:
    """What a configuration has chosen."""
    effects = config.effects
    return Choice(diffraction=effects.diffraction, order=effects.order, **config.fit.model_dump(include=FITTED))


def default_choice() -> Choice:
    """What a fit takes that was asked for neither accuracy nor time."""
    return choice_of(Config())


def _choice(*values: Any) -> Choice:  # noqa: ANN401 - of its fields
    return Choice(**dict(zip(Choice.model_fields, values, strict=True)))


POINTS = (
    _choice("lobe", 32, "coarse", 4, "float32", 1),
    _choice("quadrature", 16, "coarse", 4, "float32", 1),
    _choice("quadrature", 16, "coarse", 4, "float64", 8),
    _choice("quadrature", 16, "medium", 8, "float32", 1),
    _choice("quadrature", 16, "medium", 8, "float64", 4),
    _choice("quadrature", 16, "medium", 8, "float64", 8),
    _choice("quadrature", 16, "fine", 8, "float32", 1),
    _choice("quadrature", 32, "fine", 8, "float32", 4),
    _choice("quadrature", 32, "fine", 8, "float64", 1),
    _choice("quadrature", 32, "fine", 8, "float64", 4),
    _choice("quadrature", 32, "fine", 8, "float64", 8),
    _choice("quadrature", 64, "fine", 16, "float64", 8),
)
"""Worth having, coarsest last steps first. What a fit's coarse stage takes, starts apart, is no choice
(``run.COARSE``)."""
REFERENCE = POINTS[-1]
"""The finest; the reference of a calibration is where it comes to if its last steps are taken once more
(`accuracy.resume_fit`)."""
