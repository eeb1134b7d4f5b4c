"""Tables of RGL's kind of a material, and scenes by which Mitsuba 3 and pbrt-v4 draw them without a plugin of ours."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from xml.sax.saxutils import quoteattr

import equinox as eqx
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ...merl_io import rgl_writer
from ...merl_io.atomic import write_text
from ...merl_io.bands import MERL, Bands
from ...merl_io.rgl import OURS
from ...model.geometry import Geometry
from ...scene.colour import REFLECTANCE_NM, reflectances, weights_of
from ...scene.gridded import GRID, drawn
from ...scene.spheres import distances
from ...scene.surface import Material
from ..pipeline.synthesis import tabulate
from .mitsuba_files import SCENE
from .xml_text import comment, word

PART = 2**16  # directions that are evaluated at once: one program
PBRT = """# {said}
Scale -1 1 1  # its axes are left-handed
LookAt 0 0 6  0 0 0  0 1 0
Camera "perspective" "float fov" 20
Film "rgb" "integer xresolution" 256 "integer yresolution" 256 "string filename" "picture.exr"
Sampler "zsobol" "integer pixelsamples" 64
Integrator "path"
WorldBegin
LightSource "infinite" "rgb L" [ 0.3 0.3 0.3 ]
LightSource "distant" "point3 from" [ 0.45 0.55 0.7 ] "point3 to" [ 0 0 0 ] "rgb L" [ 2 2 2 ]
Material "measured" "string filename" {table}
Shape "sphere"
"""


def targets_of(name: str, out: Path) -> list[Path]:
    """What `to_rgl` writes."""
    return [*(out / f"{word(name)}_{kind}.bsdf" for kind in ("rgb", "spec")), out / f"{name}.rgl.xml",
            out / f"{name}.rgl.pbrt"]  # fmt: skip


def to_rgl(name: str, material: Material, said: str, out: Path) -> tuple[list[Path], str]:
    """Tables for renderers of three channels and for spectral ones, and scenes for them.

    Returns:
        and how far spheres that a table gives are from the material's, in words.
    """
    rgb, spec, mitsuba, pbrt = written = targets_of(name, out)
    parts = rgl_writer.fields(lambda i, o: _evaluated(material, i, o))
    colours = rgl_writer.coloured(parts, weights_of(material.bands))
    what = f"spheres drawn of this table differ by a mean CIELAB distance of {_apart(parts, colours, material):.2f}"
    whole = f"{said}, {OURS}{version('merlfit')}: {what}"
    rgl_writer.write(rgb, parts, colours, whole)
    weights, nm = _spectral(material.bands)
    rgl_writer.write(spec, parts, rgl_writer.coloured(parts, weights), whole, nm)
    render = f"mitsuba THIS.xml, or mitsuba -m llvm_ad_spectral -D table={spec.name} THIS.xml"
    bsdf = '<bsdf type="measured"><string name="filename" value="$table"/></bsdf>'
    table = f'<default name="table" value={quoteattr(rgb.name)}/>\n    '
    scene = SCENE.format(said=comment(f"{whole}. Render this file: {render}"), bsdf=bsdf)
    write_text(mitsuba, scene.replace("<integrator", f"{table}<integrator", 1))
    quoted = '"' + spec.name.replace("\\", "\\\\").replace('"', '\\"') + '"'
    write_text(pbrt, PBRT.format(said=comment(f"{whole}. Render this file: pbrt THIS.pbrt"), table=quoted))
    return written, what


def _spectral(bands: Bands) -> tuple[np.ndarray, np.ndarray]:
    """What each band adds at which wavelengths (nm), (K, C) and (K,): themselves, or what R, G and B may be of."""
    if set(bands.names) == set(MERL.names):
        return reflectances().T @ weights_of(bands), REFLECTANCE_NM
    order = np.argsort(bands.wavelengths_um)
    return np.eye(len(bands))[order], 1e3 * np.array(bands.wavelengths_um)[order]


def _evaluated(material: Material, i: np.ndarray, o: np.ndarray) -> np.ndarray:
    """BRDF by band (1/sr), (C, N), for unit vectors of light and viewer (N, 3)."""
    count = len(o)
    i, o = (np.concatenate([x, np.repeat(x[:1], -count % PART, 0)]) for x in (i, o))
    parts = [np.asarray(_by_band(material, i[k : k + PART], o[k : k + PART])) for k in range(0, len(o), PART)]
    return np.concatenate(parts, -1)[:, :count]


@eqx.filter_jit
def _by_band(material: Material, i: ArrayLike, o: ArrayLike) -> Array:
    return material.by_band(Geometry.from_vectors(i, o))


def _apart(parts: Mapping[str, np.ndarray], colours: np.ndarray, material: Material) -> float:
    """Mean CIELAB distance of spheres of a table, as renderers draw it, and of the material."""
    ours, half = tabulate(material.brdf, GRID), GRID[2] // 2
    mean = (ours[..., :half] + ours[..., : half - 1 : -1]) / 2
    theirs, valid = drawn(*rgl_writer.samples(parts, colours))
    return distances(mean, theirs, valid & np.isfinite(mean).all(0))[0]
