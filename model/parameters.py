"""The parameters of the two-scale model, declared once: symbol, meaning, unit, default, bounds, prior.

Fitting, posterior, JSON, tables and plots all read this list. Bounds are those of plausible matter seen in visible
light. Priors are weak: log-normal ones, cut at the bounds, say of what order a quantity is, and 95 % of them lie within
the square of their factor either way.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jax.typing import ArrayLike

from .ndf.epd import HALF
from .numerics import Numbers, Real, namespace_of
from .priors import LogNormal

WAVELENGTHS_UM = (0.645, 0.526, 0.444)  # HP17 Section 5: one wavelength stands for each MERL channel


@dataclass(frozen=True)
class Shift:
    """By how much the logarithm of a prior's median moves with the values of other parameters.

    Attributes:
        of: names of these parameters, none of which moves itself.
        moved: the shift, and its rate by each of their values; given the wavelength (um) of the middle channel first.
    """

    of: tuple[str, ...]
    moved: Callable[..., tuple[Numbers, ...]]


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Attributes:
        name: key in JSON and in parameter dictionaries. symbol: as in the papers (TeX). meaning: in words.
        unit: "um", "1" (dimensionless) ... default: a typical value. lower, upper: physical bounds.
        scale: ``log``, with a log-normal prior, or ``linear``, with a uniform one.
        offset: subtracted before the logarithm (c - 1, eta - 1).
        per_channel: one value per colour channel.
        quantity: field of :class:`merlfit.model.priors.Priors` with its prior, if that is not of its own name.
        source: where the parameter is defined.
        prior: log-normal one of the parameter itself, or of its odds, if it is none of
            :class:`merlfit.model.priors.Priors`.
        alike: whether it is nearly the same in all channels: then the prior in the middle one is its own, that in the
            others of the ratio to the middle one (``Priors.dispersion``).
        shift: by how much the logarithm of the prior's median moves.
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
    quantity: str | None = None
    prior: LogNormal | None = None
    alike: bool = False
    shift: Shift | None = None

    def between(self, u: Real) -> Real:
        """Value at the position u in [0, 1] between the bounds, in the parameter's own scale."""
        if self.scale == "linear":
            return self.lower + (self.upper - self.lower) * u
        lower, upper = self.lower - self.offset, self.upper - self.offset
        return self.offset + lower * (upper / lower) ** u

    def position(self, value: ArrayLike) -> np.ndarray:
        """Inverse of :meth:`between`."""
        value, lower, upper = (np.asarray(x) - self.offset for x in (value, self.lower, self.upper))
        if self.scale == "linear":
            return np.asarray((value - lower) / (upper - lower))
        return np.asarray(np.log(value / lower) / np.log(upper / lower))

    def slope(self, value: ArrayLike) -> np.ndarray:
        """d position/d value."""
        value, lower, upper = (np.asarray(x) - self.offset for x in (value, self.lower, self.upper))
        return np.asarray(1 / (upper - lower) if self.scale == "linear" else 1 / (value * np.log(upper / lower)))


def _to_beta(_: float, p: Numbers) -> tuple[Numbers, ...]:
    """From the half width, beta (ln 2)^(1/(2 p)), to beta."""
    return -HALF / p, HALF / p**2


def _to_sigma_s(middle_um: float, b: Numbers, c: Numbers) -> tuple[Numbers, ...]:
    """From the height that diffracts into directions that exist (HP17 Eq. 17), at normal incidence, to sigma_s.

    Their share is there s = 1 - (1 + (b/lambda)^2)^(-(c-1)/2) (:func:`.diffraction.renormalisation`).
    """
    xp = namespace_of(b)
    x = b / middle_um
    growth = xp.log1p(x**2)
    beyond = xp.exp(-(c - 1) / 2 * growth)
    share = -xp.expm1(-(c - 1) / 2 * growth)
    by_b, by_c = -(c - 1) / 2 * x / (1 + x**2) / middle_um, -growth / 4
    return -xp.log(share) / 2, by_b * beyond / share, by_c * beyond / share


