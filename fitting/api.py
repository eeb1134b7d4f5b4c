"""merlfit from Python: what ``import merlfit`` offers (``main/__init__.py`` names it there)."""

import os
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from ..merl_io import inputs
from ..merl_io.atomic import refused
from ..merl_io.inputs import Input
from .fit_object import Fit
from .pipeline.place import claimed, place_of
from .pipeline.run import fit_file
from .results.storage import read_result
from .settings.config import load as settings_of
from .settings.config import parameters_of
from .support.clock import Report, silent
from .support.compilation import use_cache


def fit(
    file: str | os.PathLike[str] | Mapping[str, ArrayLike] | Input,
    out: str | os.PathLike[str] | None = None,
    settings: Mapping[str, Any] | str | os.PathLike[str] | None = None,
    *,
    model: str | list[str] | None = None,
    index: str | None = None,
    body: str | None = None,
    preset: str | None = None,
    weights: str | None = None,
    posterior: bool | None = None,
    seed: int | None = None,
    fix: Mapping[str, ArrayLike] | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    start: Mapping[str, float] | None = None,
    tie: Iterable[str] = (),
    dims: str | None = None,
    origin: str | None = None,
    quantity: str | None = None,
    name: str = "table",
    report: Report = silent,
) -> Fit:
    """Fit a measurement, as `merlfit fit` does.

    Compiled programs are kept in merlfit's cache folder, unless ``jax_compilation_cache_dir`` is set already.

    Args:
        file: its path, a table as arrays by name, or what :func:`read` made of either.
        out: folder for the result; without it, the result lasts as long as the object, or what :meth:`Fit.sample` made
            of it: :meth:`Fit.save` keeps it.
        settings: a TOML file like configs/default.toml, or the same as a mapping.
        model: two-scale by default; of several, the one that describes the file best is taken (docs/rivals.md).
        index: auto, real (a dielectric) or complex (a conductor). body: what lies under the surface: auto, none,
            lambert, plastic or subsurface. preset: of effects: hp17, conserving, microfacet, preview or fast
            (docs/effects.md).
        weights: compressive, log, none or adaptive (docs/fitting.md).
        posterior: whether to sample it; :meth:`Fit.sample` does so later. seed: of the sampler.
        fix: parameters by name that are not fitted, with their value, or one for each channel; variants without them
            are left out, so that a fixed ``eta`` leaves dielectrics. bounds: lower and upper ones within the model's,
            None for its own. start: values where the first fit starts. tie: parameters with one value for all channels.
            ``settings`` know priors of single parameters as well (docs/fitting.md).
        dims: allow other sizes of a MERL file's grid. origin: what data these are, in words that outputs repeat.
            quantity: what the values of a table are: brdf, brdf_cos or reflectance_factor (docs/howto/fit.md).
            All of these replace what ``settings`` say, and are the options of `merlfit fit`.
        name: of the material, of arrays; a file's is that of the file.
        report: called with a few words on what is being done, ``print`` for instance.

    Raises:
        merlfit.MerlError: the file cannot be used.
        merlfit.ConfigError: bad settings.
        merlfit.WriteError: ``out`` cannot be written, or a command is writing there.
        RuntimeError: the sampler failed; the message names the file that holds the fit.
    """
    config = settings_of(
        settings, dims=dims, origin=origin, quantity=quantity, model=model, preset=preset, index=index,
        body=body, weights=weights, posterior=posterior, seed=seed, parameters=parameters_of(fix, bounds, start, tie),
    )  # fmt: skip
    if config.posterior.enabled == "auto":
        config = replace(config, posterior=replace(config.posterior, enabled=False))
    use_cache()
    path = Path(file).absolute() if isinstance(file, str | os.PathLike) else file
    measurement = (
        inputs.read(path, dims=config.input.allowed, name=name, quantity=config.input.quantity)
        if isinstance(path, Path | Mapping)
        else path
    )
    folder, place = Path(tempfile.mkdtemp(prefix="merlfit-")) if out is None else Path(out), None
    with refused(folder, "made"):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with claimed(folder, alone=False), place_of(folder, measurement.name, alone=False) as place:
            result = fit_file(measurement, place.folder, config, report)
    except BaseException as error:  # raised again
        if out is None and not any(folder.iterdir()):
            folder.rmdir()
        if isinstance(error, RuntimeError) and place is not None:  # it names the file where that was, not where it is
            raise RuntimeError(str(error).replace(str(place.folder), str(place.path.parent))) from error
        raise
    if place.said:
        warnings.warn(place.said, stacklevel=2)
    found = Fit(result, place.path, measurement)
    if out is None:
        found._folder = _Kept()
        weakref.finalize(found._folder, shutil.rmtree, folder, ignore_errors=True)
    return found


class _Kept:
    """A folder, for as long as somebody has this."""


def load(path: str | os.PathLike[str]) -> Fit:
    """A result that `merlfit fit`, :func:`fit` or :meth:`Fit.to_json` wrote.

    Raises:
        merlfit.ResultError: it is none.
    """
    return Fit(read_result(path), Path(path))


def sample(result: str | os.PathLike[str] | Fit, max_steps: int | None = None, report: Report = silent) -> Fit:
    """:meth:`Fit.sample` of a fit or of a result in a file."""
    return (result if isinstance(result, Fit) else load(result)).sample(max_steps, report)
