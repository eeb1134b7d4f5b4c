"""`merlfit synth`: MERL files without a measurement, tabulated from published parameter sets or from a fit."""

from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from ...merl_io.binary import DIMS, Dims, write
from ...merl_io.grid import merl_grid
from ...model import published
from ...model.geometry import Geometry
from ...model.reflectance import evaluate
from ...scene.colour import coloured
from ..results.schema import Result
from ..results.storage import ResultError, read_result
from ..support.compilation import use_persistent_cache
from ..support.outputs import refuse_present
from ..support.terminal import console, fail
from .editing import edited

ROWS = 10  # of theta_h evaluated at a time
WITHOUT_SURFACE = "index printed as 1.00, so that the Fresnel term and with it all specular light are 0"


def synthesise(
    material: str, out: Path, source: str | None, loss: bool, changes: Mapping[str, ArrayLike], force: bool
) -> None:
    """Write a MERL file of a published material or of a result, over another file only if that is asked for.

    Args:
        changes: values of the result's parameters to set.
    """
    fitted = material.endswith(".json")
    if fitted and source is not None:
        raise fail(f"--source names a published table; {material} is a fit: leave it out")
    if loss and not fitted:
        raise fail(f"--with-grazing-loss is for the RESULT.json of a fit; {material} is none: leave it out")
    if changes and not fitted:
        raise fail(f"--set is for the RESULT.json of a fit; {material} is none: leave it out")
    refuse_present(out, force)
    use_persistent_cache()
    try:
        values, said = (
            from_result(path := Path(material), edited(path, read_result(path), changes), loss)
            if fitted
            else from_published(material, source or "sgd")
        )
    except KeyError as error:
        raise fail(error.args[0]) from None
    write(out, values)
    console.print(f"{out}: {said}")


def tabulate(evaluate: Callable[[Geometry], Array], dims: Dims = DIMS) -> np.ndarray:
    """BRDF on MERL's grid (3, 90, 90, 180), or on one of other dims, 1/sr; NaN below the horizon."""
    grid = merl_grid(dims)
    compiled = jax.jit(lambda *angles: evaluate(Geometry.from_half_difference(*angles)))
    parts = [
        np.asarray(compiled(grid.theta_h[rows, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :]))
        for rows in np.array_split(np.arange(len(grid.theta_h)), -(-len(grid.theta_h) // ROWS))
    ]
    return np.where(grid.above, np.concatenate(parts, 1), np.nan)


def from_published(material: str, source: str) -> tuple[np.ndarray, str]:
    """A published parameter set, and in words what it is; of one that has lost its specular part, that it has.

    Raises:
        KeyError: unknown material or source; the message names the nearest known one.
    """
    values = tabulate(lambda g: published.evaluate(material, source, g, rescaled=True))
    table = published.SOURCES[source]
    rescaled = f", albedos times {table.channel_scale} (R, G, B)" if set(table.channel_scale) != {1.0} else ""
    said = f"synthetic MERL file of {material}, from published parameters: {table.citation}{rescaled}"
    if material in published.without_surface(source):
        said += f"; {WITHOUT_SURFACE}: the file is of a diffuse material"
    return values, said


def from_result(path: Path, result: Result, grazing_loss: bool = False) -> tuple[np.ndarray, str]:
    """A fitted material, and in words what it is; R, G and B of other bands are what is seen (`scene.colour`).

    Args:
        path: of the result, for errors.
        grazing_loss: as MERL's apparatus would have measured it, which loses light at grazing angles; otherwise the
            material itself, which is brighter there than the file that was fitted.

    Raises:
        ResultError: the fit failed.
    """
    if result.model is None:
        raise ResultError(f"{path}: the fit failed ({result.fit.status}), it has no material to tabulate")
    m, params = result.model, result.values()
    model = m.measured if grazing_loss else m.material
    values = np.maximum(tabulate(lambda g: coloured(evaluate(model, params, g, m.wavelengths_um), m.bands)), 0.0)
    edit = f", {result.edited_words}" if result.edited_from else ""
    said = f"synthetic MERL file from the {m.name} fit of {result.source.material}{edit}"
    if not m.measured.loses:
        return values, said
    if grazing_loss:
        return values, f"{said}, with the grazing loss of MERL's apparatus, as the file that was fitted has it"
    return values, (
        f"{said}, the material alone: near grazing angles many times brighter than the file that was fitted, which "
        "lacks light that MERL's apparatus lost there; --with-grazing-loss writes it as measured"
    )


def describe_sources() -> str:
    """The published tables, which materials they lack and of which they print no specular part."""
    every = set().union(*map(published.materials, published.SOURCES))
    lines = [f"{len(every)} materials: {', '.join(sorted(every))}"]
    for name, s in published.SOURCES.items():
        missing = sorted(every - set(published.materials(name)))
        line = f"{name}: {s.citation}; " + (f"lacks {', '.join(missing)}" if missing else "all materials")
        if flat := published.without_surface(name):
            line += f"; diffuse alone: {', '.join(flat)} ({WITHOUT_SURFACE})"
        lines.append(line)
    return "\n".join(lines)
