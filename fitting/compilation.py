"""Where compiled programs and tables are kept between runs."""

import os
from pathlib import Path

import jax
import platformdirs

from . import tables


def cache_folder() -> Path:
    """The user's cache folder, or ``MERLFIT_CACHE_DIR``."""
    return Path(os.environ.get("MERLFIT_CACHE_DIR") or platformdirs.user_cache_dir("merlfit"))


def use_persistent_cache() -> Path:
    """Keep compiled programs in the cache folder: only the first run waits.

    So with the table of ``diffraction = "scaled"``, which is computed when it is first asked for.
    """
    cache = cache_folder()
    folder = cache / "xla"
    tables.keep_in(cache)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return folder
