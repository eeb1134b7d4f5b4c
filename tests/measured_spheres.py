"""Spheres of genuine measurements: `python -m tests.measured_spheres`, minutes; results/measured/spheres.*.

Of the fits of `tests.measured`, or of those in a folder that is named.

Each RGL file as Mitsuba's plugin `measured` has it, in the directions of our pixels and lamp themselves, beside our
picture of the file, which is of bins of `scene.gridded`, and the fit. Mitsuba takes the viewer for the file's light;
our picture is the mean of that and of both exchanged, as models are reciprocal.
"""

import csv
import io
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from merlfit.fitting.fit.weights import within
from merlfit.fitting.pipeline.draws import NoPicture
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.show.subject import on_bins, subject_of
from merlfit.fitting.support.choices import THETA_MAX
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io import inputs
from merlfit.merl_io.atomic import write_atomically
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import folded
from merlfit.scene.colour import cielab, coloured
from merlfit.scene.gridded import GRID
from merlfit.scene.lights import frame
from merlfit.scene.spheres import BLACK, PIXELS, compared, disc, distances, lamp_nodes, normals, render, sphere

from .bench.processes import ROOT
from .measured import FOLDER, commit, files_of

SIDE, COLUMNS = 64, 3  # pixels of a sphere on the contact sheet; materials side by side
PANELS = ("file, by Mitsuba", "file, by merlfit", "fit", "2 × difference")
WHOLE = 0.999  # of a pixel's light comes from bins that the samples cover: such pixels are compared


def mitsuba_brdf(mitsuba, path, i, o):
    """f(i, o) of a file (N, 3), 1/sr, with i as the file's light; 0 below the horizon."""
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    at, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    found = np.zeros(i.shape)
    for k in np.flatnonzero((i[:, 2] > 0) & (o[:, 2] > 0)):
        at.wi = mitsuba.Vector3f(*i[k])
        found[k] = np.array(bsdf.eval(context, at, mitsuba.Vector3f(*o[k]))) / o[k, 2]
    return found


def by_mitsuba(mitsuba, path, positions):
    """Of pixels under the lamp, (pixels, 3), white being 1: with the viewer as the file's light, and exchanged."""
    normal, light = normals(positions), lamp_nodes()

    def turned(direction):
        return np.stack([np.sum(axis * direction, -1) for axis in (*frame(normal[:, None]), normal[:, None])], -1)

    lamp = turned(light)
    viewer = np.broadcast_to(turned(np.array([0.0, 0.0, 1.0])), lamp.shape)
    lamp, viewer = lamp.reshape(-1, 3), viewer.reshape(-1, 3)
    cosine = np.maximum(lamp[:, 2:], 0.0)
    return [
        np.pi * (cosine * mitsuba_brdf(mitsuba, path, *pair)).reshape(len(positions), len(light), 3).mean(1)
        for pair in ((viewer, lamp), (lamp, viewer))
    ]


def apart(one, other, counted):
    """CIELAB distances of those pixels that are lit in either and counted."""
    ours, theirs = cielab(one), cielab(other)
    lit = np.maximum(ours[:, 0], theirs[:, 0]) > BLACK
    return np.linalg.norm(ours - theirs, axis=-1)[lit & counted], lit


def of_file(mitsuba, path, values, valid):
    """A row of the table: our picture of bins (3, H, D, P/2) under the lamp, beside Mitsuba's."""
    pixels = compared("lamp", GRID)
    reaches = pixels @ valid.ravel().astype(float)
    counted = reaches > WHOLE * np.asarray(pixels.sum(1)).ravel()
    ours = render(pixels, np.where(valid, values, 0.0))
    seen, exchanged = by_mitsuba(mitsuba, path, disc(PIXELS["lamp"]))
    found, lit = apart(ours, (seen + exchanged) / 2, counted)
    return {
        "material": path.stem.removesuffix("_rgb"), "compared": float((lit & counted).sum() / lit.sum()),
        "mean": found.mean(), "median": np.median(found), "p95": np.quantile(found, 0.95),
        "as rendered": apart(ours, seen, counted)[0].mean(),
        "exchanged": apart(seen, exchanged, counted)[0].mean(),
    }  # fmt: skip


def pictures(mitsuba, path, result, positions):
    """Radiance of pixels (N, 3) of the first three panels, None where there is none; a row of the table; distances."""
    measured = inputs.read(path)
    bins = on_bins(measured, measured.values)
    values, valid = folded(bins)
    values, pixels = coloured(np.where(valid, values, 0.0), bins.bands), sphere("lamp", positions, GRID)
    row, seen = None, None
    if path.suffix == ".bsdf":
        row = of_file(mitsuba, path, values, valid)
        seen = by_mitsuba(mitsuba, path, positions)[0]
    used, fitted, away = valid & within(merl_grid(GRID), THETA_MAX)[..., : valid.shape[-1]], None, None
    try:
        fit = coloured(subject_of(read_result(result), result, measured).predicted, bins.bands)
        fitted, away = render(pixels, np.where(used, fit, 0.0)), distances(values, np.where(used, fit, 0.0), used)
    except (NoPicture, FileNotFoundError):
        pass
    return (seen, render(pixels, np.where(used, values, 0.0)), fitted), row, away


def displayed(radiance, exposure):
    return np.clip(radiance * exposure, 0, 1) ** (1 / 2.2)


