"""Units fitted together on a GPU; their errors, results and posteriors are computed and written by the CPU."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import jax

from ...merl_io import inputs
from ...merl_io.binary import MerlError
from ...merl_io.samples import Samples
from ..fit.stacked import AT_ONCE
from ..fit.weights import weighted_samples
from ..pipeline.search import too_dark
from ..pipeline.together import Prepared, fit_together, on_cpu, prepare
from ..settings.config import Config
from ..settings.sections import AUTO
from ..support.choices import Device
from ..support.compilation import use_persistent_cache
from ..support.terminal import note
from .here import Here
from .pool import Pool
from .unit import Ended, Unit

MOST = 100  # files of one batch, 15 MB each while they wait


def not_offered(settings: Config) -> str:
    """What of the settings is not offered for files together, in words; empty if all is."""
    if settings.model.name == AUTO:
        return "model auto, which adds lobes file by file"
    if len(settings.exponents) > 1:
        return f"weights {settings.fit.weights}, which go on file by file"
    return "" if settings.fit.backend == "trust-region" else f"backend {settings.fit.backend}"


class Gpu:
    """As `pool.Pool`, with the fits of all units made together beforehand.

    Units that cannot be fitted together (bad files, scattered directions) are fitted by ``rest`` as always.

    Attributes:
        device: of JAX's, on which fits are made. rest: where errors are computed and results written.
        at_once: directions that a step may take.
    """

    name = "Gpu"

    def __init__(self, device: Device, rest: Here | Pool, at_once: int = AT_ONCE) -> None:
        self.device, self.rest, self.at_once = device, rest, at_once
        self._begun = 0

    def ended(self, units: Sequence[Unit], tell: Callable[[int, str], None]) -> Iterator[tuple[int, Ended]]:
        """Number of a unit and what came of it, as they end."""
        use_persistent_cache()
        os.environ["JAX_PLATFORMS"] = "cpu"  # of processes that begin from now on
        for self._begun in range(0, len(units), MOST):
            told = lambda k, stage, begun=self._begun: tell(begun + k, stage)  # noqa: E731
            some = self._fitted(units[self._begun : self._begun + MOST], told)
            for k, ended in self.rest.ended(some, told):
                yield self._begun + k, ended

    def stop(self) -> list[tuple[int, Ended]]:
        """As of ``rest``."""
        return [(self._begun + k, ended) for k, ended in self.rest.stop()]

    def _fitted(self, units: Sequence[Unit], tell: Callable[[int, str], None]) -> list[Unit]:
        """The same units with their fits."""
        for k in range(len(units)):
            tell(k, "reading")
        ready = dict(enumerate(on_cpu(_prepared, units)))
        alike: dict[Any, list[int]] = {}
        for k, each in ready.items():
            if each is not None:
                alike.setdefault((each.few.bands, each.whole.root.shape, each.coarse.root.shape), []).append(k)
        found = {}
        for rows in alike.values():
            for k in rows:
                tell(k, f"together with {len(rows) - 1} others on {self.device.device_kind}")
            try:
                fits = fit_together([ready[k] for k in rows], units[0].settings, self.device, self.at_once)  # pyright: ignore[reportArgumentType] - none is None
            except jax.errors.JaxRuntimeError as error:
                said = str(error).splitlines()[0]
                note(f"{self.device.device_kind}: {said}; the files are fitted one by one on the CPU")
            else:
                found |= dict(zip(rows, fits, strict=True))
        return [replace(unit, found=found.get(k)) for k, unit in enumerate(units)]


def _prepared(unit: Unit) -> Prepared | None:
    """A file as a batch wants it; None of one that is to be fitted, or refused, by itself."""
    settings = unit.settings
    try:
        measurement = inputs.read(unit.path, dims=settings.input.allowed, quantity=settings.input.quantity)
        samples = weighted_samples(measurement, settings.exponents[0], settings.fit.theta_max)
    except (MerlError, OSError):
        return None
    if not isinstance(samples, Samples) or too_dark(samples):
        return None
    return prepare(samples, settings, measurement.sha1)
