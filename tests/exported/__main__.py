"""Exported materials in the programs that they are for: `python -m tests.exported`, ten minutes; results/exports/.

Fits neural reconstructions, exports the fits, and draws each file by the program that reads it, in the studio and under
a lamp, beside our renderer. Mitsuba is of the extra `mitsuba`, MaterialX of `test`. Others are left out where they are
absent: BLENDER_PYTHON names a Python with Blender (`pip install bpy`, Python 3.11), NODE_MODULES the folder that `npm
install three gltf-validator` makes, and MaterialX draws below `xvfb-run` (Debian's xvfb and libgl1-mesa-dri).
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from merlfit.fitting.commands.scenes import of_result
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.atomic import write_atomically, write_text
from merlfit.scene.colour import cielab, displayed
from merlfit.scene.render import Film, pictures, stage
from merlfit.scene.surface import drawn

from ..bench.processes import ROOT
from ..support import reconstructions
from . import programs
from .programs import SIDE

FOLDER, WORK = ROOT / "results" / "exports", ROOT / "out" / "exports"
MATERIALS = ("nickel", "gray-plastic", "gold-metallic-paint2")
DISC = 0.93  # of half the picture's side: pixels of the sphere without its rim
SHOWN = ("plugin", "table", "principled", "blender", "gltf-blender", "gltf-three", "materialx")
NAMES = {
    "plugin": "Mitsuba, our plugin", "plugin-spectral": "the same, spectral variant",
    "table": "Mitsuba, `measured` (`--to rgl`)", "table-spectral": "the same, spectral variant",
    "principled": "Mitsuba, `principled`", "blender": "Blender (Cycles), nodes",
    "gltf-blender": "Blender, imported glTF", "gltf-three": "three.js, glTF", "materialx": "MaterialX, GLSL",
}  # fmt: skip
FITTED = {"blender": "Blender, nodes", "materialx": "MaterialX, GLSL"}  # of a fit of OpenPBR's own model
STATED = {
    "table": "rgl.xml", "principled": "principled.xml", "blender": "blender.py", "gltf-blender": "gltf",
    "gltf-three": "gltf", "materialx": "mtlx",
}  # fmt: skip
"""Files that say how far they are off, by the programs' names."""
NOTES = {
    "plugin": "nothing visible", "plugin-spectral": "spectra are guessed from R, G and B",
    "table": "what lies between its nodes", "table-spectral": "as above, and spectra are guessed",
    "principled": "diffraction: one GGX width stands for facets and the diffracted halo",
    "blender": "the same", "gltf-blender": "the same, plus bounces between facets; the plastic's highlight is wide",
    "gltf-three": "the same; the room is blurred beforehand, as it is seen along the normal",
    "materialx": "the same; albedos by fits of their own, 64 directions of the room",
}  # fmt: skip


def ran(*words):
    subprocess.run([sys.executable, "-m", "merlfit", *map(str, words)], check=True, capture_output=True)


def fits_of(material):
    """Results of both fits, made if they are not there: the two-scale model, and OpenPBR's."""
    made = [WORK / kind / f"{material}.json" for kind in ("fits", "openpbr")]
    for path, more in zip(made, ((), ("--model", "openpbr")), strict=True):
        if not path.is_file():
            file = reconstructions.make(WORK, material)
            ran("fit", file, "--no-posterior", *more, "-o", path.parent)
    return made


def exported(result):
    """Files of all formats."""
    out = WORK / f"{result.parent.name}-exported"
    kinds = ("mitsuba", "rgl", "principled", "gltf") if result.parent.name == "fits" else ()
    for to in (*kinds, "blender", "openpbr"):
        ran("export", result, "--to", to, "-o", out, "--force")
    return {
        ending: out / f"{result.stem}.{ending}"
        for ending in ("xml", "rgl.xml", "principled.xml", "gltf", "blender.py", "mtlx")
    }


