"""What each effect adds to a fit: reflection by facets, diffraction, and the body under the surface."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from ...model.geometry import Geometry
from . import prediction
from .prediction import plane_of_incidence, viewers
from .spheres import PARTS, of_parts, show
from .style import FAINT, OKABE_ITO, new, printable
from .subject import Subject

INCIDENCE_DEG = 45
DECADES = 6.0  # that the logarithmic scale reaches below the brightest value
LINES = ("-", "--", "-.", ":")
HATCHES = ("", "////", "....", "xxxx")


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
        show(panel, picture, PARTS.get(name, name))
    lobes, bars = below.subplots(1, 2, width_ratios=(1.6, 1))
    _lobes(lobes, subject)
    _shares(bars, subject, shares)
    figure.suptitle(f"{subject.heading}\nwithout the loss of the apparatus")
    return figure


def _lobes(axis: Axes, subject: Subject) -> None:
    model = subject.model
    middle = len(model.channels) // 2
    angles, _ = viewers(INCIDENCE_DEG, np.degrees(subject.grid.theta_h))
    i, o = plane_of_incidence(np.radians(INCIDENCE_DEG), np.radians(angles))
    found = prediction.parts_of(subject.fitted, Geometry.from_vectors(i, o))
    brightest = max(float(lobe[middle].max()) for lobe in found.values())
    for k, (name, lobe) in enumerate(found.items()):
        axis.plot(angles, lobe[middle], LINES[k % 4], color=OKABE_ITO[k % 8], label=PARTS.get(name, name))
    axis.axvline(INCIDENCE_DEG, color=FAINT, linewidth=0.5, linestyle=":")
    axis.set(
        yscale="log", ylim=(brightest / 10**DECADES, 3 * brightest), ylabel="BRDF (1/sr)", xticks=[-90, -45, 0, 45, 90],
        xlabel=r"$\theta_o$ (deg)",
        title=rf"channel {subject.channels[middle]}, $\theta_i = {INCIDENCE_DEG}^\circ$",
    )  # fmt: skip
    axis.grid(alpha=0.25)
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
