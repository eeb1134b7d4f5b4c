"""Where a rival's RMSE is lower than the two-scale model's, and why: `python -m tests.rival_maps`.

Maps of fit over file of both, and how their mean squared errors add up over theta_h, for one material of each kind of
defeat in results/merl100/rivals_compressive.md and rivals_none.md. Parameters are those of `tests.merl100` and
`tests.merl100_rivals`. Pictures: results/merl100/rival_maps.png and rival_maps_none.png.
"""

import json
import os
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import colors
from merlfit.fitting.fit.error_metrics import SIN_FLOOR
from merlfit.fitting.fit.weights import weighted_samples, within
from merlfit.fitting.pipeline.comparison import config_of
from merlfit.fitting.pipeline.models import candidates, layout_for, two_scale
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.fitting.settings.config import load
from merlfit.fitting.show.style import OKABE_ITO, PAGE_INCHES, new, printable, save
from merlfit.fitting.support.choices import THETA_MAX
from merlfit.merl_io.binary import read
from merlfit.merl_io.grid import merl_grid

from .bench.materials import file
from .merl100 import FITS, FOLDER
from .merl100_rivals import PARTS

SHOWN = {
    "compressive": {
        "cherry-235": "sgd", "white-fabric": "sgd", "chrome": "sgd",
        "specular-green-phenolic": "epd", "white-acrylic": "epd", "silver-metallic-paint": "smooth",
    },
    "none": {
        "gray-plastic": "sgd", "specular-white-phenolic": "sgd", "white-marble": "sgd", "silicon-nitrade": "smooth",
    },
}  # fmt: skip
PICTURES = {"compressive": "rival_maps.png", "none": "rival_maps_none.png"}
FACTOR = 4.0  # of fit and file, at the ends of the scale
TICKS = (0, 1, 5, 15, 30, 60, 90)  # theta_h (deg)


def predictions(material, rival, samples, weights):
    """Of the two-scale model and of a rival, (C, H, D, P/2)."""
    (row,) = [row[weights] for row in json.loads(FITS.read_text()) if row["material"] == material]
    config = load(posterior=False, weights=weights)
    other = json.loads((PARTS / f"{material}.json").read_text())[weights][rival]
    own = config_of(config, rival)
    (model,) = candidates(own)
    pairs = (
        (layout_for(config, two_scale(config, (row["index"], row["body"])), samples.bands), row["parameters"]),
        (layout_for(own, model, samples.bands), other["values"]),
    )
    return [predict_samples(layout, layout.free(values_of(layout, flat)), samples) for layout, flat in pairs]


def values_of(layout, flat):
    """Parameters from one number a channel."""
    return {
        q.name: np.array([flat[f"{q.name}_{c}"] for c in layout.channels]) if q.per_channel else flat[q.name]
        for q in layout.parameters
    }


def measure(material, rival, folder, weights):
    """Of both models: log2 of fit over file (H, D), squared error summed over the rows up to each theta_h (H)."""
    measurement, grid = read(file(folder, material)), merl_grid()
    samples = weighted_samples(measurement, load().exponents[0], THETA_MAX)
    half = samples.value.shape[-1]
    used = np.all(samples.weight > 0, 0) & within(grid, THETA_MAX)[..., :half]
    turned = np.flip(grid.cos_i, -1)[..., :half]  # the light's cosine where both have changed places
    measure_ = (np.sin(grid.theta_h) * np.gradient(grid.theta_h))[:, None, None] * np.sin(2 * grid.theta_d)[:, None]
    weight = sum(measure_ * c**2 / np.maximum(np.sqrt(1 - c**2), SIN_FLOOR) for c in (grid.cos_i[..., :half], turned))
    weight = np.where(used, weight, 0.0)
    found = []
    for fit in predictions(material, rival, samples, weights):
        sound = used & np.all((samples.value > 0) & (fit > 0), 0)
        ratio = np.log2(np.where(sound, fit, 1) / np.where(sound, samples.value, 1)).mean(0).sum(-1)
        count = sound.sum(-1)
        squares = (weight * np.mean((fit - samples.value) ** 2, 0)).sum((1, 2)) / weight.sum()
        found.append((np.where(count > 0, ratio / np.maximum(count, 1), np.nan), np.cumsum(squares)))
    return found


@printable
def picture(shown):
    """A row a material: both maps, and the errors' sums."""
    grid = merl_grid()
    edges, most = [np.degrees(edge) for edge in grid.edges[:2]], np.log2(FACTOR)
    figure = new(1.35 * len(shown) + 0.5, PAGE_INCHES)
    panels = figure.subplots(len(shown), 3, sharex=True)
    for (material, rival), row in zip(shown, panels, strict=True):
        found = shown[material, rival]
        for axis, (ratio, squares), name in zip(row, found, ("two-scale", rival), strict=False):
            drawn = axis.pcolormesh(
                np.sqrt(edges[0] / 90), edges[1], ratio.T, cmap="PuOr", norm=colors.Normalize(-most, most),
                rasterized=True,
            )  # fmt: skip
            axis.set(title=f"{material}\n{name}, RMSE {np.sqrt(squares[-1]):.3g}", yticks=[0, 30, 60, 90])
            axis.set_facecolor("#dddddd")
        total = found[0][1][-1]
        for (_, squares), name, colour in zip(found, ("two-scale", rival), OKABE_ITO, strict=False):
            row[2].plot(np.sqrt(np.degrees(grid.theta_h) / 90), squares / total, color=colour, label=name)
        row[0].set_ylabel(r"$\theta_d$ (deg)")
        row[2].set(title="squared error up to this row,\nthe two-scale model's in all: 1", ylim=(0, 1.05))
        row[2].legend(loc="best")
    for axis in panels[-1]:
        axis.set_xticks(np.sqrt(np.array(TICKS) / 90), [str(x) for x in TICKS])
        axis.set_xlabel(r"$\theta_h$ (deg), as MERL's rows")
    bar = figure.colorbar(drawn, ax=panels[:, :2], ticks=[-2, -1, 0, 1, 2], extend="both", location="bottom", aspect=60)
    bar.ax.set_xticklabels(["1/4", "1/2", "1", "2", "4"])
    figure.suptitle("neural reconstructions of MERL, not measurements")
    bar.set_label("fit over file, geometric mean over azimuths and channels")
    return figure


def main():
    """Draw them."""
    with TemporaryDirectory() as made:
        folder = os.environ.get("MERL_RECONSTRUCTIONS", made)
        for weights, pairs in SHOWN.items():
            shown = {pair: measure(*pair, folder, weights) for pair in pairs.items()}
            save(picture(shown), FOLDER / PICTURES[weights], dpi=150)
            for (material, rival), ((_, own), (_, others)) in shown.items():
                print(f"{weights} {material} {rival}: {np.sqrt(own[-1]):.3g} {np.sqrt(others[-1]):.3g}")


if __name__ == "__main__":
    main()
