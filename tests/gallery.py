"""Pictures of all fits: `python -m tests.gallery FITS MEASURED` writes docs/gallery.md and docs/gallery/*.webp.

FITS is the folder of `tests.richer_models`, MEASURED one of `tests.measured`, for the file of NIST. Nothing is fitted;
pictures that are newer than their fits stay, so that it goes on where it was stopped, and materials without fits there
stay as the page has them. A quarter of an hour.
"""

import csv
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.draws import NoPicture
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.show.spheres import of_file_and_fit
from merlfit.fitting.show.subject import subject_of
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io import inputs
from PIL import Image

from .bench.processes import ROOT
from .measured import ORIGINS
from .richer_models import FOR_ALL, path_of, stems_of
from .richer_models import PAGE as FITS
from .support.reconstructions import DATA, ORIGIN

PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "gallery"
SIDE, COLUMNS, QUALITY = 128, 3, 80  # pixels of a sphere; materials side by side; of WebP
HEAD = """# Gallery

{count} materials: the file, the default fit, and the fit by `--model auto`, from the left; above under a small lamp,
below in a room. The numbers are how far the spheres of fit and file are apart under the lamp and in the room: the
mean CIELAB distance of lit pixels, in which 1 is just noticeable, and above 2 a fit does not look like its file
(**bold**). Nothing was chosen or retouched. Each picture opens larger.

Fits are those of [richer models](../results/richer_models.md); that of PTFE is of [genuine
measurements](../results/measured/README.md). Both pages name the commits. `python -m tests.gallery` makes this one.
Spheres with their differences, the worst first: [all 100](../results/merl100/two_scale.md), [the genuine ones beside
Mitsuba's](../results/measured/spheres.md).
"""
GENUINE = """
## Genuine measurements

**Measured.** Isotropic materials of the RGL EPFL material database ([Dupuy & Jakob
2018](https://doi.org/10.1145/3272127.3275059), CC0), and sintered PTFE of NIST (Germer 2017). Between its samples a
file is interpolated, and the fit as the file.
"""
RECONSTRUCTIONS = """
## Neural reconstructions of MERL

**Not measurements**: what neural networks made of MERL's ([Sztrajman et al.
2021](https://doi.org/10.1111/cgf.14335)). Networks smooth what they learn: how far fits of the
measured files are from them was not measured.
"""


def picture(file, fits):
    """File and fits side by side, under the lamp and in the room below: (2 SIDE, (1 + fits) SIDE)."""
    read, columns = inputs.read(file), []
    for path in fits:
        found = of_file_and_fit(subject_of(read_result(path), path, read))
        if not columns:
            columns.append([found[light]["file"] for light in found])
        columns.append([found[light]["fit"] for light in found])
    spheres = [[Image.fromarray(x).resize((SIDE, SIDE), Image.Resampling.LANCZOS) for x in each] for each in columns]
    return Image.fromarray(np.hstack([np.vstack([np.asarray(x) for x in each]) for each in spheres]))


def drawn(file, fits):
    """The picture's path; None where the samples are too few for one."""
    to = PICTURES / f"{file.stem.removesuffix('_rgb')}.webp"
    if to.is_file() and all(to.stat().st_mtime > path.stat().st_mtime for path in fits):
        return to
    try:
        made = picture(file, fits)
    except NoPicture as error:
        print(f"{file.stem}: {error}")
        return None
    made.save(to, quality=QUALITY, method=6)
    print(to.name, to.stat().st_size, flush=True)
    return to


def distance(way, result):
    """A line of a caption: model, and distances under the lamp and in the room."""
    seen = [result.metrics.lamp, result.metrics.environment]
    far = [f"**{x:.1f}**" if x > 2 else f"{x:.1f}" for x in seen]
    variant = result.model.material.variant.partition(" + ")[0]  # of the base: its name has the others
    return f"{way}: {result.model.name} ({variant}) {', '.join(far)}"


def cell(file, fits):
    """Picture and caption of a material."""
    to, name = drawn(file, list(fits.values())), file.stem.removesuffix("_rgb")
    lines = [f"**{name}**", *(distance(way, read_result(path)) for way, path in fits.items())]
    return f"[![{name}](gallery/{to.name})](gallery/{to.name})<br>{'<br>'.join(lines)}"


def table(cells):
    """Rows of COLUMNS cells."""
    rows = [cells[k : k + COLUMNS] for k in range(0, len(cells), COLUMNS)]
    lines = ["| " * COLUMNS + "|", "|---" * COLUMNS + "|"]
    return "\n".join(lines + [f"| {' | '.join(row + [''] * (COLUMNS - len(row)))} |" for row in rows])


def those_of_the_table(out):
    """An error if a folder holds other fits than the committed table tells of."""
    with FITS.with_suffix(".csv").open(newline="") as text:
        for row in csv.DictReader(text):
            for path in out.glob(f"{row['way']}/{row['file']}*.json"):
                if path.stem.removesuffix("_rgb") == row["file"]:
                    picture = read_result(path).metrics.picture
                    if row["way"] in FOR_ALL and f"{picture:.6g}" != row["picture"]:
                        sys.exit(
                            f"{path}: not the fit of {FITS.with_suffix('.csv')}: write that by tests.richer_models"
                        )


def cells_of_the_page():
    """What the committed page shows of each material, by name."""
    return {found[1]: found[0] for found in re.finditer(r"\[!\[(\S+?)\].*?(?= \|)", PAGE.read_text())}


def main(out, measured):
    """Draw what is not drawn, and write the page."""
    use_persistent_cache()
    those_of_the_table(out)
    PICTURES.mkdir(exist_ok=True)
    nist, kept = DATA / "measured" / "nist" / "ptfe_regular.csv", cells_of_the_page()

    def shown(stem, file, fits):
        there = all(path.is_file() for path in fits.values())
        return cell(file(), fits) if there else kept[stem.removesuffix("_rgb")]

    found = {
        origin: [
            shown(stem, partial(path_of, out, origin, stem), {way: out / way / f"{stem}.json" for way in FOR_ALL})
            for stem in stems_of(origin)
        ]
        for origin in (ORIGINS["rgl"], ORIGIN)
    }
    found[ORIGINS["rgl"]].append(shown(nist.stem, lambda: nist, {"default": measured / f"{nist.stem}.json"}))
    text = HEAD.format(count=sum(map(len, found.values())))
    for head, cells in zip((GENUINE, RECONSTRUCTIONS), found.values(), strict=True):
        text += f"{head}\n{table(cells)}\n"
    PAGE.write_text(text)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
