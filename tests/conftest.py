"""Shared by all tests: compiled programs are cached, runtime type checks are on, data of the reconstructions."""

import os
from pathlib import Path

# XLA's older CPU emitters compile in half the time (CONTRIBUTING.md, compile times); before jax makes its backend
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

import jax
import pytest
import reconstructions
from jaxtyping import install_import_hook

install_import_hook(["merlfit.model", "merlfit.merl_io"], "beartype.beartype")

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session", autouse=True)
def compilation_cache(tmp_path_factory):
    folder = os.environ.get("MERLFIT_TEST_CACHE") or str(ROOT / ".pytest_cache" / "xla")
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    os.environ["MERLFIT_CACHE_DIR"] = folder


@pytest.fixture(scope="module", autouse=True)
def room_for_programs():
    """A worker that has compiled for an hour must not run out of mappings of memory."""
    yield
    from merlfit.fitting.support.compilation import make_room  # not before the import hook

    make_room()


@pytest.fixture(scope="module")
def compiled_quickly():
    """Programs that are run a few times on a few directions: half the time to compile, twice the time to run."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", before)
    jax.clear_caches()  # what was compiled so is not for others


@pytest.fixture(scope="session")
def make_merl():
    """The module that makes MERL files of the neural reconstructions, and their networks."""
    if not reconstructions.there():
        (pytest.fail if os.environ.get("CI") else pytest.skip)(reconstructions.ABSENT)
    return reconstructions.maker()


@pytest.fixture(scope="module")
def table(compilation_cache):
    """The real table, kept with the compiled programs; its name changes with the code that makes it."""
    from merlfit.fitting.support import tables  # not before the import hook
    from merlfit.model import scaled

    before = scaled._keep
    tables.keep_in(Path(os.environ["MERLFIT_CACHE_DIR"]))
    quickly = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)  # half a minute of computing
    found = scaled.table()
    jax.config.update("jax_disable_most_optimizations", quickly)
    yield found
    scaled.keep_by(before)