def ours(result, seed=0):
    """Our picture of a fit."""
    film = programs.STUDIO.model_copy(update={"seed": seed})
    given = of_result(result.stem, read_result(result), result)
    assert given.model is not None
    (picture,) = pictures(Film(film, stage(film)), [drawn(given.of(given.model))])
    return picture


def drawn_by(files, name):
    """Pictures by the programs' names, without those that are absent."""
    spectral = "llvm_ad_spectral"
    found = {
        "plugin": lambda: programs.by_mitsuba(files["xml"], WORK),
        "plugin-spectral": lambda: programs.by_mitsuba(files["xml"], WORK, spectral),
        "table": lambda: programs.by_mitsuba(files["rgl.xml"], WORK),
        "table-spectral": lambda: programs.by_mitsuba(files["rgl.xml"], WORK, spectral, table=f"{name}_spec.bsdf"),
        "principled": lambda: programs.by_mitsuba(files["principled.xml"], WORK),
        "blender": lambda: programs.by_blender(files["blender.py"], WORK, files["blender.py"]),
        "gltf-blender": lambda: programs.by_blender(files["gltf"], WORK, files["blender.py"]),
        "gltf-three": lambda: programs.by_three(files["gltf"], WORK),
        "materialx": lambda: programs.by_materialx(files["mtlx"], WORK),
    }  # fmt: skip
    pictures_of = {key: draw() for key, draw in found.items() if files["xml"].is_file() or key in FITTED}
    return {key: x for key, x in pictures_of.items() if x is not None}


def apart(one, other):
    """Mean CIELAB distance of the sphere's pixels."""
    return float(np.linalg.norm(cielab(one) - cielab(other), axis=-1)[disc(len(one))].mean())


def disc(side):
    axis = (np.arange(side) + 0.5) / side * 2 - 1
    return np.hypot(axis[:, None], axis) < DISC


def said(path):
    """The distance that a file states, by the formulas; None if it states none."""
    found = re.search(r"CIELAB distance of ([\d.]+\d)", path.read_bytes().decode(errors="ignore"))
    return found and float(found[1])


def sheet(found):
    """Spheres of all materials by all programs, (name, our picture, pictures) each."""
    keys = [key for key in SHOWN if key in found[0][2]]
    figure = Figure(figsize=(1.3 * (len(keys) + 1), 1.5 * len(found) + 0.35))
    axes = figure.subplots(len(found), len(keys) + 1, squeeze=False)
    for row, (name, reference, drawings) in zip(axes, found, strict=True):
        for axis, key in zip(row, (None, *keys), strict=True):
            axis.set_axis_off()
            picture = np.where(disc(SIDE)[..., None], reference if key is None else drawings[key], 1.0)
            axis.imshow(displayed(picture), interpolation="nearest")
            label = name if key is None else f"{apart(drawings[key], reference):.1f}"
            axis.text(0.5, -0.03, label, fontsize=7, ha="center", va="top", transform=axis.transAxes)
    for axis, key in zip(axes[0], (None, *keys), strict=True):
        axis.set_title("merlfit" if key is None else NAMES[key].replace("`", "").replace(" (", "\n("), fontsize=7)
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.04, top=0.9, wspace=0.03, hspace=0.14)
    return figure


