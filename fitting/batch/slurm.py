"""Workers that SLURM gives: a scheduler in this process, and jobs that ``sbatch`` is asked for.

What a job is comes from Dask's own files (docs/clusters.md). Those that end while the run goes on are asked for again.
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from typing import Any

from .connection import SLURM, UNHEARD, ClusterError, library, line

PATIENCE = 20.0  # seconds for jobs to be cancelled


class Queue:
    """So many workers, asked of SLURM.

    Attributes:
        address: of the scheduler. security: for its clients.
    """

    def __init__(self, where: str, jobs: int | None) -> None:
        """Ask for them.

        Raises:
            ClusterError: a library, ``sbatch``, the number of jobs or what a job is is missing.
        """
        made = library("dask_jobqueue", where, SLURM)
        if jobs is None:
            raise ClusterError(f"--executor {where} needs --jobs N: how many workers SLURM is asked for")
        if shutil.which("sbatch") is None:
            raise ClusterError(
                f"--executor {where} needs sbatch, which is not found: run merlfit where jobs are submitted"
            )
        try:
            self._cluster = made.SLURMCluster(job_cls=_job(made.slurm.SLURMJob), silence_logs=UNHEARD)
        except (ValueError, TypeError, OSError, RuntimeError) as error:
            raise ClusterError(
                f"--executor {where}: {line(error)}; see docs/clusters.md for ~/.config/dask/jobqueue.yaml"
            ) from None
        self.address, self.security = self._cluster.scheduler_address, self._cluster.security
        self._cluster.adapt(minimum=jobs, maximum=jobs)  # those that are lost are asked for again

    def refusals(self) -> list[str]:
        """What ``sbatch`` said of each job that it has answered, if it did not take it, or ''."""
        return [job.refusal for job in list(self._cluster.workers.values())]

    def close(self) -> None:
        """Cancel the jobs."""
        with suppress(TimeoutError):
            self._cluster.close(timeout=PATIENCE)


def _job(base: Any) -> type:  # noqa: ANN401 - dask_jobqueue's SLURMJob, which has no types
    """A job that keeps what ``sbatch`` refuses it with; Dask would print an error's traceback and wait for ever."""
    from distributed import Status

    class Job(base):
        refusal = ""

        async def start(self) -> None:
            try:
                await super().start()
            except (RuntimeError, OSError, ValueError) as error:
                said = [each.strip() for each in str(error).splitlines() if each.strip()]
                self.refusal = said[-1] if said else type(error).__name__
                self.status = Status.running  # not asked for again

    return Job
