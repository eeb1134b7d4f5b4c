"""Isolines of the BRDF over all viewers, on the projected hemisphere (HP17 Fig. 14)."""

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from . import prediction
from .prediction import WIDEST_DEG
from .style import INK, new, printable
from .subject import Subject

INCIDENCES_DEG = (30, 60)
PIXELS = 101
LEVELS_A_DECADE = 3
DARKEST = 0.002  # share of the directions that are darker than the first isoline


@printable
def isolines(subject: Subject) -> Figure:
    """Isolines of the middle channel, file beside fit, a row an incidence; the cross is the mirror direction."""
    columns = 1 if subject.measurement is None else 2
    middle = subject.channels[len(subject.channels) // 2]
    figure = new(1.6 * len(INCIDENCES_DEG) + 0.45)
    panels = figure.subplots(len(INCIDENCES_DEG), columns, squeeze=False)
    for row, degrees in zip(panels, INCIDENCES_DEG, strict=True):
        _row(figure, row, subject, degrees)
    subject.head(figure, f"channel {middle}, three isolines a decade; +: mirror direction")
    return figure


def _row(figure: Figure, row: np.ndarray, subject: Subject, degrees: float) -> None:
    x, y, logs = logarithms(subject, degrees)
    finite = np.concatenate([log[np.isfinite(log)] for log in logs.values()])
    first, last = np.quantile(finite, [DARKEST, 1]) * LEVELS_A_DECADE
    levels = np.arange(np.floor(first), np.ceil(last) + 1) / LEVELS_A_DECADE
    scale = ScalarMappable(Normalize(levels[0], levels[-1]), "viridis")
    for panel, (name, log) in zip(row, logs.items(), strict=True):
        panel.contour(x, y, log, levels=levels, cmap=scale.cmap, norm=scale.norm, linewidths=0.7)
        panel.add_artist(Circle((0, 0), 1, fill=False, color=INK, linewidth=0.5))
        panel.plot(np.sin(np.radians(degrees)), 0, "+", color=INK, markersize=5, markeredgewidth=0.7)
        panel.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), xticks=[], yticks=[], frame_on=False)
        panel.set_title(rf"{name}, $\theta_i = {degrees}^\circ$")
    bar = figure.colorbar(scale, ax=list(row), shrink=0.85)
    whole = levels[np.isclose(levels, np.round(levels))]
    bar.set_ticks(whole, labels=[f"$10^{{{int(np.round(x))}}}$" for x in whole])
    bar.set_label("BRDF (1/sr)")


def logarithms(subject: Subject, degrees: float) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Sines of the viewers (x, y), and the decimal logarithm of ``file`` and ``fit`` there; NaN where nothing is."""
    x, y = np.meshgrid(np.linspace(-1, 1, PIXELS), np.linspace(0, 1, PIXELS // 2 + 1))  # the other half is alike
    widest = np.radians(WIDEST_DEG)
    seen = x**2 + y**2 < np.sin(widest) ** 2
    o = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, np.cos(widest) ** 2))], -1)
    o = o / np.linalg.norm(o, axis=-1, keepdims=True)
    i = np.broadcast_to([-np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))], o.shape)
    middle, shown = len(subject.model.channels) // 2, {}
    if subject.measurement is not None:
        angles = prediction.half_difference(i, o)
        shown["file"] = prediction.measured_lobe(subject.measurement, subject.grid, *angles)[middle]
    shown["fit"] = prediction.predicted_lobe(subject.fitted, i, o)[middle]
    with np.errstate(invalid="ignore"):
        lit = {name: seen & (lobe > 0) for name, lobe in shown.items()}
    logs = {name: np.where(lit[name], np.log10(np.where(lit[name], x, 1)), np.nan) for name, x in shown.items()}
    whole = {name: np.concatenate([log[:0:-1], log]) for name, log in logs.items()}
    return np.concatenate([x[:0:-1], x]), np.concatenate([-y[:0:-1], y]), whole
