"""Pictures of docs/scenes.md: `python -m tests.scene_pictures`, some minutes.

plans.png: the scenes of configs/scenes with the effects of their plans, and the difference to all effects. fits.png:
fits of `tests.merl100` as spheres in the studio, beside their files.
"""

import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from merlfit.fitting.commands.scenes import changed, grey, plans_of, staged
from merlfit.fitting.commands.sphere_sheets import LARGEST_SHOWN, STUDIO, sphere_of
from merlfit.fitting.pipeline.models import layout_for, two_scale
from merlfit.fitting.settings.config import load
from merlfit.fitting.show.labelled import DPI, MARGIN, labelled
from merlfit.fitting.show.style import LETTERS, save
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.binary import read
from merlfit.merl_io.samples import folded
from merlfit.scene.colour import difference, displayed
from merlfit.scene.effects import Given, allowed, off_by
from merlfit.scene.render import pictures
from merlfit.scene.surface import drawn, measurement

from .bench.materials import file
from .merl100 import FITS
from .rival_maps import values_of

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "scenes"
SCENES = ("matte", "metal", "paint")
MATERIALS = (
    "gray-plastic", "red-fabric", "violet-rubber", "yellow-paint", "nickel", "fruitwood-241",
    "specular-violet-phenolic", "blue-metallic-paint2",
)  # fmt: skip
SIDE, SAMPLES = 160, 128  # pixels of a sphere; of each pixel
GAP = 10  # pixels between scenes
DATA = "neural reconstructions"


def planned(name):
    """A scene's picture with the effects of its plan, and the difference over the tolerance, both of 8 bits."""
    film, given = ready = staged(ROOT / "configs" / "scenes" / f"{name}.toml")
    plans = plans_of(ready, lambda effect: None)
    for each in plans:
        print(name, each.name, "without", ", ".join(row.effect.name for row in each.rows if not row.kept))
    others = [
        [each.of(p.chosen) if p.chosen is not None else each.finest()] for each, p in zip(given, plans, strict=True)
    ]
    whole, same = pictures(film, [drawn(each.finest()) for each in given], others)
    return displayed(same), grey(off_by(whole, same, film.scene.tolerance) / allowed(film.scene.tolerance))


def plans_picture():
    """All scenes side by side, differences below."""
    found = [planned(name) for name in SCENES]
    gap = np.full((len(found[0][0]), GAP, 3), 255, np.uint8)
    rows = [np.concatenate([x for each in found for x in (each[k], gap)][:-1], 1) for k in (0, 1)]
    rows.insert(1, np.full((GAP, rows[0].shape[1], 3), 255, np.uint8))
    pixels = np.concatenate(rows)
    figure = labelled(pixels, (), ("with the plan's effects", "CIELAB distance, white: 1"), f"fits of {DATA}")
    across, down = pixels.shape[1] + MARGIN, pixels.shape[0] + MARGIN
    left = MARGIN
    for name, (picture, _) in zip(SCENES, found, strict=True):
        middle = left + picture.shape[1] / 2
        figure.text(middle / across, 1 - 0.9 * MARGIN / down, f"{name}.toml", ha="center", va="bottom", size=LETTERS)
        left += picture.shape[1] + GAP
    return figure


def fits_picture(folder):
    """A column a material: file, fit as the apparatus would have seen it, their difference."""
    scene = changed(STUDIO, samples=SAMPLES, camera={**STUDIO.camera.model_dump(), "width": SIDE, "height": SIDE})
    fits = {row["material"]: row["compressive"] for row in json.loads(FITS.read_text())}
    config, columns = load(posterior=False), []
    for name in MATERIALS:
        fit = fits[name]
        model = two_scale(config, (fit["index"], fit["body"]))
        values = values_of(layout_for(config, model), fit["parameters"])
        fitted = sphere_of(Given(name, model, values), scene)
        seen = Given(name, None, {}, measured=measurement(*folded(read(file(folder, name)))))
        measured = sphere_of(seen, scene)
        away = difference(measured, fitted)
        print(f"{name}: mean CIELAB distance {away.mean():.3g}")
        columns.append(np.concatenate([displayed(measured), displayed(fitted), grey(away / LARGEST_SHOWN)]))
    rows = ("file", "fit", f"CIELAB, white: {LARGEST_SHOWN:g}")
    return labelled(np.concatenate(columns, 1), MATERIALS, rows, f"files: {DATA}")


def main():
    """Draw them."""
    use_persistent_cache()
    save(plans_picture(), FOLDER / "plans.png", dpi=DPI)
    with TemporaryDirectory() as made:
        save(fits_picture(os.environ.get("MERL_RECONSTRUCTIONS", made)), FOLDER / "fits.png", dpi=DPI)


if __name__ == "__main__":
    main()
