"""Materials for other programs: renderers, MERL files, plain parameters, the nearest GGX, optical design programs."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_args

from numpy.typing import ArrayLike
from rich.table import Table

from ...merl_io.atomic import write_text
from ...merl_io.bands import MERL
from ...merl_io.binary import read, write
from ...merl_io.samples import folded
from ...scene.description import SceneError
from ...scene.surface import Material, measurement
from ..pipeline.editing import edited, edited_file
from ..pipeline.synthesis import from_result
from ..results.schema import UNSAID, Model, Result, genuine_words
from ..results.storage import ResultError, read_result
from ..support.compilation import use_persistent_cache
from ..support.numbers import number
from ..support.outputs import refuse_others, refuse_present
from ..support.terminal import console, fail, reporting, writable_folder
from . import principled, rgl_files
from .blender_files import to_blender
from .gltf_files import to_gltf
from .materialx_files import to_openpbr
from .mitsuba_files import to_mitsuba, to_principled
from .nearest_ggx import nearest
from .scatter_files import targets_of, to_formulas, to_zemax
from .scatter_formulas import FORMULAS
from .scenes import of_result
from .xml_text import word

To = Literal[
    "mitsuba", "rgl", "principled", "merl", "json", "gltf", "openpbr", "blender", "zemax", "abg", "k-correlation"
]
ENDINGS = {
    "mitsuba": ("mitsuba.npz", "xml"), "principled": ("principled.xml",), "json": ("material.json",),
    "gltf": ("gltf",), "openpbr": ("mtlx",), "blender": ("blender.py",),
}  # fmt: skip
"""Endings of files that are written but for MERL files, which may always be measurements."""


FORMULAS_OF = {
    "gltf": "glTF 2.0, Appendix B", "openpbr": "OpenPBR", "principled": "Mitsuba's principled",
    "blender": "OpenPBR, by which Blender's Principled BSDF is made,",
}  # fmt: skip
OPENPBR = {
    "base_color": "base_color", "metallic": "base_metalness", "roughness": "specular_roughness", "ior": "specular_ior"
}  # fmt: skip
NAMES = {
    "openpbr": OPENPBR, "blender": OPENPBR,
    "principled": {"base_color": "base_color", "metallic": "metallic", "roughness": "roughness", "ior": "eta"},
}  # fmt: skip
"""What formats call the parameters of `nearest_ggx`."""
WRITERS = {"openpbr": to_openpbr, "blender": to_blender, "principled": to_principled}


def export(path: Path, to: str, out: Path, changes: Mapping[str, ArrayLike], force: bool = False) -> None:
    """`merlfit export`: write what another program reads; exits with 2 after bad input.

    Args:
        changes: values of the result's parameters to set; files are of its name, and ``.edited``. force: write over
            any file.
    """
    use_persistent_cache()
    if to not in get_args(To):
        raise fail(f"--to {to!r} is none of {', '.join(get_args(To))}")
    result = None if path.suffix == ".binary" else read_result(path)
    if changes and result is None:
        raise fail(f"--set is for the RESULT.json of a fit; {path} is a measured file")
    if changes and result is not None:
        result = edited(path, result, changes)
        path = edited_file(path) if result.edited_from else path
    if to == "merl":
        refuse_present(out / f"{path.stem}.binary", force)
    writable_folder(out)
    stem = f"{path.stem}.measured" if path.suffix == ".binary" else path.stem
    if to in ENDINGS:
        names = {ending: word(stem) if ending == "mitsuba.npz" else stem for ending in ENDINGS[to]}
        refuse_others([out / f"{name}.{ending}" for ending, name in names.items()], force)
    if to == "rgl":
        refuse_others(rgl_files.targets_of(stem, out), force)
    if to in ("zemax", *FORMULAS) and result is not None:
        refuse_others(targets_of(path, result, to, out), force)
    with reporting(path.name, path.stem) as say:
        written, lines = _exported(path, result, to, out, say)
    for line in lines:
        console.print(line)
    console.print("wrote " + ", ".join(map(str, written)))


def _exported(
    path: Path, result: Result | None, to: str, out: Path, say: Callable[[str], None]
) -> tuple[list[Path], Sequence[str | Table]]:
    """Files that were written, and what else to print: how near they are to the fit."""
    if result is None:
        if to not in ("mitsuba", "rgl"):
            raise SceneError(f"{path}: a measured file is exported --to mitsuba or rgl; fit it for the others")
        file = read(path)
        said = f"{path.name}, {genuine_words(file.genuine) if file.genuine else UNSAID}"
        return _whole(to, f"{path.stem}.measured", measurement(*folded(file)), said, out)
    if result.model is None:
        raise ResultError(f"{path}: the fit failed ({result.fit.status}), it has no material")
    fit = (
        f"{result.model.name} fit of {result.source.material} ({result.data_words}) by merlfit "
        f"{result.versions.get('merlfit', '')}, {result.error_words}"
    )
    said = f"{fit}, {_colours(result.model)}"
    match to:
        case "mitsuba" | "rgl":
            say("tables")
            given = of_result(path.stem, result, path)
            assert given.model is not None
            return _whole(to, path.stem, given.of(given.model), said, out)
        case "merl":
            say("bins")
            write(out / f"{path.stem}.binary", from_result(path, result)[0])
            return [out / f"{path.stem}.binary"], []
        case "principled" if principled.is_own(result, to):
            inputs = principled.mitsuba_inputs(result)
            return [to_principled(path.stem, inputs, said, principled.in_words(result), out)], []
        case "json":
            return [_write_json(out / f"{path.stem}.material.json", parameters_of(result))], []
        case "zemax":
            say("table")
            targets = targets_of(path, result, to, out)
            return targets, to_zemax(targets, result, fit)
        case "abg" | "k-correlation":
            say("formulas")
            targets = targets_of(path, result, to, out)
            return targets, [to_formulas(path, targets[0], result, to, fit)]
        case "gltf" if principled.is_own(result, to):
            say("spheres")
            found = principled.metallic_roughness(result, from_result(path, result)[0])
            off = f"{found['error']['cielab']:.2f}"
            left = ", ".join(f"{name} {number(x)}" for name, x in found["left_out"].items())
            what = (
                f"the fitted parameters of Disney's model themselves, without what glTF has not ({left}): "
                f"spheres drawn by the formulas of glTF differ from the fit by a mean CIELAB distance of {off}"
            )
            return [to_gltf(path.stem, found, said, what, out)], [what]
        case "openpbr" if principled.is_own(result, to):
            inputs = principled.openpbr_inputs(result)
            return [to_openpbr(path.stem, inputs, said, principled.in_words(result), out)], []
        case "blender" if principled.is_own(result, to):
            what = f"{principled.in_words(result)}; below, the base is as it is seen under its coat"
            return [to_blender(path.stem, principled.blender_inputs(result), said, what, out)], []
        case _:
            say("nearest GGX")
            found = nearest_of(path, result, to)
            what = in_words(found, FORMULAS_OF[to])
            if to == "gltf":
                return [to_gltf(path.stem, found, said, what, out)], [what]
            inputs = {own: found[key] for key, own in NAMES[to].items()}
            return [WRITERS[to](path.stem, inputs, said, what, out)], [what]


def _whole(to: str, name: str, material: Material, said: str, out: Path) -> tuple[list[Path], list[str | Table]]:
    """What holds any material: tables."""
    if to == "mitsuba":
        return to_mitsuba(name, material, said, out), []
    written, what = rgl_files.to_rgl(name, material, said, out)
    return written, [what]


def _colours(model: Model) -> str:
    """Where R, G and B are from."""
    same = set(model.channels) == set(MERL.names)
    return "colours as in that file" if same else "colours as the CIE 1931 observer sees them, equal energy being white"


def parameters_of(result: Result) -> dict[str, Any]:
    """What an own implementation of the model needs, without what is of the fit."""
    assert result.model is not None
    m = result.model
    return {
        "format": "merlfit-material 1", "material": result.source.material, "data": result.data_words,
        "source_sha1": result.source.sha1, "versions": result.versions,
        "rmse_per_sr": None if result.changed_by_hand else result.metrics.rmse,
        "edited_from": result.edited_from and result.edited_from.model_dump(),
        "model": m.name,
        "citation": m.material.citation, "settings": asdict(m.material),  # pyright: ignore[reportArgumentType]
        "channels": m.channels, "wavelengths_um": m.wavelengths_um,
        "parameters": {
            q.name: {
                "value": q.value, "unit": q.unit, "meaning": q.meaning, "laplace": q.laplace and q.laplace.model_dump(),
                "posterior": q.quantiles and q.quantiles.model_dump(),
            }
            for q in result.parameters if not q.parameter.startswith("grazing_")
        },
        "note": f"BRDF in 1/sr, {m.colour_space}; without the apparatus's loss of light at grazing angles",
    }  # fmt: skip


def nearest_of(path: Path, result: Result, to: str) -> dict[str, Any]:
    """What metallic-roughness materials can say of a fit, and how far off they are: `nearest_ggx.nearest`.

    A fit with a conductor's index is a metal there, too; of the others it is whichever is nearer.
    """
    assert result.model is not None
    return nearest(from_result(path, result)[0], to, metal=result.model.settings.get("index") == "complex")


def in_words(found: dict[str, Any], to: str) -> str:
    """What the file holds, and how far off it is."""
    return (
        f"the nearest GGX material of this format, without diffraction: spheres drawn by the formulas of {to} differ "
        f"from the fit by a mean CIELAB distance of {found['error']['cielab']:.2f}"
    )


def _write_json(path: Path, what: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(what, indent=2, allow_nan=False) + "\n")
