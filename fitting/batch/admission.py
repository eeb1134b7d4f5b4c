"""What lets the workers of a Dask cluster take part in a run.

It is sent as code, not by name: a worker without merlfit can receive it, and is refused instead of breaking.
"""

from __future__ import annotations

import hashlib
import platform
from importlib import metadata

from distributed import Status, Worker, WorkerPlugin

TOPIC = "merlfit"  # of what workers tell while they work


class Admission(WorkerPlugin):
    """Gives a worker with these versions a resource that units ask for, one at a time: its memory is for one file.

    Attributes:
        name: of the resource, the same of all runs with these versions.
    """

    def __init__(self, packages: dict[str, str]) -> None:
        self.packages = packages
        self.name = f"merlfit-{hashlib.sha1(repr(packages).encode()).hexdigest()[:8]}"

    async def setup(self, worker: Worker) -> None:
        """In a worker, when it joins and when a run begins."""
        found = {name: _version(name) for name in self.packages}
        differ = [f"{name} {found[name]} instead of {v}" for name, v in self.packages.items() if found[name] != v]
        if differ:
            worker.log_event(TOPIC, {"by": self.name, "refused": f"{worker.address} has {', '.join(differ)}"})
        elif self.name not in worker.state.total_resources:
            await worker.set_resources(**{self.name: 1})
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
