"""The parameters of the two-scale model, declared once: symbol, meaning, unit, default, bounds, prior.

Fitting, posterior, JSON, tables and plots all read this list. Prior: uniform in the parameter's own ``scale`` between
its bounds, which are those of plausible matter seen in visible light.
"""

from dataclasses import dataclass
from typing import Literal

from .effects import Effects
from .numerics import Real

CHANNELS = ("R", "G", "B")
WAVELENGTHS_UM = (0.645, 0.526, 0.444)  # HP17 Section 5: one wavelength stands for each MERL channel


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Attributes:
        name: key in JSON and in parameter dictionaries. symbol: as in the papers (TeX). meaning: in words.
        unit: "um", "1" (dimensionless) ... default: a typical value. lower, upper: physical bounds.
        scale: ``log`` or ``linear``: the coordinate in which the prior is uniform.
        offset: subtracted before the logarithm (c - 1, eta - 1).
        per_channel: one value per colour channel.
        source: where the parameter is defined.
    """

    name: str
    symbol: str
    meaning: str
    unit: str
    default: float
    lower: float
    upper: float
    scale: Literal["log", "linear"] = "log"
    offset: float = 0.0
    per_channel: bool = False
    source: str = "HP17"

    @property
    def prior(self) -> str:
        """The prior in words."""
        if self.scale == "linear":
            return f"uniform in [{self.lower:g}, {self.upper:g}]"
        shifted = f"{self.name} - {self.offset:g}" if self.offset else self.name
        return f"{shifted} log-uniform, {self.name} in [{self.lower:g}, {self.upper:g}]"

    def between(self, u: Real) -> Real:
        """Value at the position u in [0, 1] between the bounds, in the parameter's own scale."""
        if self.scale == "linear":
            return self.lower + (self.upper - self.lower) * u
        lower, upper = self.lower - self.offset, self.upper - self.offset
        return self.offset + lower * (upper / lower) ** u


SURFACE = (
    Parameter("beta", r"\beta", "width of the distribution of microfacet normals", "1", 0.1, 1e-3, 1.0,
              source="HP17 Eq. 35"),
    Parameter("p", "p", "kurtosis exponent of the distribution of microfacet normals", "1", 0.8, 0.2, 5.0,
              source="HP17 Eq. 35"),
)  # fmt: skip
DIFFRACTION = (
    Parameter("b", "b", "correlation length of the nano-geometry", "um", 3.0, 0.05, 200.0, source="HP17 Eq. 14"),
    Parameter("c", "c", "falloff exponent of the nano-geometry's spectrum", "1", 2.0, 1.01, 6.0, offset=1.0,
              source="HP17 Eq. 14"),
    Parameter("sigma_s", r"\sigma_s", "standard deviation of the nano-geometry's height", "um", 0.03, 1e-4, 0.5,
              source="HP17 Eq. 18"),
)  # fmt: skip
CONDUCTOR = (
    Parameter("n", "n", "real part of the index of refraction", "1", 1.0, 0.02, 10.0, per_channel=True,
              source="HP17 Eq. 3"),
    Parameter("k", "k", "imaginary part of the index of refraction", "1", 3.0, 1e-3, 15.0, per_channel=True,
              source="HP17 Eq. 3"),
)  # fmt: skip
INTERFACE = (
    Parameter("eta", r"\eta", "index of refraction of the interface", "1", 1.5, 1.001, 4.0, offset=1.0,
              per_channel=True, source="HP17 Eq. 3"),
)  # fmt: skip
ALBEDO = Parameter("albedo", r"\rho_d", "albedo of the body", "1", 0.3, 0.0, 1.0, "linear", per_channel=True,
                   source="HP17 Eq. 43, 44")  # fmt: skip
GRAZING = Parameter("grazing_exponent", "k_g", "exponent of the acquisition's loss at grazing angles", "1", 0.5, 0.0,
                    1.0, "linear", source="HP17 Eq. 60")  # fmt: skip


def parameters(effects: Effects) -> tuple[Parameter, ...]:
    """The parameters of these effects, shared ones first, per-channel ones last."""
    shared = SURFACE + (DIFFRACTION if effects.diffraction != "off" else ())
    colour = CONDUCTOR if effects.body == "none" else (*INTERFACE, ALBEDO)
    return shared + ((GRAZING,) if effects.acquisition == "free" else ()) + colour
