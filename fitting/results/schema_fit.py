"""How a fit ended: what was compared, what was chosen, the errors, and what was asked of it."""

from typing import Literal

from ..settings.choice import Choice
from .strict import Many, Strict


class Candidate(Strict):
    """One model, or variant of a model, that was compared on the coarse grid."""

    model: str
    """Name of the model."""
    variant: str
    """Variant in short words: interface and body of a two-scale model, ``complex none`` (a metal) or ``real lambert``;
    the model's name where it has no variants."""
    cost: float | None
    """Cost on the coarse grid, as in `fit.cost`."""
    objective: float | None = None
    """Cost with the prior."""
    cube_root: float | None = None
    """Error of cube roots on the coarse grid."""
    picture: float | None = None
    """Mean CIELAB distance of spheres on the coarse grid, by which `auto` chooses among richer models."""
    highlight: float | None = None
    """Fitted over measured highlight on the coarse grid, there as well."""
    score: float | None = None
    """What the choice of interface and body goes by, lower is better; of kinds that are about as good the simplest is
    taken, and richer models are chosen by their pictures (``fitting/fit/selection.py``)."""
    of_matter: bool = True
    """False of constants that no matter has, such as those of a metal over a bright body: it is taken only if it is far
    better than all others."""
    converged: bool = True
    """False of a kind that was too far behind to be followed to the end, or was still creeping on the coarse grid."""


class Fit(Strict):
    """How the fit ended."""

    status: Literal["CONVERGED", "AT_BOUND", "STEP_LIMIT", "UNEXPLAINED", "NON_FINITE", "NO_DATA", "EDITED"]
    """How it ended, as a word for programs; EDITED where the values are no fit's (`edited_from`)."""
    message: str
    """The same in a sentence, with what is wrong with the file."""
    succeeded: bool
    """Whether its parameters may be used: it converged, at a bound or not, or stopped at the step limit."""
    cost: float | None
    """HP17 Eq. 56, relative to the measurement's weighted energy."""
    cost_per_channel: Many[float] | None
    """The cost by channel."""
    folding_scatter: float | None
    """Part of the cost by which bins at phi_d and pi - phi_d differ, which should be equal; no model can lower it."""
    steps: int
    """Steps on the last grid."""
    relative_offset: float | None
    """How far from the minimum the fit stopped, as Bates and Watts measure it."""
    bins: int
    """Bins with a weight."""
    effective_bins: float | None = None
    """How many independent residuals those of the fit count as (docs/statistics.md)."""
    candidates: Many[Candidate]
    """Models and their variants that were compared."""
    weights: float | Literal["log"] | None = None
    """Exponent of the compressive weight that the fit was made with, or ``log``."""
    model_error: float | None = None
    """Standard deviation (1/sr) that the model is taken to err by, where the weight is 1, beside the uncertainties that
    the file states: found with the fit (docs/statistics.md); null where it states none."""
    cautions: Many[str] = []  # noqa: RUF012 - pydantic copies it
    """What a user of the parameters should know, in words."""


class Metrics(Strict):
    """Errors over all valid bins with light and viewer at theta < ``fit.theta_max``, of a prediction with the loss."""

    rmse: float | None
    """Root of the mean squared error (1/sr)."""
    smape: float | None
    """Symmetric mean absolute percentage error, as a share."""
    cube_root: float | None = None
    """RMS difference of the cube roots of BRDF times cos_i."""
    log: float | None = None
    """RMS difference of log(1 + BRDF cos_i)."""
    highlight: float | None = None
    """Fitted over measured peak."""
    picture: float | None = None
    """Mean CIELAB distance of rendered spheres over all pixels, black ones too, under a lamp and an environment alike;
    weights and models are chosen by it."""
    lamp: float | None = None
    """Mean CIELAB distance of the spheres' lit pixels under a lamp, highlights as they are."""
    environment: float | None = None
    """The same under an environment."""


class Tried(Strict):
    """Settings that a fit was taken to, and what was estimated there."""

    settings: Choice
    """The settings."""
    estimated: float | None
    """Error there, as in `accuracy.estimated`."""
    floor: bool = False
    """As in `accuracy.floor`."""


class Accuracy(Strict):
    """What ``--accuracy`` or ``--time`` asked for, what was chosen, and what came of it.

    Errors are distances from the prediction of the reference fit, over all bins, relative to the measurement, with the
    weights of Eq. 56. `config` is what the fit began with; it was carried on through the settings ``tried``.
    """

    asked: float | None
    """Error that was asked for; null if a time was."""
    asked_seconds: float | None
    """Seconds that were asked for; null if an error was."""
    calibration: str
    """Which calibration the settings were chosen by, in words; scattered directions have none."""
    expected: float | None
    """What 95 % of the calibration's fits with the first settings keep to; null for effects, limits of steps or
    directions that were not calibrated."""
    expected_seconds: float | None
    """The same of the seconds."""
    tried: Many[Tried]
    """Settings that the fit was taken to, one after the other."""
    settings: Choice
    """Those of the result."""
    estimated: float | None
    """Error of the result; null where there was no time to estimate it."""
    floor: bool = False
    """True where ``estimated`` is what 95 % of the calibration's fits with these settings keep to, because the estimate
    of this fit alone was lower."""
    met: bool | None
    """Whether the error that was asked for is kept to; null for a time."""
