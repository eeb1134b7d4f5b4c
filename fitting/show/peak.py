"""The peak of file and fit over theta_h, and how wide it is in each channel (HP17 Fig. 15)."""

from matplotlib.figure import Figure

from . import curves
from .style import DEGREES, channel_colour, marks, new, printable
from .subject import Subject


@printable
def peak(subject: Subject) -> Figure:
    """Every datum of the peak against theta_h; beside it the same over its value at the origin, as in HP17 Fig. 15."""
    found, figure = curves.peak(subject), new(2.35)
    whole, widths = figure.subplots(1, 2)
    for c, name in enumerate(subject.channels):
        for axis, brdf, kept in ((whole, found.brdf, slice(None)), (widths, found.relative, found.near)):
            axis.plot(found.theta_h_deg[kept], brdf["fit"][c][kept], "-", color=channel_colour(name, c))
            axis.plot(found.theta_h_deg[kept], brdf["file"][c][kept], label=name, **marks(name, c, 2.0, 0.5))
    whole.set(xscale="log", yscale="log", xlabel=r"$\theta_h$ (deg)", ylabel="BRDF (1/sr)", title="every datum")
    whole.set_xticks(DEGREES, [f"{x:g}" for x in DEGREES])
    whole.legend(title="marks: file\nlines: fit", title_fontsize=6.0, loc="lower left")
    widths.set(xlabel=r"$\theta_h$ (deg)", ylabel="BRDF over its value at 0", title="width by channel")
    for axis in (whole, widths):
        axis.grid(alpha=0.25)
    where = rf"$\theta_d = {found.theta_d_deg:.1f}^\circ$, $\phi_d = {found.phi_d_deg:.0f}^\circ$"
    figure.suptitle(f"{subject.heading}\n{where}")
    return figure