def sheet(found, inside):
    """The contact sheet of materials, (name, panels, distances) each."""
    lines = -(-len(found) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * 4.1, lines * 1.22 + 0.6))
    figure.suptitle(
        "Genuine measurements (RGL EPFL, Dupuy & Jakob 2018, CC0; ptfe: NIST, Germer 2017) under a small lamp\n"
        f"{', '.join(PANELS)} of the last two; behind the name their CIELAB distance",
        fontsize=9,
    )
    axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, (name, panels, away) in zip(axes, found, strict=False):
        exposure = np.clip(0.8 / max(np.quantile(panels[1].mean(-1), 0.95), 1e-6), 0.3, 20)
        shown = [np.ones((inside.sum(), 3)) if x is None else displayed(x, exposure) for x in panels]
        last = np.ones((inside.sum(), 3)) if panels[2] is None else np.minimum(2 * np.abs(shown[1] - shown[2]), 1)
        picture = np.ones((len(PANELS), SIDE * SIDE, 3))
        picture[:, inside] = [*shown, last]
        square = picture.reshape(len(PANELS), SIDE, SIDE, 3)
        axis.imshow(np.moveaxis(square, 0, 1).reshape(SIDE, -1, 3), interpolation="nearest")
        said = "not explained by the model" if away is None else f"{away[1]:.1f}"
        axis.set_title(f"{name}  {said}", fontsize=7, pad=2)
    figure.subplots_adjust(
        left=0.005, right=0.995, bottom=0.005, top=1 - 0.62 / (lines * 1.22 + 0.6), hspace=0.2, wspace=0.03
    )
    return figure


PAGE = """# Spheres of genuine measurements

![contact sheet](spheres.png)

**Genuine measurements**: RGL EPFL material database (Dupuy & Jakob 2018), CC0, and sintered PTFE of NIST (Germer 2017).
Made by `make measured`. Under a lamp, from the left: the RGL file as Mitsuba's plugin `measured` draws it, the file and
the fit as merlfit draws them, and twice the difference of these two. Between the nodes the fit is interpolated as the
file is, so that rings of a file's table of normals (chm_mint) show in both. Behind the name: their CIELAB distance.
Each file was fitted with the index and the body that the defaults choose ([table](README.md)).

Is our picture of a file Mitsuba's? CIELAB distance of those pixels under the lamp that are lit, and all whose bins have
a value (`compared`: their share of the lit ones). Mitsuba's values are those in the directions of pixel and lamp
themselves, of {mitsuba}, without noise; ours are looked up in 90 x 90 x 36 bins. Mitsuba takes the viewer for the
file's light; ours is the mean of that and of light and viewer exchanged, since models are reciprocal.
`mean`, `median`, `p95`: our picture from the mean of both of Mitsuba's. `as rendered`: from the one that Mitsuba
renders. `exchanged`: how far Mitsuba's two are from each other; a reciprocal picture is half of that from one of them,
at the least. `fit`: of our pictures of file and fit, lit pixels, under the lamp and in the room.

{rows}

Over all files ours is {mean:.2f} from the mean of Mitsuba's two, which are {exchanged:.2f} apart.
(Interpolated on a Delaunay triangulation, as before, it was 0.35 to 0.5 from it of the matt files, 0.9 to 5.3 of the
others, on fewer pixels.) The largest distances are at grazing light and viewer: at its last incidence a file holds
zeros below the horizon, towards which Mitsuba interpolates, and we let the measured nodes stand for all. The room is
not compared with Mitsuba's.
"""


def page(rows, version):
    head = list(rows[0])
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    lines += [f"| {' | '.join(x if isinstance(x, str) else f'{x:.2f}' for x in row.values())} |" for row in rows]
    means = {name: np.mean([row[name] for row in rows]) for name in ("mean", "exchanged")}
    return PAGE.format(rows="\n".join(lines), mitsuba=f"Mitsuba {version}", **means)


def main(fits):
    """The sheet, and the table of the RGL files."""
    import mitsuba  # slow to import, and not everywhere

    use_persistent_cache()
    mitsuba.set_variant("scalar_rgb")
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    positions = np.stack(np.meshgrid(axis, -axis), -1).reshape(-1, 2)
    inside = np.sum(positions**2, -1) < 0.99
    found, rows = [], []
    for path in files_of():
        panels, row, away = pictures(mitsuba, path, Path(fits) / f"{path.stem}.json", positions[inside])
        found.append((path.stem.removesuffix("_rgb"), panels, away))
        rows += (
            [row | dict(zip(("fit, lamp", "fit, room"), away[1:] if away else ("-", "-"), strict=True))] if row else []
        )
        print(found[-1][0], row, away, flush=True)
    text = io.StringIO()
    to = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    to.writeheader()
    to.writerows({k: x if isinstance(x, str) else round(float(x), 3) for k, x in row.items()} for row in rows)
    for name, said in (("spheres.md", page(rows, mitsuba.__version__)), ("spheres.csv", text.getvalue())):
        write_atomically(FOLDER / name, lambda target, said=said: target.write(said.encode()))
    sheet(found, inside).savefig(FOLDER / "spheres.png", dpi=110)


if __name__ == "__main__":
    main(sys.argv[1] if sys.argv[1:] else ROOT / "out" / "measured" / commit())
