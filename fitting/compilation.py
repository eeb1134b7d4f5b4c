"""Where compiled programs are kept between runs."""

import os
from pathlib import Path

import jax
import platformdirs


def use_persistent_cache() -> Path:
    """Keep compiled programs in the user's cache folder (or ``MERLFIT_CACHE_DIR``): only the first run waits."""
    folder = Path(os.environ.get("MERLFIT_CACHE_DIR") or platformdirs.user_cache_dir("merlfit")) / "xla"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return folder
