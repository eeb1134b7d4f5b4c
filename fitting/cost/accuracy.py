"""How far a fit is from the reference fit, estimated where it ended, and on from there where that is too far.

With the reference's settings at the fit's own parameters z as a stepping stone,

    |f(z) - f_ref(z_ref)| <= |f(z) - f_ref(z)| + |f_ref(z) - f_ref(z_ref)|,

norms over all bins, relative to the measurement, with the weights of Eq. 56. The first one, what the tier of
diffraction errs by, is evaluated; the second is the length |J dz| of the Gauss-Newton step that the reference has still
to take from z. A sum of lengths is an upper bound as far as one step goes; of other minima it knows nothing. Those are
counted by the calibration: where more than one in twenty of its fits ended in another minimum, no estimate is below
what nineteen in twenty keep to (`frontier.Point.other_minimum`): then a floor is stated, and called so.
Of scattered directions, of which every file has others, nothing is calibrated. Their settings are found on the file's
own samples: from the cheapest last steps on, until the estimate is as small as was asked for. They start from as many
points as the reference does, so that neither knows of a minimum that the other does not.
Held to its word on synthetic cases by ``tests/fitting/test_accuracy.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...merl_io.inputs import Input
from ...model.two_scale import TwoScale
from ..fit.levenberg_marquardt import Solution, compress
from ..fit.outcome import Fitted
from ..fit.problem import Problem, make_problem
from ..fit.residuals import Objective, predict
from ..fit.transforms import Layout
from ..pipeline.models import layout_for, variant
from ..pipeline.run import assess, last_steps
from ..pipeline.search import AnySamples
from ..results import schema, storage
from ..settings.choice import FITTED, POINTS, REFERENCE, Choice, choice_of, default_choice
from ..settings.config import Config, ConfigError
from .frontier import Point, load
from .request import Request, needed

UNCALIBRATED = "no calibration is of their directions"
Model = tuple[Layout, np.ndarray]  # and its free coordinates


def distance(a: Model, b: Model, problem: Problem) -> float:
    """Distance of two predictions, over all bins, relative to the measurement; infinite where one is not finite.

    Args:
        problem: all bins in float64.
    """
    total = 0.0
    for part in problem.parts:
        here, there = (predict(e.model, e.values(jnp.asarray(z)), part.directions) for e, z in (a, b))
        root = np.moveaxis(np.asarray(part.root), 1, 0)
        weighted = root.reshape(*here.shape, -1) @ (here - there)[..., None]
        total += float(np.sum(weighted**2))
    return total**0.5 if np.isfinite(total) else np.inf


def remaining(model: Model, problem: Problem) -> float:
    """Length |J dz| of the Gauss-Newton step from here, relative to the measurement; infinite where the model is."""
    layout, z = model
    normal = Objective(layout, problem).normal_equations(z)
    if not np.all(np.isfinite(normal)):
        return np.inf
    return float(np.linalg.norm(compress(np.asarray(z), normal).value[:-1]))


def estimate(model: Model, problem: Problem, config: Config) -> float:
    """Error of a fit, from its end alone.

    Args:
        problem: all bins as the reference has them (`reference_problem`). config: what was asked for.
    """
    layout, z = model
    reference = same_variant(REFERENCE.settings(config), layout), z
    tier = 0.0 if reference[0] == layout else distance(model, reference, problem)
    return tier + remaining(reference, problem)


def same_variant(settings: Config, layout: Layout) -> Layout:
    """What these settings make of the variant of the model that was fitted."""
    material = layout.material
    return layout_for(settings, variant(settings, material.name, material.variant), layout.bands)


def reference_problem(samples: AnySamples) -> Problem:
    """All bins as the reference fit has them."""
    return make_problem(samples, REFERENCE.azimuths, REFERENCE.precision)


def resume_fit(model: Model, settings: Config, samples: AnySamples) -> tuple[Layout, Solution]:
    """The last steps once more from where a fit is."""
    layout = same_variant(settings, model[0])
    return layout, last_steps(layout, model[1], samples, settings.fit)


class _Try(NamedTuple):
    """Where a fit has come to with some settings, and the error estimated there."""

    choice: Choice
    layout: Layout
    solution: Solution
    error: float
    floor: bool = False


@dataclass(frozen=True)
class Aim:
    """A request, the point of the frontier that was chosen for it, and the settings that it is applied to.

    Attributes:
        point: None of scattered directions. calibration: in words, where the frontier comes from.
    """

    request: Request
    point: Point | None
    config: Config
    calibration: str

    @property
    def choices(self) -> list[Choice]:
        """What a fit is taken through, one after the other, until it is accurate enough."""
        if self.point is None:
            return [*(q for q in POINTS if q.starts == REFERENCE.starts), REFERENCE]
        return [self.point.choice, *[self.point.choice.finest()] * 2]

    @property
    def settings(self) -> Config:
        """Settings of the fit to start with."""
        return self.choices[0].settings(self.config)

    @property
    def calibrated(self) -> bool:
        """Whether the fits of the calibration were fits of this kind, but for the choice and the body."""
        usual = Config()
        effects = replace(self.config.effects, index=usual.effects.index, body=usual.effects.body)
        given = replace(self.config.input, origin="")
        return replace(self.config, seed=usual.seed, input=given, posterior=usual.posterior, effects=effects) == usual

    @property
    def summary(self) -> str:
        """What was asked, what is chosen for it, and what to expect."""
        point, said = self.point, "what to expect of these effects and limits was not calibrated"
        if point is None:
            first, last = self.choices[0], self.choices[-1]
            return (
                f"{self.request}: each file's own samples decide ({self.calibration}): a fit begins with {first}, and "
                f"goes on, to {last} at the most, until it is estimated to be so near to the reference fit"
            )
        if self.calibrated:
            longest = needed(point, self.request.has_time_to_estimate(point))
            said = (
                f"expected within {point.promised.p95:.2g} of the reference fit in {point.seconds.median:.2g} to "
                f"{longest:.2g} s for each file, without posterior; the first fit with these settings also "
                "compiles its programs, which takes longer than the fit"
            )
        default = " (the defaults)" if point.choice == default_choice() else ""
        return f"{self.request}: {choice_of(self.settings)}{default}; {said} ({self.calibration})"

    def finish(self, fitted: Fitted, measurement: Input, samples: AnySamples) -> tuple[Fitted, schema.Accuracy]:
        """The error that a fit is estimated to have, and the fit carried on where that is not what was asked for."""
        if self.point is not None and not self.request.has_time_to_estimate(self.point):
            only = _Try(choice_of(self.settings), fitted.layout, fitted.solution, np.inf)
            return fitted, self._summary([only], only)
        problem, wanted = reference_problem(samples), self.request.accuracy
        best = self._assessed(self.choices[0], fitted.layout, fitted.solution, problem)
        tried = [best]
        for choice in self.choices[1:]:
            if wanted is None or best.error <= wanted:
                break
            found = resume_fit((best.layout, best.solution.z), choice.settings(self.config), samples)
            tried.append(self._assessed(choice, *found, problem))
            best = min(tried, key=lambda t: t.error)
        if best.solution is not fitted.solution:
            whole = assess(best.layout, best.solution, measurement, samples, self.config.fit.theta_max)
            fitted = replace(whole, candidates=fitted.candidates, exponent=fitted.exponent)
        return fitted, self._summary(tried, best)

    def _assessed(self, choice: Choice, layout: Layout, solution: Solution, problem: Problem) -> _Try:
        error = estimate((layout, solution.z), problem, self.config)
        floor = 0.0 if self.point is None else self.point.other_minimum
        return _Try(choice_of(choice.settings(self.config)), layout, solution, max(error, floor), floor > error)

    def _summary(self, tried: list[_Try], best: _Try) -> schema.Accuracy:
        asked, point = self.request, self.point if self.calibrated else None
        longest = None if point is None else needed(point, asked.has_time_to_estimate(point))
        return schema.Accuracy(
            asked=asked.accuracy, asked_seconds=asked.seconds, calibration=self.calibration,
            expected=None if point is None else point.promised.p95, expected_seconds=longest,
            tried=[schema.Tried(settings=t.choice, estimated=storage.finite(t.error), floor=t.floor) for t in tried],
            settings=best.choice, estimated=storage.finite(best.error), floor=best.floor,
            met=None if asked.accuracy is None else best.error <= asked.accuracy,
        )  # fmt: skip


def usable(points: Sequence[Point], config: Config) -> list[Point]:
    """Points that make a difference: those that economise on the tier do not where another one was asked for."""
    return [q for q in points if config.effects.diffraction == "quadrature" or q.choice.diffraction == "quadrature"]


def aim(request: Request, config: Config, scattered: bool = False) -> Aim:
    """The cheapest way to what is asked for.

    Args:
        scattered: whether the files hold scattered directions.

    Raises:
        ConfigError: there is none, or the configuration sets what is to be chosen.
    """
    mine, usual = choice_of(config), default_choice()
    orders = ["order"] if config.effects.diffraction == "quadrature" else []
    if chosen := [key for key in (*sorted(FITTED), *orders) if getattr(mine, key) != getattr(usual, key)]:
        section = "fit" if chosen[0] in FITTED else "effects"
        raise ConfigError(f"{section}.{chosen[0]} is chosen by --accuracy and --time: leave it out")
    if config.model.name != TwoScale.name:
        raise ConfigError(
            "--accuracy and --time choose among settings of the two-scale model alone, and what is to be fitted is "
            f"{config.model.name if isinstance(config.model.name, str) else ', '.join(config.model.name)}"
        )
    if scattered:
        return Aim(request, None, config.for_scattered, UNCALIBRATED)
    frontier, calibration = load()
    return Aim(request, request.choose(usable(frontier.points, config)), config, calibration)
