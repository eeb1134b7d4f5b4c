"""The chain beside a result: its file, its draws, and the states of its walkers."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...merl_io.archive import arrays
from ...merl_io.source import opened
from ..results.schema import Result
from ..results.schema_posterior import sha1_of_draws
from ..settings.config import ConfigError, parse
from .models import layout_for

Chain = Mapping[str, np.ndarray]
DRAWN = "names", "values", "weights"
SAME = 1e-6  # in free coordinates: two fits of one model are farther apart


class NoPicture(ValueError):
    """A picture that cannot be drawn; the message says why."""


def chain_of(result: Path) -> Path:
    """File of the chain beside a result."""
    return result.with_name(f"{result.stem}.chain.npz")


def chain_file(result: Result, path: Path) -> dict[str, np.ndarray]:
    """Names, weighted draws (physical values) and weights of the posterior, from the chain beside the result.

    Args:
        path: of the result. Where the chain has another name than the result says, which a JSON cannot if it is no
            UTF-8, that of the result's own file counts.

    Raises:
        NoPicture: it was not sampled, or its chain is missing or of another fit.
    """
    path = _place(result, path)
    try:
        with opened(path, NoPicture) as (file, _):
            read = arrays(file, (*DRAWN, "fit_free", "log_likelihood").__contains__, texts=("names",))
        found, started = {name: read[name] for name in DRAWN}, read.get("fit_free")
        found |= {name: read[name] for name in ("log_likelihood",) if name in read}
    except NoPicture:
        raise
    except (ValueError, KeyError):
        raise NoPicture(f"{path}: cannot be read (it is damaged, or no finished chain)") from None
    if [str(n) for n in found["names"]] != [q.name for q in result.parameters]:
        raise NoPicture(f"{path}: is the chain of another fit")
    count, size = len(found["weights"].ravel()), len(result.parameters)
    if found["values"].shape != (count, size) or not all(np.isfinite(found[k]).all() for k in ("values", "weights")):
        raise NoPicture(f"{path}: is damaged: its draws are not {size} finite numbers each")
    if not _is_of(result, found, started):
        raise NoPicture(f"{path}: is the chain of another fit, or went on after this one; `merlfit sample` mends that")
    return found


def _is_of(result: Result, draws: Chain, started: np.ndarray | None) -> bool:
    """Whether draws are those that a result tells of; before version 2.3 it only says where the chain began."""
    assert result.posterior is not None
    if (told := result.posterior.draws_sha1) is not None:
        return told == sha1_of_draws(draws["values"], draws["weights"].ravel())
    return started is None or _began_at(result, started)


def own_chain(result: Result, path: Path) -> Path | None:
    """File of the chain that belongs to a result, finished or not; None where there is none, or one of another fit."""
    try:
        if result.posterior is not None:
            chain_file(result, path)
            return _place(result, path)
        with opened(chain_of(path), NoPicture) as (file, _):
            started = arrays(file, "fit_free".__eq__)["fit_free"]
    except (ValueError, KeyError):
        return None
    return chain_of(path) if result.fit.succeeded and _began_at(result, started) else None


def _began_at(result: Result, started: np.ndarray) -> bool:
    """Whether a chain began where a fit ended; yes, where that cannot be known."""
    if result.model is None:
        return True
    try:
        layout = layout_for(parse(result.config, result.source.material), result.model.measured, result.model.bands)
    except ConfigError:  # of an older version
        return True
    free = layout.free(result.values())
    return started.shape == free.shape and np.allclose(started, free, atol=SAME)


def states(result: Result, path: Path) -> np.ndarray | None:
    """All states of the walkers in free coordinates, (steps, walkers, P); None if the chain cannot be read."""
    try:
        with opened(_place(result, path), NoPicture) as (file, _):
            found = arrays(file, "chain_free".__eq__)["chain_free"]
    except (ValueError, KeyError):
        return None
    free = sum(q.fitted == "free" for q in result.parameters)
    whole = found.ndim == 3 and found.shape[2] == free and np.isfinite(found).all()
    return found if whole else None


def _place(result: Result, path: Path) -> Path:
    if result.posterior is None:
        raise NoPicture("the posterior was not sampled")
    named = path.parent / Path(result.posterior.chain_file).name
    return named if named.is_file() or not chain_of(path).is_file() else chain_of(path)
