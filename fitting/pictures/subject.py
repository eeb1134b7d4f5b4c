"""What is pictured: a result, the file that was fitted, and the draws of its posterior."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ...merl_io.archive import arrays
from ...merl_io.binary import DIMS, Dims, Measurement, MerlError
from ...merl_io.grid import MerlGrid, merl_grid
from ...merl_io.inputs import Input
from ...merl_io.scattered import ScatteredMeasurement
from ...merl_io.source import opened
from ..objective.weights import THETA_MAX
from ..pipeline.run import chain_of
from ..results.posterior import sha1_of_draws
from ..results.schema import Model, Result
from ..settings.config import ConfigError, parse
from ..settings.models import layout_for
from . import prediction
from .style import plain

Chain = Mapping[str, np.ndarray]
SAME = 1e-6  # in free coordinates: two fits of one model are farther apart
COLUMN_LETTERS = 62  # of 7 points, in 8.5 cm


class NoPicture(ValueError):
    """A picture that cannot be drawn; the message says why."""


@dataclass(frozen=True)
class Subject:
    """A fit to picture.

    Attributes:
        measurement: the file, of bins; or scattered: the file, of scattered directions. chain: weighted draws from the
            posterior (`chain_file`). walkers: their states in free coordinates, (steps, walkers, P). lacks: why one of
            them is not there, by its name.
    """

    result: Result
    measurement: Measurement | None = None
    chain: Chain | None = None
    walkers: np.ndarray | None = None
    lacks: Mapping[str, str] = field(default_factory=dict)
    scattered: ScatteredMeasurement | None = None

    @property
    def model(self) -> Model:
        """What was fitted; NoPicture if the fit failed."""
        if self.result.model is None:
            raise NoPicture(f"the fit ended {self.result.fit.status}")
        return self.result.model

    @property
    def file(self) -> Measurement:
        """The measurement; NoPicture if it is not there."""
        if self.measurement is None:
            raise NoPicture(self.lacks.get("measurement", "there is no file to compare with"))
        return self.measurement

    @property
    def draws(self) -> Chain:
        """The draws, whether there are enough of them or not; NoPicture if there are none."""
        if self.chain is None:
            raise NoPicture(self.lacks.get("chain", "the posterior was not sampled"))
        return self.chain

    @property
    def trusted(self) -> Chain | None:
        """The draws, if they are good enough for intervals."""
        sufficient = self.result.posterior is not None and self.result.posterior.sufficient
        return self.chain if sufficient else None

    @cached_property
    def values(self) -> dict:
        """Of the parameters, as the model takes them."""
        return self.result.values()

    @cached_property
    def fitted(self) -> prediction.Fitted:
        """The material, with tables for all directions of all pictures."""
        return prediction.Fitted.tabled(self.model, self.values)

    @cached_property
    def likely(self) -> prediction.Fitted | None:
        """The same of draws of the posterior, if they are good enough for intervals."""
        return None if self.trusted is None else prediction.draws_of(self.result, self.trusted)

    @property
    def dims(self) -> Dims:
        """Of the file, or MERL's where there is none."""
        return DIMS if self.measurement is None else self.measurement.dims

    @property
    def grid(self) -> MerlGrid:
        """Of the file, or MERL's where there is none."""
        return merl_grid(self.dims)

    @cached_property
    def predicted(self) -> np.ndarray:
        """The fit as the apparatus would have measured it, on folded bins, (C, H, D, P/2)."""
        return prediction.all_bins(self.fitted, self.dims)

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """What each lobe and the body add to the material, without the apparatus, on folded bins (C, H, D, P/2)."""
        return prediction.parts_of_all_bins(self.fitted, self.dims)

    @property
    def theta_max(self) -> float:
        """Up to which angle (rad) the file was fitted."""
        return self.result.theta_max or THETA_MAX

    @property
    def heading(self) -> str:
        """Material, model and what the data are, for over a picture."""
        words = f" fit of {self.result.model.material.words}" if self.result.model else ""
        return plain(wrapped(f"{self.result.source.material}:{words}", f"data: {self.result.data_words}"))

    @property
    def channels(self) -> list[str]:
        """Names of the channels, to be written into pictures."""
        return [plain(name) for name in self.model.channels]


def wrapped(*said: str) -> str:
    """Lines that are no wider than a column."""
    return "\n".join(line for text in said for line in textwrap.wrap(text, COLUMN_LETTERS))


def subject_of(result: Result, path: Path, file: Path | Input) -> Subject:
    """A fit to picture with all that can be read of it.

    Args:
        path: of the result. file: that was fitted, or what was read of it.
    """
    measurement, scattered, chain, lacks = None, None, None, {}
    try:
        found = result.source.read(file) if isinstance(file, Path) else file
        if isinstance(found, Measurement):
            measurement = found
        else:
            scattered, lacks["measurement"] = found, "it holds scattered directions"
    except MerlError as error:
        lacks["measurement"] = str(error)
    try:
        chain = chain_file(result, path)
    except NoPicture as error:
        lacks["chain"] = str(error)
    return Subject(result, measurement, chain, None if chain is None else states(result, path), lacks, scattered)


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
            read = arrays(file, ("names", "values", "weights", "fit_free").__contains__, texts=("names",))
        found, started = {name: read[name] for name in ("names", "values", "weights")}, read.get("fit_free")
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
    whole = found.ndim == 3 and found.shape[2] == len(result.parameters) and np.isfinite(found).all()
    return found if whole else None


def _place(result: Result, path: Path) -> Path:
    if result.posterior is None:
        raise NoPicture("the posterior was not sampled")
    named = path.parent / Path(result.posterior.chain_file).name
    return named if named.is_file() or not chain_of(path).is_file() else chain_of(path)
