"""Settings of a fit that trade accuracy for time, and those combinations of them that are worth having."""

from dataclasses import asdict, dataclass, replace
from typing import Literal

from ...model.effects import Diffraction
from ..support.choices import Precision
from .config import Config

FITTED = {"grid", "azimuths", "precision", "starts"}  # those of [fit]


@dataclass(frozen=True)
class Choice:
    """Settings of a fit that trade accuracy for time; as in ``[effects]`` and ``[fit]`` of the configuration.

    Attributes:
        diffraction: tier of the diffraction lobe.
        order: radial nodes of its quadrature.
        grid: rows of theta_h and theta_d that the last steps use.
        azimuths: nodes in which a row of azimuths is gathered.
        precision: of the model.
        starts: starting points that go the second round of the search on the coarse grid.
    """

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
        fit = replace(config.fit, **{key: getattr(self, key) for key in FITTED})
        if config.effects.diffraction != "quadrature":
            return replace(config, fit=fit)
        effects = replace(config.effects, diffraction=self.diffraction, order=self.order)
        return replace(config, effects=effects, fit=fit)

    def finest(self) -> "Choice":
        """The reference as it is reached from here: its last steps, but no other start."""
        return replace(REFERENCE, starts=self.starts)


def choice_of(config: Config) -> Choice:
    """What a configuration has chosen."""
    effects, fit = config.effects, asdict(config.fit)
    return Choice(effects.diffraction, effects.order, **{key: fit[key] for key in FITTED})


def default_choice() -> Choice:
    """What a fit takes that was asked for neither accuracy nor time."""
    return choice_of(Config())


POINTS = (
    Choice("lobe", 32, "coarse", 4, "float32", 1),
    Choice("quadrature", 16, "coarse", 4, "float32", 1),
    Choice("quadrature", 16, "coarse", 4, "float64", 8),
    Choice("quadrature", 16, "medium", 8, "float32", 1),
    Choice("quadrature", 16, "medium", 8, "float64", 4),
    Choice("quadrature", 16, "medium", 8, "float64", 8),
    Choice("quadrature", 16, "fine", 8, "float32", 1),
    Choice("quadrature", 32, "fine", 8, "float32", 4),
    Choice("quadrature", 32, "fine", 8, "float64", 1),
    Choice("quadrature", 32, "fine", 8, "float64", 4),
    Choice("quadrature", 32, "fine", 8, "float64", 8),
    Choice("quadrature", 64, "fine", 16, "float64", 8),
)
"""Worth having, coarsest last steps first. What a fit's coarse stage takes, starts apart, is no choice
(``run.COARSE``)."""
REFERENCE = POINTS[-1]
"""The finest; the reference of a calibration is where it comes to if its last steps are taken once more
(`accuracy.resume_fit`)."""
