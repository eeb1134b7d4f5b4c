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
    """Names, weighted draws (physical values), weights and log likelihoods of the posterior, from the chain beside it.

    Args:
        path: of the result. Where the chain has another name than the result says, which a JSON cannot if it is no
            UTF-8, that of the result's own file counts.

    Raises:
        NoPicture: it was not sampled, or its chain is missing or of another fit.
    """
    path = _place(result, path)
    try:
        with opened(path, NoPicture) as (file, _):
            read = arrays(file, (*DRAWN, "log_likelihood").__contains__, texts=("names",))
        found = {name: read[name] for name in DRAWN} | read
    except NoPicture:
        raise
    except (ValueError, KeyError):
        raise NoPicture(f"{path}: cannot be read (it is damaged, or no finished chain)") from None
    if [str(n) for n in found["names"]] != [q.name for q in result.parameters]:
        raise NoPicture(f"{path}: is the chain of another fit")
    count, size = len(found["weights"].ravel()), len(result.parameters)
    if found["values"].shape != (count, size) or not all(np.isfinite(found[k]).all() for k in ("values", "weights")):
        raise NoPicture(f"{path}: is damaged: its draws are not {size} finite numbers each")
    if result.posterior is None or result.posterior.draws_sha1 != sha1_of_draws(found["values"], found["weights"]):
        raise NoPicture(f"{path}: is the chain of another fit, or went on after this one; `merlfit sample` mends that")
    return found


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
    if result.model is None or not result.fit.succeeded:
        return None
    try:
        layout = layout_for(parse(result.config, result.source.material), result.model.measured, result.model.bands)
    except ConfigError:  # settings that were changed by hand
        return None
    free = layout.free(result.values())
    return chain_of(path) if started.shape == free.shape and np.allclose(started, free, atol=SAME) else None


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
        raise NoPicture("an edited material has none" if result.edited_from else "the posterior was not sampled")
    named = path.parent / Path(result.posterior.chain_file).name
    return named if named.is_file() or not chain_of(path).is_file() else chain_of(path)
