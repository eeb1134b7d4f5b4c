"""What is pictured: a result, the file that was fitted, and the draws of its posterior."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ...merl_io.binary import DIMS, Dims, Measurement, MerlError
from ...merl_io.grid import MerlGrid, merl_grid
from ...merl_io.inputs import Input
from ...merl_io.scattered import ScatteredMeasurement, half_difference, vectors_of
from ...scene.gridded import drawn, gridded
from ..fit.scattered_errors import LEAST_SHOWN, shown_by
from ..pipeline.draws import Chain, NoPicture, chain_file, states
from ..results.schema import Model, Result
from ..support.choices import THETA_MAX
from . import prediction
from .style import plain
from .terminal_tables import material_words

BETWEEN = "; the file as interpolated between its samples"
COLUMN_LETTERS = 62  # of 7 points, in 8.5 cm


@dataclass(frozen=True)
class Subject:
    """A fit to picture.

    Attributes:
        measurement: the file, of bins; of scattered directions interpolated, where they cover enough. scattered: these
            directions. chain: weighted draws from the posterior (`chain_file`). walkers: their states in free
            coordinates, (steps, walkers, P). lacks: why one of them is not there, by its name.
        titled: whether pictures say above them what they are of.
    """

    result: Result
    measurement: Measurement | None = None
    chain: Chain | None = None
    walkers: np.ndarray | None = None
    lacks: Mapping[str, str] = field(default_factory=dict)
    scattered: ScatteredMeasurement | None = None
    titled: bool = False

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
    def bins(self) -> Measurement:
        """The measurement, if it is one of bins and not interpolated."""
        if self.scattered is not None:
            raise NoPicture("the file holds scattered directions, and no bins")
        return self.file

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
        """The fit as the apparatus would have measured it, on folded bins, (C, H, D, P/2).

        Beside a file of scattered directions it is interpolated as the file is: from values in the file's directions.
        """
        if self.scattered is None or self.measurement is None:
            return prediction.all_bins(self.fitted, self.dims)
        return _half(
            on_bins(self.scattered, prediction.predicted_lobe(self.fitted, *vectors_of(self.scattered))).values
        )

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
        words = f" fit of {material_words(self.result.model.material)}" if self.result.model else ""
        if self.result.edited_from is not None:
            words += f", {self.result.edited_words}"
        between = BETWEEN if self.scattered is not None and self.measurement is not None else ""
        return plain(wrapped(f"{self.result.source.material}:{words}", f"data: {self.result.data_words}{between}"))

    def head(self, figure: Figure, more: str = "") -> None:
        """Say what a picture is of: above it if it is titled, and else in its metadata alone; above it ``more``."""
        figure.set_label(self.heading)
        lines = [*([self.heading] if self.titled else []), *([more] if more else [])]
        if lines:
            figure.suptitle("\n".join(lines))

    @property
    def channels(self) -> list[str]:
        """Names of the channels, to be written into pictures."""
        return [plain(name) for name in self.model.channels]


def wrapped(*said: str) -> str:
    """Lines that are no wider than a column."""
    return "\n".join(line for text in said for line in textwrap.wrap(text, COLUMN_LETTERS))


def on_bins(measured: ScatteredMeasurement, values: np.ndarray) -> Measurement:
    """Values (C, N) in the directions of a file, interpolated on bins (`scene.gridded`)."""
    if measured.between is not None:
        halves = drawn(measured.between, values)
    else:
        whole = measured.valid.all(0)
        angles = half_difference(*(x[whole] for x in (measured.theta_i, measured.theta_o, measured.phi)))
        halves = gridded(*angles, values[:, whole])
    found, valid = (np.concatenate([x, x[..., ::-1]], -1) for x in halves)
    return Measurement(measured.path, found, valid, 0, 0, 0, measured.sha1, measured.blob_sha1, measured.bands)


def _half(bins: np.ndarray) -> np.ndarray:
    return bins[..., : bins.shape[-1] // 2]


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
            scattered, measurement = found, on_bins(found, found.values)
            if (share := shown_by(_half(measurement.valid), result.theta_max or THETA_MAX)) < LEAST_SHOWN:
                lacks["measurement"] = f"its samples cover {share:.0%} of what a sphere shows, too little for pictures"
                measurement = None
    except MerlError as error:
        lacks["measurement"] = str(error)
    try:
        chain = chain_file(result, path)
    except NoPicture as error:
        lacks["chain"] = str(error)
    return Subject(result, measurement, chain, None if chain is None else states(result, path), lacks, scattered)
