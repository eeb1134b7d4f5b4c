"""Units in this process, one after the other, each with all cores."""

from collections.abc import Callable, Iterator, Sequence

from ..support.compilation import use_persistent_cache
from .unit import Ended, Task, Unit, fit_unit


class Here:
    """As `pool.Pool`, without a process of its own for a unit."""

    name = "Here"

    def __init__(self, task: Task = fit_unit) -> None:
        self.task = task

    def ended(self, units: Sequence[Unit], tell: Callable[[int, str], None]) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, in their order."""
        use_persistent_cache()
        for k, unit in enumerate(units):
            yield k, self.task(unit, lambda stage, k=k: tell(k, stage))

    def stop(self) -> list[tuple[int, Ended]]:
        """Nothing goes on beside what was stopped already."""
        return []
