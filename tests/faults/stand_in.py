"""The `merlfit` command with a stand-in for the fit, for faults that are tried more often than fits could be.

All but the fit itself is the program's own: workers, folders, results, chains, the manifest, messages. What the
stand-in finds depends on the content of the file alone, and it writes as a fit does: first the fit, then the chain,
then the result with its posterior.
"""

import hashlib
import random
import sys
import threading
from pathlib import Path
from unittest import mock

sys.path.append(str(Path(__file__).parents[2]))  # run as a file, in any folder
import numpy as np
from merlfit.fitting.batch import unit as units
from merlfit.fitting.batch.pool import Pool
from merlfit.fitting.commands import cli
from merlfit.fitting.commands import fit as files
from merlfit.fitting.pipeline.draws import chain_of
from merlfit.fitting.posterior.chain import write_chain
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.support.processes import jobs_for
from merlfit.merl_io.binary import MerlError

from tests.support.made_results import made

CHAIN = {
    "chain_free": np.ones((4, 8, 3)), "log_prob": np.ones((4, 8)), "accepted": np.array(0.5), "root": np.eye(3),
    "leap": np.array(0.1), "training_points": np.ones((9, 3)), "random_state": np.array([624.0, 0, 0]),
    "random_keys": np.arange(624, dtype=np.uint32), "fit_free": np.ones(3),
    "retrainings": np.array(0),
}  # fmt: skip
SLEEPS = 0.15  # seconds, each of three of a file, at the most
PAUSE = threading.Event().wait  # `time.sleep` fails under a clock that is faked


def stand_in(path, out, settings, report, finish):
    """As `pipeline.run.fit_file`."""
    report("reading")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MerlError(f"{path}: cannot be read ({error.strerror})") from None
    sha1 = hashlib.sha1(content).hexdigest()
    rng = random.Random(sha1)
    found = None
    for posterior in (None, True):
        report("fit" if posterior is None else "posterior")
        PAUSE(rng.uniform(0, SLEEPS))
        found = made(path.stem, str(path), posterior=posterior, sha1=sha1)
        found = found.model_copy(
            update={
                "config": settings.plain(),
                "fit": found.fit.model_copy(update={"cost": int(sha1[:8], 16) / 2**32}),
            }
        )
        target = out / f"{path.stem}.json"
        if posterior:
            write_chain(chain_of(target), {**CHAIN, "leap": np.array(found.fit.cost)})
            PAUSE(rng.uniform(0, SLEEPS))
        write_result(target, found)
    return found


def task(unit, report):
    """As `unit.fit_unit`."""
    with mock.patch.object(units, "fit_file", stand_in):
        return units.fit_unit(unit, report)


def executor_of(count, jobs=None, where=None):
    """As `files.executor_of`, always with processes."""
    jobs = jobs_for(count, jobs)
    return Pool(jobs, task, note=files.note), jobs


if __name__ == "__main__":
    files.executor_of = executor_of
    cli.main()
