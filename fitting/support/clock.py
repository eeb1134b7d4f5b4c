"""What is told of a run while it goes on: its stages, and how long each took."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Self

Report = Callable[[str], None]


class Stage(str):
    """What is being done, in words, and which share of it is done already, if that is known."""

    share: float | None

    def __new__(cls, words: str, share: float | None = None) -> Self:  # noqa: D102
        found = super().__new__(cls, words)
        found.share = share
        return found


def silent(_: str) -> None:
    """Reports that nobody asked for."""


class Clock:
    """Seconds by stage, and of everything since the start."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def times(self) -> dict[str, float]:
        """By stage, and ``total`` until now."""
        return {**self.seconds, "total": round(time.perf_counter() - self.start, 3)}

    def spent(self, name: str, seconds: float) -> None:
        """Count what a stage took before this clock was started."""
        self.start -= seconds
        self.seconds[name] = round(self.seconds.get(name, 0.0) + seconds, 3)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Seconds of what is done in here, added to what the stage has taken before."""
        start = time.perf_counter()
        yield
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - start, 3)
