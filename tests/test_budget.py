"""A test that compiles or reads too many programs fails."""

from pathlib import Path

import jax
import numpy as np
import pytest

from tests import budget

ROOT = Path(__file__).parents[1]


def compiled(count):
    """So many programs of one operation, new to JAX."""
    for size in range(count):
        jax.jit(lambda x: x + 1)(np.zeros(size + 1))


@pytest.fixture
def plugin(pytestconfig):
    """That of these very tests."""
    (found,) = (each for each in pytestconfig.pluginmanager.get_plugins() if isinstance(each, budget.Budget))
    return found


def test_programs_are_counted_and_too_many_fail(plugin):
    with plugin.at_most(3):
        compiled(3)
    with (
        pytest.raises(pytest.fail.Exception, match="4 programs were compiled or read, 3 are allowed"),
        plugin.at_most(3),
    ):
        compiled(4)


@pytest.mark.xfail(strict=True, raises=pytest.fail.Exception, reason="one program more than a test may need")
def test_a_test_with_too_many_fails():
    compiled(budget.SLACK * budget.PROGRAMS + 1)


def test_exceptions_are_of_files_that_are_there():
    for file, programs in budget.MORE.items():
        assert (ROOT / file).is_file(), file
        assert programs > budget.PROGRAMS, file
