"""Shared by all tests: compiled programs are cached, runtime type checks are on, data of the reconstructions."""

import os
from pathlib import Path

# XLA's older CPU emitters compile in half the time (CONTRIBUTING.md, compile times); before jax makes its backend
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

import jax
import pytest
from jaxtyping import install_import_hook

from tests import budget, times
from tests.support import reconstructions

install_import_hook(["merlfit.model", "merlfit.merl_io"], "beartype.beartype")

ROOT = Path(__file__).parents[1]
HASTY = "jax_disable_most_optimizations"


def pytest_configure(config):
    """Count the programs of tests, and measure what tests take, where that is asked for."""
    config.pluginmanager.register(budget.Budget())
    if folder := os.environ.get("MERLFIT_TEST_TIMES"):
        config.pluginmanager.register(times.Times(Path(folder)))


def pytest_collection_modifyitems(items):
    """The dearest files first, that none is left alone at the end; those whose programs are hasty before the others."""
    taken, hasty = times.kept(), {item.path for item in items if "compiled_quickly" in item.fixturenames}
    file = {item.path: item.nodeid.split("::")[0] for item in items}
    items.sort(key=lambda item: (item.path not in hasty, -taken.get(file[item.path], 0.0), item.path))


@pytest.fixture(scope="session", autouse=True)
def compilation_cache():
    """The folders that merlfit itself would use, so that tests and the programs which they start share them."""
    folder = Path(os.environ.get("MERLFIT_TEST_CACHE") or ROOT / ".pytest_cache" / "merlfit")
    os.environ["MERLFIT_CACHE_DIR"] = str(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture(autouse=True)
def shared_programs(compilation_cache):
    """A test that gives merlfit another cache folder takes it with it.

    JAX's keys of programs depend on the folder's name: all later tests would compile anew what is there.
    """
    folder = jax.config.jax_compilation_cache_dir
    yield
    jax.config.update("jax_compilation_cache_dir", folder)


@pytest.fixture(scope="module")
def compiled_quickly():
    """Half the time to compile, twice the time to run: for modules whose programs run a few times on few directions."""


@pytest.fixture(scope="module", autouse=True)
def programs(request):
    """Compiled quickly where a test of the module asks for it; programs are forgotten where that changes, or for room.

    A worker that has compiled for an hour must not run out of mappings of memory.
    """
    here = [item for item in request.session.items if item.path == request.path]
    hasty = any("compiled_quickly" in item.fixturenames for item in here)
    from merlfit.fitting.support.compilation import forget_programs, make_room  # not before the import hook

    if hasty != jax.config.read(HASTY):
        jax.config.update(HASTY, hasty)
        forget_programs()
    yield
    make_room()


@pytest.fixture(scope="session")
def make_merl():
    """The module that makes MERL files of the neural reconstructions, and their networks."""
    if not reconstructions.there():
        (pytest.fail if os.environ.get("CI") else pytest.skip)(reconstructions.ABSENT)
    return reconstructions.maker()


@pytest.fixture(scope="session")
def cases():
    """Folder of inputs of kinds that people met with other programs; its README says what is right for each."""
    folder = ROOT.parent / "shared" / "cases"
    if not folder.is_dir():
        said = f"the cases are absent: {Path('..', 'shared', 'cases')} beside the project holds them"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(said)
    return folder
