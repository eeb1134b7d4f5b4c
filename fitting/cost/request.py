"""What a user asks of a fit, an accuracy or a time, and which point of the frontier that takes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..settings.choice import default_choice
from ..settings.config import ConfigError
from .frontier import Point

MARGIN = 1.2  # seconds of the same fit differ by so much from run to run
ALIKE = 1.1  # times an error: no more is no difference worth waiting for
UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


def needed(point: Point, estimate: bool = True) -> float:
    """Seconds to allow for a fit, with or without the estimate of its error, once compiled."""
    return MARGIN * (point.seconds.p95 + (point.estimate_seconds.p95 if estimate else 0.0))


def idle(point: Point, default: Point | None) -> bool:
    """Whether the calibration itself says that a fit without any request is as accurate and no slower.

    Such a fit does not wait for an estimate of its error; one that was asked for something does.
    """
    if default is None or point is default or point.promised.p95 < default.promised.p95:
        return False
    usual = point.seconds.median + point.estimate_seconds.median >= default.seconds.median
    return usual and needed(point) >= needed(default, estimate=False)


@dataclass(frozen=True)
class Request:
    """What a fit is to reach: an ``accuracy`` (error of :mod:`.frontier`) or a time (``seconds`` a file).

    Attributes:
        text: the time as it was typed.
    """

    accuracy: float | None = None
    seconds: float | None = None
    text: str = field(default="", compare=False)

    def __str__(self) -> str:
        """As it is typed."""
        if self.accuracy is not None:
            return f"--accuracy {self.accuracy:g}"
        return f"--time {self.text or f'{self.seconds:g}s'}"

    def has_time_to_estimate(self, point: Point) -> bool:
        """Whether the error of a fit can be estimated, too, without exceeding the time that was asked for."""
        return self.seconds is None or needed(point) <= self.seconds

    def choose(self, points: Sequence[Point]) -> Point:
        """The fastest point that is accurate enough, or the most accurate one that is fast enough.

        Where an accuracy is promised for half of the fits only: the fastest of the most accurate points that do so; the
        other fits are carried on. Points that are no better than the defaults and no faster are never chosen (`idle`).

        Raises:
            ConfigError: not even that, or nothing is so fast.
        """
        default = next((q for q in points if q.choice == default_choice()), None)
        points = [q for q in points if not idle(q, default)]
        if self.accuracy is not None:
            return self._accurate(points, self.accuracy)
        assert self.seconds is not None
        quick = [q for q in points if needed(q, estimate=q is not default) <= self.seconds]
        if not quick:
            best = min(points, key=needed)
            raise ConfigError(
                f"{self} is out of reach: the fastest settings ({best.choice}) take up to {needed(best):.2g} s for "
                "each file, once compiled"
            )
        return min(quick, key=lambda q: (q.promised.p95, q.seconds.median))

    def _accurate(self, points: Sequence[Point], wanted: float) -> Point:
        best = min(points, key=lambda q: (q.promised.p95, q.promised.median))
        enough = [q for q in points if q.promised.p95 <= wanted] or [
            q for q in points if q.promised.median <= wanted and q.promised.p95 <= ALIKE * best.promised.p95
        ]
        if not enough or best.promised.median > wanted:
            raise ConfigError(
                f"{self} is out of reach: the most accurate settings ({best.choice}) come "
                f"within {best.promised.median:.2g} in half of the calibration's fits"
            )
        return min(enough, key=lambda q: q.seconds.median)


def request(accuracy: float | None, time: str | None) -> Request:
    """From the words of a command line, one of which is given.

    Raises:
        ConfigError: both, or a number that is none.
    """
    if accuracy is not None and time is not None:
        raise ConfigError("--accuracy and --time are two ways of choosing: give one of them")
    if accuracy is not None and not 0 < accuracy < 1:
        raise ConfigError(f"--accuracy {accuracy:g}: should be a relative error between 0 and 1, such as 1e-3")
    return Request(accuracy) if time is None else Request(seconds=seconds_of(time), text=time.strip())


def seconds_of(text: str) -> float:
    """Seconds of "2s", "500ms", "1.5min"; raises ConfigError."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]*)\s*", text)
    value = float(found[1]) * UNITS.get(found[2] or "s", math.nan) if found else math.nan
    if not value > 0:
        raise ConfigError(f"--time {text}: should be a time such as 2s, 500ms or 1.5min")
    return value
