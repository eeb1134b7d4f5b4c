"""The peak of file and fit over theta_h, and how wide it is in each channel (HP17 Fig. 15)."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from ...model.geometry import Geometry
from . import prediction
from .prediction import PEAK_DIFFERENCE_DEG
from .style import MARKS, channel_colour, new, printable
from .subject import Subject

HALVES_SHOWN = 6.0  # half widths that the plot of normalised peaks reaches to


@dataclass(frozen=True)
class Peak:
    """At one theta_d and phi_d.

    Attributes:
        theta_h_deg: of the rows above the horizon, (H,). file, fit: BRDF (1/sr), (C, H); the file's is NaN where there
            is none. file_half, fit_half: theta_h (deg) by channel at which it has fallen to half, None where it does
            not. theta_d_deg, phi_d_deg: where it is.
    """

    theta_h_deg: np.ndarray
    file: np.ndarray
    fit: np.ndarray
    file_half: list[float | None]
    fit_half: list[float | None]
    theta_d_deg: float
    phi_d_deg: float

    @property
    def reach_deg(self) -> float:
        """How far it is of interest how wide the peak is."""
        return min(HALVES_SHOWN * max([*filter(None, self.file_half + self.fit_half), 0.0]) or 90.0, 90.0)


def peak_of(subject: Subject) -> Peak:
    """The peak of a fit and its file."""
    grid = subject.grid
    d = int(np.argmin(np.abs(np.degrees(grid.theta_d) - PEAK_DIFFERENCE_DEG)))
    p = len(grid.phi_d) // 2
    seen = grid.theta_h < np.pi / 2 - grid.theta_d[d]
    where = (jnp.asarray(grid.theta_h[seen]), jnp.asarray(grid.theta_d[d]), jnp.asarray(grid.phi_d[p]))
    fit = prediction.brdf_of(subject.fitted, Geometry.from_half_difference(*where))
    file = np.full_like(fit, np.nan) if subject.measurement is None else subject.measurement.values[:, seen, d, p]
    degrees = np.degrees(grid.theta_h[seen])
    return Peak(
        degrees, file, fit, [half_width(degrees, x) for x in file], [half_width(degrees, x) for x in fit],
        float(np.degrees(grid.theta_d[d])), float(np.degrees(grid.phi_d[p])),
    )  # fmt: skip


def half_width(degrees: np.ndarray, values: np.ndarray) -> float | None:
    """Where values that fall from the first one reach half of it, linear between; None where they do not."""
    below = np.flatnonzero(values < values[0] / 2)
    if not below.size or below[0] == 0:
        return None
    k = below[0]
    share = (values[k - 1] - values[0] / 2) / (values[k - 1] - values[k])
    return float(degrees[k - 1] + share * (degrees[k] - degrees[k - 1]))


@printable
def peak(subject: Subject) -> Figure:
    """Every datum of the peak against theta_h; beside it the same over its value at the origin, as in HP17 Fig. 15."""
    found, figure = peak_of(subject), new(2.35)
    whole, widths = figure.subplots(1, 2)
    near = found.theta_h_deg < found.reach_deg
    for c, name in enumerate(subject.channels):
        colour = channel_colour(name, c)
        mark = {"color": colour, "markersize": 2.0, "fillstyle": "none", "markeredgewidth": 0.5}
        whole.plot(found.theta_h_deg, found.fit[c], "-", color=colour)
        whole.plot(found.theta_h_deg, found.file[c], MARKS[c % len(MARKS)], label=name, **mark)
        widths.plot(found.theta_h_deg[near], (found.fit[c] / found.fit[c, 0])[near], "-", color=colour)
        widths.plot(
            found.theta_h_deg[near], (found.file[c] / found.file[c, 0])[near], MARKS[c % len(MARKS)], **mark
        )  # fmt: skip
    whole.set(xscale="log", yscale="log", xlabel=r"$\theta_h$ (deg)", ylabel="BRDF (1/sr)", title="every datum")
    whole.set_xticks([0.01, 0.1, 1, 10, 90], ["0.01", "0.1", "1", "10", "90"])
    whole.legend(title="marks: file\nlines: fit", title_fontsize=6.0, loc="lower left")
    widths.set(xlabel=r"$\theta_h$ (deg)", ylabel="BRDF over its value at 0", title="width by channel")
    for axis in (whole, widths):
        axis.grid(alpha=0.25)
    where = rf"$\theta_d = {found.theta_d_deg:.1f}^\circ$, $\phi_d = {found.phi_d_deg:.0f}^\circ$"
    figure.suptitle(f"{subject.heading}\n{where}")
    return figure