PAGE = """# Exported materials in the programs that they are for

![spheres](exports.png)

**Neural reconstructions** of MERL (Sztrajman et al. 2021), fitted by the two-scale model with the defaults, exported by
`merlfit export`, each file drawn by the program that reads it: in the studio of `configs/scenes`, under a lamp without
breadth, from six radii away. Below each sphere is its mean CIELAB distance from merlfit's (about 1 is just noticeable).
Made by `python -m tests.exported`, with {versions}.

In brackets is what the file itself states, which is of two other lights and by the format's formulas:

| drawn by | {materials} | what the format cannot hold |
|---|{dashes}---|
{rows}

Two pictures of ours with other random numbers are {noise} apart: a distance of that size is noise.

## The formats' own models, fitted to the file

`merlfit fit FILE --model openpbr`, whose parameters MaterialX takes as they are, and Blender with the base as it is
seen under the coat, since its own coat leaves what is below it alone: how far their pictures are from merlfit's picture
of that fit, and how far that one is from the two-scale fit's. All three have a coat; MaterialX' own shader draws the
nickel under one a quarter darker than our reading of the specification.

| drawn by | {materials} |
|---|{dashes}
{fitted}

## What was not run

**pbrt-v4** has no package to install here: its scene (`NAME.rgl.pbrt`) follows its documentation, and the table that it
reads, `NAME_spec.bsdf`, is that of Mitsuba's spectral variant above. {validated}
"""


def cells(values, stated=()):
    told = [*stated] or [None] * len(values)
    return " | ".join(f"{x:.2f}" + (f" ({y:.2f})" if y is not None else "") for x, y in zip(values, told, strict=True))


def page(found, fitted, stated, noise, issues, versions):
    """The page in Markdown."""
    rows = []
    for key, label in NAMES.items():
        if key in found[0][2]:
            away = [apart(drawings[key], picture) for _, picture, drawings in found]
            rows.append(f"| {label} | {cells(away, stated.get(key, ()))} | {NOTES[key]} |")
    own = [
        f"| {label} | {cells([apart(drawings[key], picture) for picture, drawings in fitted])} |"
        for key, label in FITTED.items() if key in fitted[0][1]
    ]  # fmt: skip
    other = [apart(picture, reference) for (picture, _), (_, reference, _) in zip(fitted, found, strict=True)]
    own.append(f"| merlfit, from the two-scale fit | {cells(other)} |")
    checked = "" if issues is None else (
        f"Khronos' glTF-Validator finds {issues[0]} errors and {issues[1]} warnings in the glTF files."
    )  # fmt: skip
    return PAGE.format(
        rows="\n".join(rows), fitted="\n".join(own), noise=", ".join(f"{x:.2f}" for x in noise),
        materials=" | ".join(MATERIALS), dashes="---|" * len(MATERIALS), validated=checked, versions=versions,
    )  # fmt: skip


def versions():
    """Of the programs."""
    import MaterialX
    import mitsuba

    told = [f"Mitsuba {mitsuba.__version__}", f"MaterialX {MaterialX.__version__}"]
    if python := os.environ.get("BLENDER_PYTHON"):
        words = [python, "-c", "import bpy; print(bpy.app.version_string)"]
        told.append(f"Blender {subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()[-1]}")
    if modules := os.environ.get("NODE_MODULES"):
        text = (Path(modules) / "three" / "package.json").read_text()
        told.append(f"three.js {json.loads(text)['version']}")
    return ", ".join(told)


def main():
    use_persistent_cache()
    WORK.mkdir(parents=True, exist_ok=True)
    programs.write_studio(WORK)
    found, fitted, noise, stated, issues = [], [], [], {}, []
    for name in MATERIALS:
        result, own = fits_of(name)
        files, picture = exported(result), ours(result)
        found.append((name, picture, drawn_by(files, name)))
        noise.append(apart(picture, ours(result, seed=1)))
        own_files = exported(own)
        fitted.append((ours(own), drawn_by(own_files, name)))
        for key, ending in STATED.items():
            stated.setdefault(key, []).append(said(files[ending]))
        issues.append(programs.validated(files["gltf"]))
        print(name, {key: round(apart(x, picture), 2) for key, x in found[-1][2].items()}, flush=True)
    FOLDER.mkdir(exist_ok=True)
    total = None if issues[0] is None else np.sum(issues, 0).tolist()
    write_text(FOLDER / "README.md", page(found, fitted, stated, noise, total, versions()))
    write_atomically(FOLDER / "exports.png", lambda file: sheet(found).savefig(file, format="png", dpi=130))


if __name__ == "__main__":
    main()
