"""Shared by all tests: compiled programs are cached, runtime type checks are on, data of the reconstructions."""

import importlib.util
import os
import sys
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

install_import_hook(["merlfit.model", "merlfit.merl_io"], "beartype.beartype")

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def compilation_cache(tmp_path_factory):
    folder = os.environ.get("MERLFIT_TEST_CACHE") or str(ROOT / ".pytest_cache" / "xla")
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    os.environ["MERLFIT_CACHE_DIR"] = folder


@pytest.fixture(scope="session")
def reconstructions():
    """The module that makes MERL files of the neural reconstructions, and their networks."""
    if not (DATA / "merl_networks.npz").is_file():
        if os.environ.get("CI"):
            pytest.fail("the neural reconstructions are required in CI: ../shared/data is absent")
        pytest.skip("needs the neural reconstructions in ../shared/data")
    spec = importlib.util.spec_from_file_location("make_merl", DATA / "make_merl.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_merl"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table(compilation_cache):
    """The real table, kept with the compiled programs; its name changes with the code that makes it."""
    from merlfit.fitting import tables  # not before the import hook
    from merlfit.model import scaled

    before = scaled._keep
    tables.keep_in(Path(os.environ["MERLFIT_CACHE_DIR"]))
    yield scaled.table()
    scaled.keep_by(before)
