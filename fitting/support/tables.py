"""The table of ``diffraction = "scaled"`` on disk: computed when it is first asked for, then read."""

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...merl_io.archive import arrays
from ...merl_io.atomic import write_atomically
from ...merl_io.source import opened
from ...model import chebyshev, convolution, numerics, quadrature, scaled
from ...model.ndf import epd

MAKERS = (scaled, convolution, chebyshev, epd, numerics, quadrature)


def keep_in(folder: Path | None) -> None:
    """Keep the table in this folder, which is made if needed; None: in memory only.

    Where the folder cannot be written the table is made anew by every process, with a warning.
    """

    def keep(build: Callable[[], np.ndarray]) -> np.ndarray:
        assert folder is not None
        path = folder / file_name()
        values = stored(path)
        if values is None:
            values = build()
            try:
                folder.mkdir(parents=True, exist_ok=True)
                write_atomically(path, lambda file: np.savez(file, table=values))
            except OSError as error:
                warnings.warn(f"{folder}: the table of the scaled lobe cannot be kept there ({error})", stacklevel=2)
        return values

    scaled.keep_by(None if folder is None else keep)


def file_name() -> str:
    """Name with a hash of the code that makes the table: what other code has made is never read."""
    code = b"".join(Path(str(module.__file__)).read_bytes() for module in MAKERS)
    return f"scaled-{hashlib.sha256(code).hexdigest()[:16]}.npz"


def stored(path: Path) -> np.ndarray | None:
    """The table in this file, or None where there is no sound one, which is then made anew."""
    try:
        with opened(path) as (file, _):
            found = arrays(file, "table".__eq__)["table"]
    except (ValueError, KeyError):
        return None
    return found if found.shape == (2, *scaled.NODES) and np.all(np.isfinite(found)) else None
