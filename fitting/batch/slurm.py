"""Workers that SLURM gives: a scheduler in this process, and jobs that ``sbatch`` is asked for.

What a job is comes from Dask's own files (docs/clusters.md). Those that end while the run goes on are asked for again.
"""

from __future__ import annotations

import logging
import shutil
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from .connection import SLURM, ClusterError, library, line

UNHEARD = logging.CRITICAL + 1  # level of what the scheduler logs: what matters is said in lines of ours
PATIENCE = 20.0  # seconds for jobs to be cancelled


@dataclass
class _Answers:
    """What ``sbatch`` answered.

    Attributes:
        open: jobs that it has not answered yet. taken: names of those in its queue, or at work.
        refused: its last line about one that it did not take.
    """

    open: int = 0
    taken: set[str] = field(default_factory=set)
    refused: str = ""


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
        self._answers = _Answers()
        job = _job(made.slurm.SLURMJob, self._answers)
        try:
            self._cluster = made.SLURMCluster(job_cls=job, silence_logs=UNHEARD)
        except (ValueError, TypeError, OSError, RuntimeError) as error:
            raise ClusterError(
                f"--executor {where}: {line(error)}; see docs/clusters.md for ~/.config/dask/jobqueue.yaml"
            ) from None
        self.address, self.security = self._cluster.scheduler_address, self._cluster.security
        self._cluster.adapt(minimum=jobs, maximum=jobs)  # those that are lost are asked for again

    def refused(self) -> str:
        """What ``sbatch`` said of a job that it did not take, when it answered of all; '' if it took them."""
        return "" if self._answers.open else self._answers.refused

    def empty(self) -> bool:
        """Whether it has taken none that is not over."""
        return not self._answers.taken

    def close(self) -> None:
        """Cancel the jobs."""
        with suppress(TimeoutError):
            self._cluster.close(timeout=PATIENCE)


def _job(base: Any, answers: _Answers) -> type:  # noqa: ANN401 - dask_jobqueue's SLURMJob, which has no types
    """A job that writes down what ``sbatch`` answers; Dask would print an error's traceback and wait for ever."""
    from distributed import Status

    class Job(base):
        async def start(self) -> None:
            answers.open += 1
            try:
                await super().start()
                answers.taken.add(self.name)
            except (RuntimeError, OSError, ValueError) as error:
                said = [each.strip() for each in str(error).splitlines() if each.strip()]
                answers.refused = said[-1] if said else type(error).__name__
                self.status = Status.running  # not asked for again
            finally:
                answers.open -= 1

        async def close(self) -> None:
            await super().close()
            answers.taken.discard(self.name)
            self.status = Status.closed

    return Job
