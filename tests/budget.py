"""How many programs a test may compile or read from the cache: a test that needs more fails.

JAX makes a program of every operation outside of `jax.jit`, for each shape anew, and each costs every new process 50 ms
though it be cached. What fixtures of modules and of the session need is not the test's. A test is first in its process
at some time, so programs that others of its module share count.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import jax
import pytest

from tests.times import COMPILED, READ, SPENT

PROGRAMS = 20
SLACK = 2  # times as many fail: how many are new to a process depends on what it ran before, and on its cache
MORE = {
    # A fit through the command line or the interface is 50 to 90 programs; pictures, tables and exports of it the rest
    "tests/fitting/test_api.py": 200,
    "tests/fitting/test_bands.py": 24,
    "tests/fitting/test_cases.py": 60,
    "tests/fitting/test_comparison.py": 90,
    "tests/fitting/test_constraints.py": 60,
    "tests/fitting/test_demo.py": 65,
    "tests/fitting/test_fit.py": 65,
    "tests/fitting/test_hard_fits.py": 80,
    "tests/fitting/test_rival_commands.py": 120,
    "tests/fitting/test_scattered.py": 60,
    "tests/fitting/test_stacking.py": 60,
    # Many variants of the model, a program or two each
    "tests/fitting/test_models.py": 32,
    "tests/scene/test_effects.py": 90,
    "tests/test_bench.py": 65,
    # Pictures of scenes, and what is drawn of every fit
    "tests/fitting/test_pictures.py": 24,
    "tests/fitting/test_scenes.py": 36,
    "tests/fitting/test_starts.py": 36,
    # As they were before NumPy arrays went to the device without a program, slow tests among them; to be measured anew
    "tests/fitting/test_accuracy.py": 140,
    "tests/fitting/test_stacked.py": 110,
    "tests/fitting/test_cluster_fits.py": 300,
    "tests/fitting/test_coreset.py": 26,
    "tests/fitting/test_cost.py": 30,
    "tests/fitting/test_objective.py": 310,
    "tests/fitting/test_posterior.py": 170,
    "tests/model/test_energy.py": 28,
    "tests/scene/test_mitsuba.py": 26,
    "tests/scene/test_render.py": 26,
    "tests/test_hard_cases.py": 180,
}
"""Files whose tests may need more each; no number here may grow, and no file may be added that fits nothing."""


class Budget:
    """A plugin of pytest that counts programs in every process of tests, and fails a test that needs too many."""

    def __init__(self) -> None:
        self.programs = 0
        jax.monitoring.register_event_listener(self._count)

    def _count(self, event: str, **_) -> None:
        self.programs += event in (COMPILED, READ)

    @contextmanager
    def at_most(self, programs: int) -> Iterator[None]:
        """Fails if what is done within needs more."""
        before = self.programs
        yield
        spent = self.programs - before
        if spent > programs:
            pytest.fail(f"{spent} programs were compiled or read, {programs} are allowed: see tests/budget.py", False)

    @pytest.hookimpl(wrapper=True)
    def pytest_pyfunc_call(self, pyfuncitem: pytest.Function) -> object:
        """The test itself, when its fixtures are there."""
        before = self.programs
        try:
            with self.at_most(SLACK * MORE.get(pyfuncitem.nodeid.split("::")[0], PROGRAMS)):
                return (yield)
        finally:
            pyfuncitem.stash[SPENT] = self.programs - before
