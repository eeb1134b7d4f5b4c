"""What each effect adds to a fit: reflection by facets, diffraction, and the body under the surface."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from .curves import added
from .spheres import PARTS, of_parts, show
from .style import DECADES, OKABE_ITO, at_mirror, new, printable
from .subject import Subject

INCIDENCE_DEG = 45
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
