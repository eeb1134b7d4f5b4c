"""Settings as commands are given them; an error of theirs ends a command before it waits for jax."""

from pathlib import Path
from typing import Unpack

from ..settings.config import Config, ConfigError, Replaced, load
from ..support.terminal import fail


def settings_of(config: Path | None = None, **replaced: Unpack[Replaced]) -> Config:
    """Those of a file of settings with what the command line replaces in it."""
    try:
        return load(config, **replaced)
    except ConfigError as error:
        raise fail(str(error)) from None
