"""What a Dask scheduler says of its workers, asked in a thread: nobody waits for one that does not answer."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from distributed import Client

LOOK = 0.5  # seconds between two looks, at the least
SHARE = 20  # so many times as long as a look took it waits for the next one: a scheduler of thousands has other work
IDLE = 10.0  # % of a core: a fit uses more, a worker that does nothing less
QUIET = 120.0  # seconds that a scheduler may be silent


@dataclass(frozen=True)
class State:
    """A worker.

    Attributes:
        admitted: whether it may get units. running: whether its scheduler would give it any. limit: bytes, 0 for none.
        worked: when it last used a core, by `time.monotonic`.
    """

    admitted: bool
    running: bool
    memory: int
    limit: int
    worked: float


class Watch:
    """Looks at a cluster as long as a client is open.

    Attributes:
        workers: by address, at the last look. lost: whether the scheduler is another one than it was.
    """

    def __init__(self, client: Client, resource: str) -> None:
        self.workers: dict[str, State] = {}
        self.lost = False
        self._client, self._resource, self._heard = client, resource, time.monotonic()
        self._scheduler: str | None = None
        self._first, self._over = Event(), Event()
        Thread(target=self._run, name="merlfit-watch", daemon=True).start()
        self._first.wait(LOOK)

    def silent(self, seconds: float | None = None) -> bool:
        """Whether the scheduler has not answered for so long, or for longer than it may."""
        return time.monotonic() > self._heard + (QUIET if seconds is None else seconds)

    def close(self) -> None:
        """Look no more."""
        self._over.set()

    def able(self) -> int:
        """Workers that could take a unit."""
        return sum(state.admitted and state.running for state in list(self.workers.values()))

    def why(self) -> str:
        """In words, why none is."""
        states = self.workers
        full = [address for address, state in states.items() if state.admitted]
        if full:
            state = states[full[0]]
            return (
                f"worker {full[0]} takes nothing, since {state.memory / 2**30:.1f} of {state.limit / 2**30:.1f} GiB "
                "are in use: give workers more memory (`dask worker --memory-limit`)"
            )
        return "no worker is there" if not states else f"none of {len(states)} workers has the versions of this process"

    def _run(self) -> None:
        while not self._over.is_set():
            begun = time.monotonic()
            with suppress(Exception):  # a client that is closed or a scheduler that is gone: seen by who uses them
                self._look(self._client.scheduler_info())
            self._first.set()
            self._over.wait(max(LOOK, SHARE * (time.monotonic() - begun)))

    def _look(self, info: Any) -> None:  # noqa: ANN401 - as Dask made it of JSON
        now = time.monotonic()
        self._scheduler = self._scheduler or info["id"]
        self.lost = self.lost or info["id"] != self._scheduler
        self.workers = {address: self._state(address, each, now) for address, each in info["workers"].items()}
        self._heard = now

    def _state(self, address: str, info: dict[str, Any], now: float) -> State:
        metrics, before = info["metrics"], self.workers.get(address)
        works = metrics.get("cpu", 100.0) >= IDLE
        return State(
            self._resource in info["resources"], info["status"] == "running", metrics.get("memory", 0),
            info["memory_limit"] or 0, now if works or before is None else before.worked,
        )  # fmt: skip
