"""Spheres of file and fit, their difference, and what each effect adds: under a small lamp and an environment."""

from functools import cache

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from PIL import Image
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from ...merl_io.binary import Dims
from ...merl_io.samples import folded
from ...scene.colour import coloured, difference, displayed
from ...scene.spheres import Lighting, render, sphere
from ..fit.weights import within
from ..support.threads import side_by_side
from .curves import added, part_name
from .style import DECADES, OKABE_ITO, at_mirror, new, printable
from .subject import Subject

SIDE = 384  # pixels of a picture
COMPUTED: dict[Lighting, int] = {"lamp": SIDE, "environment": 128}  # pixels that are computed; the others lie between
RIM = 0.99  # squared radius up to which a sphere is drawn
LARGEST_SHOWN = 10.0  # CIELAB distance that is brightest in a picture of differences
INCIDENCE_DEG = 45  # of the lobes of the parts
LINES = ("-", "--", "-.", ":")
HATCHES = ("", "////", "....", "xxxx")


def of_file_and_fit(subject: Subject) -> dict[Lighting, dict[str, np.ndarray]]:
    """Pictures (side, side, 4) of bytes: by lighting ``file``, ``fit`` and ``difference``, or ``fit`` alone.

    The two are compared where the file has data below ``theta_max``; without a file the fit is shown everywhere.
    """
    grid, fit, rim = subject.grid, subject.predicted, 1.0
    if subject.measurement is None:
        planes = {"fit": _where(grid.above[..., : fit.shape[-1]], fit)}
    else:
        values, valid = folded(subject.measurement)
        used = valid & within(grid, subject.theta_max)[..., : fit.shape[-1]]
        rim = float(np.sin(subject.theta_max))  # past it nothing is compared
        planes = {"file": _where(used, values), "fit": _where(used, fit)}
    found: dict[Lighting, dict[str, np.ndarray]] = {}
    for lighting in COMPUTED:
        inside, lit = _sphere(lighting, subject.dims)
        radiance = {name: coloured(render(lit, brdf).T, subject.model.bands).T for name, brdf in planes.items()}
        found[lighting] = {name: _round(displayed(pixels), inside, rim) for name, pixels in radiance.items()}
        if len(radiance) == 2:
            apart = np.clip(difference(radiance["file"], radiance["fit"]) / LARGEST_SHOWN, 0, 1)
            found[lighting]["difference"] = _round(mpl.colormaps["inferno"](apart, bytes=True)[:, :3], inside, rim)
    return found


def of_parts(subject: Subject) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What each effect adds to the sphere under the environment, of the material without the apparatus.

    Returns:
        pictures (side, side, 4) of bytes; shares of the light that the whole sphere sends, by channel.
    """
    inside, lit = _sphere("environment", subject.dims)
    above = subject.grid.above[..., : subject.dims[2] // 2]
    radiance = {name: render(lit, _where(above, brdf)).astype(np.float64) for name, brdf in subject.parts.items()}
    total = sum(radiance.values(), np.zeros(1)).sum(0)
    seen = {name: coloured(pixels.T, subject.model.bands).T for name, pixels in radiance.items()}
    pictures = {name: _round(displayed(pixels), inside) for name, pixels in seen.items()}
    return pictures, {name: pixels.sum(0) / total for name, pixels in radiance.items()}


@cache
def _sphere(lighting: Lighting, dims: Dims) -> tuple[np.ndarray, csr_array]:
    """Pixels of a square that are inside the sphere's disc, and their weights of all bins."""
    positions, inside = square(COMPUTED[lighting])
    return inside.ravel(), csr_array(sphere(lighting, positions[inside], dims, side_by_side), dtype=np.float32)


def _where(used: np.ndarray, brdf: np.ndarray) -> np.ndarray:
    """Values of some bins, as exact as a picture of bytes needs them."""
    return np.where(used, brdf, 0.0).astype(np.float32)