SURFACE = (
    Parameter("beta", r"\beta", "width of the distribution of microfacet normals", "1", 0.1, 1e-3, 1.0,
              source="HP17 Eq. 35", quantity="half_width", shift=Shift(("p",), _to_beta)),
    Parameter("p", "p", "kurtosis exponent of the distribution of microfacet normals", "1", 0.8, 0.2, 5.0,
              source="HP17 Eq. 35"),
)  # fmt: skip
DIFFRACTION = (
    Parameter("b", "b", "correlation length of the nano-geometry", "um", 3.0, 0.05, 200.0, source="HP17 Eq. 14"),
    Parameter("c", "c", "falloff exponent of the nano-geometry's spectrum", "1", 2.0, 1.01, 6.0, offset=1.0,
              source="HP17 Eq. 14"),
    Parameter("sigma_s", r"\sigma_s", "standard deviation of the nano-geometry's height", "um", 0.03, 1e-4, 0.5,
              source="HP17 Eq. 18", quantity="sigma_rel", shift=Shift(("b", "c"), _to_sigma_s)),
)  # fmt: skip
WEIGHT = Parameter("weight", "w", "weight of the diffracted light", "1", 0.8, 0.0, 1.0, "linear", per_channel=True,
                   source="of the free split; 1 in HP17 Eq. 24")  # fmt: skip
CONDUCTOR = (
    Parameter("n", "n", "real part of the index of refraction", "1", 1.0, 0.02, 10.0, per_channel=True,
              source="HP17 Eq. 3"),
    Parameter("k", "k", "imaginary part of the index of refraction", "1", 3.0, 1e-3, 15.0, per_channel=True,
              source="HP17 Eq. 3"),
)  # fmt: skip
FILM = (
    Parameter("film_thickness", "d", "thickness of the film", "um", 0.3, 0.02, 1.0,
              source="Belcour & Barla 2017", prior=LogNormal(0.3, 1.8)),
    Parameter("film_eta", r"\eta_f", "index of refraction of the film", "1", 1.7, 1.01, 3.0, offset=1.0,
              source="Belcour & Barla 2017", prior=LogNormal(0.7, 1.5)),
)  # fmt: skip
INTERFACE = (
    Parameter("eta", r"\eta", "index of refraction of the interface", "1", 1.5, 1.001, 2.6, offset=1.0,
              per_channel=True, source="HP17 Eq. 3", alike=True),
)  # fmt: skip
ALBEDO = Parameter("albedo", r"\rho_d", "albedo of the body", "1", 0.3, 0.0, 1.0, "linear", per_channel=True,
                   source="HP17 Eq. 43, 44", quantity="odds")  # fmt: skip
TWO_SCALE = (*SURFACE, *DIFFRACTION, WEIGHT, *FILM, *CONDUCTOR, *INTERFACE, ALBEDO)
WHICH_BODY = "which_body"  # beside parameters, where a model leaves it open: the body's number in `effects.BODIES`
GRAZING = Parameter("grazing_exponent", "g", "exponent of the acquisition's loss of specular light at grazing angles",
                    "1", 0.5, 0.0, 1.0, "linear", source="HP17 Eq. 60")  # fmt: skip
GRAZING_DIFFRACTED = Parameter("grazing_exponent_diffracted", "g_d",
                               "exponent of the acquisition's loss of diffracted light at grazing angles",
                               "1", 0.3, 0.0, 1.0, "linear", source="HP17 Eq. 60")  # fmt: skip
LOSSES = {"specular": GRAZING, "diffracted": GRAZING_DIFFRACTED}
"""The apparatus's exponent of each sharp lobe that a model may have."""


SURFACES = {"coat": "coat", "2": "second surface", "3": "third surface"}
"""What lies above or beside the base of a sum (`sum`), by what names of its parameters end in."""


def exponent_of(lobe: str) -> Parameter:
    """The apparatus's exponent of a sharp lobe; ``specular_2`` is the specular lobe of a second model (`sum`).

    Raises:
        ValueError: no loss is known of a lobe of that name.
    """
    kind, _, which = lobe.partition("_")
    if kind not in LOSSES or (which and which not in SURFACES):
        raise ValueError(f"no loss is known of a lobe {lobe!r}: lobes are named {', '.join(LOSSES)}")
    return beside(LOSSES[kind], which) if which else LOSSES[kind]


def beside(parameter: Parameter, which: str) -> Parameter:
    """The same of another surface than a sum's base, a key of `SURFACES`."""
    name, meaning = f"{parameter.name}_{which}", f"{parameter.meaning} ({SURFACES[which]})"
    symbol = f"{parameter.symbol}^{{({which})}}" if which.isdigit() else f"{parameter.symbol}^{{\\mathrm{{{which}}}}}"
    return replace(parameter, name=name, symbol=symbol, meaning=meaning)
