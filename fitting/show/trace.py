"""The walkers of a chain, step by step."""

import textwrap

import numpy as np
from matplotlib.figure import Figure

from ..pipeline.draws import NoPicture
from .style import OKABE_ITO, SMALL, new, plain, printable
from .subject import Subject

COLUMNS = 3
ROW_INCHES = 0.68


@printable
def trace(subject: Subject) -> Figure:
    """The median of each free coordinate over all walkers, and 5 to 95 % of them, at every step after tuning."""
    subject.draws  # noqa: B018 - says so if there are none
    states, posterior = subject.walkers, subject.result.posterior
    if states is None or posterior is None:
        raise NoPicture("the chain has no states of its walkers")
    names = posterior.coordinates
    rows = -(-len(names) // COLUMNS)
    figure = new(ROW_INCHES * rows + 0.75)
    panels = figure.subplots(rows, COLUMNS, squeeze=False, sharex=True).ravel()
    low, middle, high = np.quantile(states, [0.05, 0.5, 0.95], axis=1)
    steps = np.arange(1, len(states) + 1)
    for k, (panel, name) in enumerate(zip(panels, names, strict=False)):
        panel.fill_between(steps, low[:, k], high[:, k], alpha=0.3, linewidth=0, color=OKABE_ITO[0])
        panel.plot(steps, middle[:, k], linewidth=0.5, color=OKABE_ITO[0])
        panel.set_title(plain("\n".join(textwrap.wrap(name.replace("_", " "), 18))), fontsize=SMALL)
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    for panel in panels[max(0, len(names) - COLUMNS) : len(names)]:
        panel.set_xlabel("step")
        panel.tick_params(labelbottom=True)
    figure.supylabel("free coordinate (its prior: mean 0, standard deviation 1)", fontsize=7)
    subject.head(figure)
    return figure
