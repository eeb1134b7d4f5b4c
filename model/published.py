"""Published parameters of the rival models for the materials of MERL, and the models that they belong to."""

import difflib
import json
from collections.abc import Mapping
from functools import cache, partial
from importlib.resources import files
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from . import reflectance
from .geometry import Geometry
from .reflectance import Reflectance
from .rivals.abc_microfacet import ABCMicrofacet
from .rivals.common import LOEW_PAPER
from .rivals.cook_torrance import CookTorrance
from .rivals.he import He
from .rivals.sgd import ShiftedGamma
from .rivals.smooth import Smooth

LOEW = f"{LOEW_PAPER} (parameters of the E2 metric)"
NGAN = "Ngan, Durand & Matusik 2005, Experimental analysis of BRDF models, doi:10.5555/2383654.2383671"
BAGHER = ShiftedGamma.citation
# Ngan's tables hold the numbers of MERL's files before the files' own factors 1, 1.15 and 1.66 for R, G and B are
# applied: the median ratio of their diffuse albedos to Loew's is 0.98, 0.85, 0.58.
MERL_SCALE = (1.0, 1.15, 1.66)


class Source(NamedTuple):
    """A published table.

    Attributes:
        citation: where the numbers were printed.
        model: that they are parameters of.
        table: name of the file.
        channel_scale: what ``rescaled`` multiplies the albedos by.
    """

    citation: str
    model: Reflectance
    table: str
    channel_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


SOURCES: dict[str, Source] = {
    "sgd": Source(BAGHER, ShiftedGamma(), "bagher_sgd"),
    "smooth": Source(LOEW, Smooth(), "low_lowsmooth_E2"),
    "abc-microfacet": Source(LOEW, ABCMicrofacet(), "low_lowmicrofacet_E2"),
    "cook-torrance": Source(LOEW, CookTorrance("loew"), "low_cooktorrance_E2"),
    "cook-torrance-ngan": Source(NGAN, CookTorrance("ngan"), "ngan_cooktorrance", MERL_SCALE),
    "he": Source(NGAN, He(), "ngan_he", MERL_SCALE),
}


@cache
def _table(source: str) -> dict[str, dict[str, list]]:
    name = f"published_{SOURCES[source].table}.json"
    return json.loads((files(__name__.rpartition(".")[0]) / "data" / name).read_text(encoding="utf-8"))["materials"]


def _known(lack: str, name: str, names: tuple[str, ...]) -> None:
    """Raise KeyError, saying what is lacking and who has it, or a name like it, unless ``name`` is known."""
    if name in names:
        return
    if having := [source for source in SOURCES if name in _table(source)]:
        raise KeyError(f"{lack} {name!r}; of the other tables {', '.join(having)} {'have' if having[1:] else 'has'} it")
    if near := difflib.get_close_matches(name, names, n=1):
        raise KeyError(f"{lack} {name!r}; the nearest is {near[0]!r}")
    known = f"there are {', '.join(names)}" if len(names) <= len(SOURCES) else "nor one of a name like it"
    raise KeyError(f"{lack} {name!r}; {known}")


def materials(source: str = "sgd") -> tuple[str, ...]:
    """Names of the materials that a source has parameters for, sorted. KeyError: unknown source."""
    _known("there is no source of published parameters", source, tuple(SOURCES))
    return tuple(sorted(_table(source)))


def without_surface(source: str = "he") -> tuple[str, ...]:
    """Materials, sorted, whose published index is 1: there the Fresnel term is 0, and the model is Lambert's alone.

    Ngan's table of He's model prints eta = 1.00 for four materials, beside specular albedos of 1e5 to 2e9: an index
    just above 1, rounded away. The numbers are left as printed.

    Raises:
        KeyError: unknown source.
    """
    _known("there is no source of published parameters", source, tuple(SOURCES))
    if "eta" not in {q.name for q in SOURCES[source].model.parameters}:
        return ()
    return tuple(name for name in materials(source) if _table(source)[name]["eta"] == 1)


def published(material: str, source: str = "sgd", *, rescaled: bool = False) -> dict[str, np.ndarray]:
    """Published parameters of a material of MERL by name, for the model ``SOURCES[source].model``.

    The numbers are those printed, even where they leave a model no specular light (:func:`without_surface`). Names
    follow the models: SGD's ``eta`` is ``F0`` and ``F1``, Ngan's Cook-Torrance ``eta`` is ``F0``; SGD's ``K`` is no
    parameter, because it is what normalises the distribution, to the 5e-6 of its rounding.

    Args:
        material: MERL's name, such as ``blue-metallic-paint``.
        source: a key of ``SOURCES``.
        rescaled: multiply both albedos by ``SOURCES[source].channel_scale``, which puts Ngan's tables on the scale of
            MERL's reflectances and leaves the others as they are.

    Raises:
        KeyError: the material or the source is unknown; the message names the nearest known one.
    """
    _known(f"{source!r} has no material", material, materials(source))
    entry = {name: np.asarray(value, dtype=float) for name, value in _table(source)[material].items()}
    if source == "sgd":
        entry["F0"], entry["F1"] = entry.pop("eta")
        del entry["K"]
    if source == "cook-torrance-ngan":
        entry["F0"] = entry.pop("eta")
    if rescaled and "albedo" in entry:
        scale = np.asarray(SOURCES[source].channel_scale)
        entry |= {name: entry[name] * scale for name in ("diffuse_albedo", "albedo")}
    return entry


@partial(jax.jit, static_argnums=0)
def _compiled(model: Reflectance, values: Mapping[str, Array], geometry: Geometry) -> Array:
    return reflectance.evaluate(model, values, geometry)


def evaluate(material: str, source: str, geometry: Geometry, *, rescaled: bool = False) -> Array:
    """BRDF (1/sr) of a material with its published parameters, shape ``(3, *broadcast shape of geometry)``.

    Arguments and errors are those of :func:`published`; compiled once for each source and shape.
    """
    values = published(material, source, rescaled=rescaled)  # which refuses unknown names
    return _compiled(SOURCES[source].model, values, geometry)