def square(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the pixels of a square, (side, side, 2), and which of them are inside the sphere's disc."""
    axis = (np.arange(side) + 0.5) / side * 2 - 1
    positions = np.stack(np.meshgrid(axis, -axis), -1)
    return positions, np.sum(positions**2, -1) < RIM


def _round(colours: np.ndarray, inside: np.ndarray, rim: float = 1.0) -> np.ndarray:
    """A picture (SIDE, SIDE, 4) of pixels inside the disc, up to a radius: its rim is as opaque as the disc covers it.

    The outermost pixel is coloured as those within it: it is partly past what is known.
    """
    side = int(np.sqrt(len(inside)))
    square = inside.reshape(side, side)
    centres = (np.arange(side) + 0.5) / side * 2 - 1
    known = square & (np.hypot(centres[:, None], centres) < rim - 2 / side)
    nearest = np.asarray(distance_transform_edt(~known, return_distances=False, return_indices=True))
    picture = np.zeros((side, side, 3), np.uint8)
    picture[square] = colours
    image = Image.fromarray(picture[tuple(nearest)]).resize((SIDE, SIDE), Image.Resampling.BICUBIC)
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    covered = np.clip((rim - np.hypot(axis[:, None], axis)) * SIDE / 2 + 0.5, 0, 1)
    return np.dstack([np.asarray(image), np.round(255 * covered).astype(np.uint8)])


@printable
def spheres(subject: Subject) -> Figure:
    """A row a light: file, fit, and their CIELAB difference."""
    found = of_file_and_fit(subject)
    columns = len(found["lamp"])
    figure = new((2.15 if columns == 3 else 3.7) + 0.5 * subject.titled)
    panels = figure.subplots(len(found), columns, squeeze=False)
    for k, (row, (lighting, pictures)) in enumerate(zip(panels, found.items(), strict=True)):
        for panel, (name, picture) in zip(row, pictures.items(), strict=True):
            show(panel, picture, name if k == 0 else "")
        row[0].set_ylabel(lighting)
    if columns == 3:
        scale = ScalarMappable(Normalize(0, LARGEST_SHOWN), "inferno")
        figure.colorbar(scale, ax=list(panels[:, -1]), extend="max", shrink=0.9).set_label("CIELAB distance")
    subject.head(figure)
    return figure


def show(panel: Axes, picture: np.ndarray, title: str) -> None:
    """A sphere before black."""
    panel.set_facecolor("black")
    panel.imshow(picture, extent=(-1, 1, -1, 1))
    panel.set(xticks=[], yticks=[], xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), title=title)


@printable
def effects(subject: Subject) -> Figure:
    """Spheres of each part under the environment, its lobe in the plane of incidence, and its share of the light.

    All are of the material, without the loss of the apparatus.
    """
    pictures, shares = of_parts(subject)
    figure = new(3.9)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1, 1.35))[:, 0]
    for panel, (name, picture) in zip(
        above.subplots(1, len(pictures), squeeze=False)[0], pictures.items(), strict=True
    ):
        show(panel, picture, part_name(name))
    lobes, bars = below.subplots(1, 2, width_ratios=(1.6, 1))
    _lobes(lobes, subject)
    _shares(bars, subject, shares)
    subject.head(figure, "without the loss of the apparatus")
    return figure


def _lobes(axis: Axes, subject: Subject) -> None:
    angles, found = added(subject, INCIDENCE_DEG)
    for k, (words, lobe) in enumerate(found.items()):
        axis.plot(angles, lobe, LINES[k % 4], color=OKABE_ITO[k % 8], label=words)
    at_mirror(axis, INCIDENCE_DEG)
    brightest = max(float(lobe.max()) for lobe in found.values())
    axis.set(
        yscale="log", ylim=(brightest / 10**DECADES, 3 * brightest), ylabel="BRDF (1/sr)", xlabel=r"$\theta_o$ (deg)",
        title=rf"channel {subject.channels[len(subject.channels) // 2]}, $\theta_i = {INCIDENCE_DEG}^\circ$",
    )  # fmt: skip
    axis.legend(loc="upper left")


def _shares(axis: Axes, subject: Subject, shares: dict[str, np.ndarray]) -> None:
    """Stacked bars, one a channel."""
    channels = subject.channels
    low = np.zeros(len(channels))
    for k, share in enumerate(shares.values()):
        axis.bar(
            channels, share, 0.7, low, color=OKABE_ITO[k % 8], hatch=HATCHES[k % 4], edgecolor="white", linewidth=0.4
        )
        low = low + share
    axis.set(ylim=(0, 1), title="share of the light")
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
