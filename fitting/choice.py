"""Settings of a fit that trade accuracy for time, and those combinations of them that are worth having."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from .config import Config
from .problem import Precision


class Choice(BaseModel):
    """Settings of a fit that trade accuracy for time; as in ``[effects]`` and ``[fit]`` of the configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    diffraction: Literal["lobe", "quadrature"]
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
        last = {key: ours[key] for key in ("grid", "azimuths", "precision", "starts")}
        effects = config.effects.model_copy(update={key: ours[key] for key in keys})
        return config.model_copy(update={"effects": effects, "fit": config.fit.model_copy(update=last)})

    def continued(self, choice: "Choice") -> "Choice":
        """A finer choice as it is reached from here: its last steps, but no other start."""
        return choice.model_copy(update={"starts": self.starts})


def _choice(tier: str, grid: str, azimuths: int, precision: str, starts: int) -> Choice:
    diffraction, _, order = tier.partition(" ")
    given: dict[str, Any] = {"grid": grid, "azimuths": azimuths, "precision": precision, "starts": starts}
    return Choice(diffraction=diffraction, order=int(order or Config().effects.order), **given)  # type: ignore[arg-type]


POINTS = (
    _choice("lobe", "coarse", 4, "float32", 1),
    _choice("quadrature 16", "coarse", 4, "float32", 1),
    _choice("quadrature 16", "coarse", 4, "float64", 4),
    _choice("quadrature 16", "medium", 8, "float32", 1),
    _choice("quadrature 16", "medium", 8, "float64", 4),
    _choice("quadrature 16", "fine", 8, "float32", 1),
    _choice("quadrature 32", "medium", 8, "float64", 4),
    _choice("quadrature 32", "fine", 8, "float32", 4),
    _choice("quadrature 32", "fine", 8, "float64", 1),
    _choice("quadrature 32", "fine", 8, "float64", 4),
    _choice("quadrature 32", "fine", 8, "float64", 8),
    _choice("quadrature 64", "fine", 16, "float64", 8),
)
"""Worth having, coarsest last steps first.

Not among them: the tier `scaled`, which saves no time where the quadrature's tables are made once for all blocks, errs
like `lobe`, and takes minutes to compile for all bodies."""
REFERENCE = POINTS[-1]
"""The finest; as the reference of a calibration its last steps are taken twice (`accuracy.carry_on`)."""


def default_choice() -> Choice:
    """What a fit takes that was asked for neither accuracy nor time."""
    config = Config()
    return Choice(
        diffraction="quadrature", order=config.effects.order,
        **config.fit.model_dump(include={"grid", "azimuths", "precision", "starts"}),
    )  # fmt: skip
