"""What a user asks of a fit, an accuracy or a time, and which point of the frontier that takes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from .config import Config
from .frontier import Point

MARGIN = 1.2  # seconds of the same fit differ by so much from run to run
UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


class Unreachable(ValueError):
    """A request that cannot be met; the message is one line that says what can."""


def usable(points: Sequence[Point], config: Config) -> list[Point]:
    """Points that make a difference: those that economise on the tier do not where another one was asked for."""
    return [q for q in points if config.effects.diffraction == "quadrature" or q.choice.diffraction == "quadrature"]


def needed(point: Point) -> float:
    """Seconds to allow for a fit and the estimate of its error, once compiled."""
    return MARGIN * (point.seconds.p95 + point.estimate_seconds.p95)


@dataclass(frozen=True)
class Request:
    """What a fit is to reach: an ``accuracy`` (error of :mod:`.frontier`) or a time (``seconds`` a file)."""

    accuracy: float | None = None
    seconds: float | None = None

    def choose(self, points: Sequence[Point]) -> Point:
        """The cheapest point that is accurate enough, or the most accurate that is fast enough.

        Where an accuracy is promised for half of the fits only, the most accurate point: the others are carried on.

        Raises:
            Unreachable: not even that, or nothing is so fast.
        """
        if self.accuracy is not None:
            enough = [q for q in points if q.promised.p95 <= self.accuracy]
            if enough:
                return min(enough, key=lambda q: q.seconds.median)
            best = min(points, key=lambda q: (q.promised.p95, q.promised.median))
            if best.promised.median > self.accuracy:
                raise Unreachable(
                    f"--accuracy {self.accuracy:g} is out of reach: the most accurate settings ({best.choice}) come "
                    f"within {best.promised.median:.2g} in half of the calibration's fits"
                )
            return best
        assert self.seconds is not None
        quick = [q for q in points if needed(q) <= self.seconds]
        if not quick:
            best = min(points, key=needed)
            raise Unreachable(
                f"--time {self.seconds:g}s is out of reach: the cheapest settings ({best.choice}) take up to "
                f"{needed(best):.2g} s a file, compiled"
            )
        return min(quick, key=lambda q: (q.promised.p95, q.seconds.median))


def request(accuracy: float | None, time: str | None) -> Request:
    """From the words of a command line, one of which is given.

    Raises:
        ValueError: both, or a number that is none; the message is one line.
    """
    if accuracy is not None and time is not None:
        raise ValueError("--accuracy and --time are two ways of choosing: give one of them")
    if accuracy is not None and not 0 < accuracy < 1:
        raise ValueError(f"--accuracy {accuracy:g}: should be a relative error between 0 and 1, such as 1e-3")
    return Request(accuracy, None if time is None else seconds_of(time))


def seconds_of(text: str) -> float:
    """Seconds of "2s", "500ms", "1.5min"; raises ValueError with one line."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]*)\s*", text)
    value = float(found[1]) * UNITS.get(found[2] or "s", math.nan) if found else math.nan
    if not value > 0:
        raise ValueError(f"--time {text}: should be a time such as 2s, 500ms or 1.5min")
    return value
