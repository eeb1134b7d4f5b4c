"""What lets the workers of a Dask cluster take part in a run.

It is sent as code, not by name: a worker without merlfit can receive it, and is refused instead of breaking.
"""

from __future__ import annotations

import platform
from importlib import metadata

from distributed import Status, Worker, WorkerPlugin

TOPIC = "merlfit"  # of what workers tell while they work
ONE = "merlfit"  # resource that a worker has once, however many runs it serves: its memory is for one file


class Admission(WorkerPlugin):
    """Gives a worker the resources that orders ask for, one at a time, if it computes as the client would."""

    def __init__(self, run: str, packages: dict[str, str]) -> None:
        self.run, self.name, self.packages = run, f"merlfit-{run}", packages

    async def setup(self, worker: Worker) -> None:
        """In a worker, when it joins."""
        found = {name: _version(name) for name in self.packages}
        differ = [
            f"{name} {found[name]} instead of {ours}" for name, ours in self.packages.items() if found[name] != ours
        ]
        if differ:
            worker.log_event(TOPIC, {"run": self.run, "refused": f"{worker.address} has {', '.join(differ)}"})
            return
        await worker.set_resources(**{self.name: 1, ONE: 1})
        # A scheduler looks for units that wait for a worker when one begins to run, not when it gets a resource.
        if worker.status is Status.running:
            worker.status = Status.paused
            worker.status = Status.running


def _version(package: str) -> str:
    if package == "python":
        return platform.python_version()
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "missing"
