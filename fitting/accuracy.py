"""How far a fit is from the reference fit, estimated where it ended, and on from there where that is too far.

With the reference's settings at the fit's own parameters z as a stepping stone,

    |f(z) - f_ref(z_ref)| <= |f(z) - f_ref(z)| + |f_ref(z) - f_ref(z_ref)|,

norms over all bins, relative to the measurement, with the weights of Eq. 56. The first one, what the tier of
diffraction errs by, is evaluated; the second is the length |J dz| of the Gauss-Newton step that the reference has still
to take from z. A sum of lengths is an upper bound as far as one step goes; of other minima it knows nothing. Those are
counted by the calibration, and the estimate is never below what it found for fits that went astray
(`frontier.Point.astray`). Held to its word on synthetic cases by ``tests/fitting/test_frontier.py``.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ..merl_io.binary import Measurement
from ..merl_io.samples import Samples, thin
from ..model.effects import Effects
from . import export
from .choice import POINTS, REFERENCE, Choice, default_choice
from .config import Config, ConfigError
from .frontier import Point, load
from .levenberg_marquardt import PULL, RESIDUAL_SCALE, Solution, compress, solve
from .outcome import Fitted
from .problem import Problem, make_problem
from .request import Request, usable
from .residuals import normal_equations, predict
from .run import GRIDS, judge
from .transforms import layout_of

Model = tuple[Effects, np.ndarray]  # and its free coordinates


def distance(a: Model, b: Model, problem: Problem) -> float:
    """Of two predictions, over all bins, relative to the measurement; ``problem``: all bins in float64."""
    total = 0.0
    for part in problem.parts:
        here, there = (predict(e, layout_of(e).values(jnp.asarray(z)), part.directions) for e, z in (a, b))
        root = np.moveaxis(np.asarray(part.root), 1, 0)
        weighted = root.reshape(*here.shape, -1) @ (here - there)[..., None]
        total += float(np.sum(weighted**2))
    return total**0.5


def remaining(model: Model, problem: Problem) -> float:
    """Length |J dz| of the Gauss-Newton step from here, relative to the measurement."""
    effects, z = model
    point = jnp.asarray(z)
    normal = normal_equations(effects, point, problem)
    near = compress(point, normal, PULL * jnp.sum(normal[:, -1, -1]))
    return float(jnp.linalg.norm(near.value[:-1])) / RESIDUAL_SCALE


def estimate(model: Model, problem: Problem, config: Config) -> float:
    """Error of a fit, from its end alone.

    Args:
        problem: all bins as the reference has them (`reference_problem`). config: what was asked for.
    """
    effects, z = model
    reference = REFERENCE.settings(config).effects_of(effects.body), z
    tier = 0.0 if reference[0] == effects else distance(model, reference, problem)
    return tier + remaining(reference, problem)


def reference_problem(samples: Samples) -> Problem:
    """All bins as the reference fit has them."""
    return make_problem(samples, REFERENCE.azimuths, REFERENCE.precision)


def carry_on(model: Model, settings: Config, samples: Samples) -> tuple[Effects, Solution]:
    """The last steps once more from where a fit is.

    Even with the same settings it gains: what pulls free coordinates towards 0 is relative to the cost at the start.
    """
    effects = settings.effects_of(model[0].body)
    problem = make_problem(thin(samples, GRIDS[settings.fit.grid]), settings.fit.azimuths, settings.fit.precision)
    return effects, solve(effects, model[1], problem, settings.fit.max_steps, backend=settings.fit.backend)


@dataclass(frozen=True)
class Aim:
    """A request, the point of the frontier that was chosen for it, and the settings that it is applied to.

    Attributes:
        calibration: in words, where the frontier comes from.
    """

    request: Request
    point: Point
    config: Config
    calibration: str

    @property
    def settings(self) -> Config:
        """Of the fit to start with."""
        return self.point.choice.settings(self.config)

    @property
    def told(self) -> str:
        """What was asked, what is chosen for it, and what to expect."""
        asked, point = self.request, self.point
        wanted = f"--accuracy {asked.accuracy:g}" if asked.accuracy is not None else f"--time {asked.seconds:g}s"
        return (
            f"{wanted}: {point.choice}; expected within {point.error.p95:.2g} of the reference fit in "
            f"{point.seconds.median:.2g} to {point.seconds.p95:.2g} s a file, once compiled, four bodies, no posterior "
            f"({self.calibration})"
        )

    @property
    def finer(self) -> list[Choice]:
        """Where to go on to, one after the other, with no other start; the last of them, the reference's, twice."""
        further: list[Choice] = []
        for choice in POINTS[POINTS.index(self.point.choice) + 1 :]:
            step = self.point.choice.continued(choice)
            if step.settings(self.config) not in [q.settings(self.config) for q in (self.point.choice, *further)]:
                further.append(step)
        return [*further, self.point.choice.continued(REFERENCE)]

    def finish(self, fitted: Fitted, measurement: Measurement, samples: Samples) -> tuple[Fitted, export.Accuracy]:
        """The error that a fit is estimated to have, and the fit carried on until it is what was asked for."""
        problem, wanted = reference_problem(samples), self.request.accuracy
        effects, solution = fitted.effects, fitted.solution
        error = self._promised(effects, solution, problem)
        tried = [export.Tried(settings=self.point.choice, estimated=export.finite(error))]
        for choice in self.finer:
            if wanted is None or not error > wanted:
                break
            effects, solution = carry_on((effects, solution.z), choice.settings(self.config), samples)
            error = self._promised(effects, solution, problem)
            tried.append(export.Tried(settings=choice, estimated=export.finite(error)))
        if solution is not fitted.solution:
            fitted = replace(judge(effects, solution, measurement, samples), candidates=fitted.candidates)
        return fitted, self._told(tried)

    def _promised(self, effects: Effects, solution: Solution, problem: Problem) -> float:
        return max(estimate((effects, solution.z), problem, self.config), self.point.astray)

    def _told(self, tried: list[export.Tried]) -> export.Accuracy:
        asked, estimated = self.request.accuracy, tried[-1].estimated
        return export.Accuracy(
            asked=asked, asked_seconds=self.request.seconds, calibration=self.calibration,
            expected=self.point.error.p95, expected_seconds=self.point.seconds.p95, tried=tried, estimated=estimated,
            met=None if asked is None else estimated is not None and estimated <= asked,
        )  # fmt: skip


def aim(request: Request, config: Config) -> Aim:
    """The cheapest way to what is asked for.

    Raises:
        request.Unreachable: there is none. config.ConfigError: the configuration sets what is to be chosen.
    """
    given = config.fit.model_dump()
    for key, value in default_choice().model_dump(include=set(given)).items():
        if given[key] != value:
            raise ConfigError(f"fit.{key} is chosen by --accuracy and --time: leave it out")
    frontier, calibration = load()
    return Aim(request, request.choose(usable(frontier.points, config)), config, calibration)
