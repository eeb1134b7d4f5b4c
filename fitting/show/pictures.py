"""Every picture of a fit by its name."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from .corner import corner, corner_all
from .isolines import isolines
from .lobes import lobes, peak
from .residual_maps import errors, residuals
from .sample_plots import samples
from .scans import scans
from .spheres import effects, spheres
from .subject import Subject
from .trace import trace


@dataclass(frozen=True)
class Picture:
    """A picture: what it shows, in words, and the function that draws it, which raises NoPicture where it cannot."""

    words: str
    draw: Callable[..., Figure]


PICTURES = {
    "spheres": Picture("spheres of file and fit, and their CIELAB difference", spheres),
    "lobes": Picture("lobes in the plane of incidence, with the bands of a posterior that was sampled", lobes),
    "isolines": Picture("isolines over all viewers, on the projected hemisphere", isolines),
    "peak": Picture("every datum of the peak, and its width in each channel", peak),
    "residuals": Picture("fit over file along theta_h and theta_d", residuals),
    "errors": Picture("maps of the errors over theta_h and theta_d", errors),
    "effects": Picture("what reflection, diffraction and body add", effects),
    "corner": Picture("corner plot of the posterior: shared parameters and one channel", corner),
    "corner-all": Picture("corner plot of all parameters, as wide as a page", corner_all),
    "trace": Picture("the walkers of the posterior's chain, step by step", trace),
    "samples": Picture("samples and fit, their ratio, and parameters over the wavelength", samples),
    "scans": Picture("samples against theta_s beside the fit, for each angle of incidence", scans),
}
OF_SCATTERED, OF_BINS = ("samples", "scans"), ("peak", "residuals", "errors")  # pictures of files of one kind


def usual(subject: Subject) -> list[str]:
    """Names of the pictures that suit the file."""
    return [name for name in PICTURES if name not in (OF_BINS if subject.scattered else OF_SCATTERED)]
