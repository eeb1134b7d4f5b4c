"""The picture of a fit of scattered directions: samples beside the fit, and parameters over the wavelength."""

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ...merl_io.scattered import ScatteredSamples
from ..fit.residuals import predict_samples
from ..fit.weights import weighted_samples
from ..pipeline.draws import NoPicture
from ..results.schema import Result
from .style import own_style, plain, symbol
from .subject import Subject

SHOWN = 3  # wavelengths whose samples are drawn
LEAST_DEG = 0.05  # theta_h that is drawn for 0
RATIOS = 1.02, 12.0  # of fit and file: how far the panels of ratios reach, at the least and at the most
CENTRAL = 0.99  # of the ratios is inside


@own_style()
def samples(subject: Subject) -> Figure:
    """Samples and fit over theta_h; their ratio over theta_h and theta_i; what is per channel over the wavelength."""
    m, result, measurement = subject.model, subject.result, subject.scattered
    if measurement is None:
        raise NoPicture("the file does not hold scattered directions, or is not there")
    samples = weighted_samples(measurement, theta_max=subject.theta_max)
    assert isinstance(samples, ScatteredSamples)
    fitted = predict_samples(m.measured, {k: jnp.asarray(x) for k, x in result.values().items()}, samples)
    per_channel = list(dict.fromkeys(q.parameter for q in result.parameters if q.channel is not None))
    figure = Figure(figsize=(15, 4.6 + 4.2 * bool(per_channel)), layout="constrained")
    rows = figure.add_gridspec(1 + bool(per_channel), 1)
    above = [figure.add_subplot(each) for each in rows[0].subgridspec(1, 3)]
    colours = _colours(np.array(m.wavelengths_um))
    theta_h = np.maximum(np.degrees(samples.theta_h), LEAST_DEG)
    _samples(above[0], theta_h, samples, fitted, subject.channels, colours)
    _ratios(above[1], theta_h, samples, fitted, colours)
    above[1].set(xscale="log", xlabel=r"$\theta_h$ (deg), logarithmic", ylabel="fit over file")
    _ratios(above[2], np.degrees(np.arccos(np.clip(samples.cos_i, -1, 1))), samples, fitted, colours)
    above[2].set(xlabel=r"$\theta_i$ (deg)", ylabel="fit over file")
    if per_channel:
        below = rows[1].subgridspec(1, len(per_channel))
        for k, name in enumerate(per_channel):
            _spectrum(figure.add_subplot(below[k]), result, name, m.wavelengths_um)
    subject.head(figure)
    return figure


def _colours(wavelengths_um: np.ndarray) -> np.ndarray:
    """From blue to red, in the order of the wavelengths."""
    placed = Normalize(wavelengths_um.min() - 1e-9, wavelengths_um.max() + 1e-9)
    return mpl.colormaps["turbo"](0.08 + 0.84 * placed(wavelengths_um))


def _samples(
    axis: Axes, theta_h: np.ndarray, samples: ScatteredSamples, fitted: np.ndarray, names: list[str],
    colours: np.ndarray,
) -> None:  # fmt: skip
    by_wavelength = np.argsort(samples.bands.wavelengths_um)
    for c in by_wavelength[np.unique(np.linspace(0, len(names) - 1, SHOWN).round().astype(int))]:
        used = samples.weight[c] > 0
        axis.plot(
            theta_h[used], samples.value[c, used], "o", markersize=3, fillstyle="none", color=colours[c],
            markeredgewidth=0.6, label=f"{names[c]} file",
        )  # fmt: skip
        axis.plot(theta_h[used], fitted[c, used], ".", markersize=1.5, color="black")
    axis.plot([], [], ".", markersize=3, color="black", label="fit at the same directions")
    axis.set(xscale="log", yscale="log", xlabel=r"$\theta_h$ (deg), logarithmic", ylabel="BRDF (1/sr)",
             title="samples within theta_max")  # fmt: skip
    axis.legend(fontsize=8)
    axis.grid(alpha=0.2)


def _ratios(axis: Axes, angle: np.ndarray, samples: ScatteredSamples, fitted: np.ndarray, colours: np.ndarray) -> None:
    """Fit over file of every sample and channel."""
    used = (samples.weight > 0) & (samples.value > 0) & (fitted > 0)
    ratio = np.where(used, fitted / np.where(used, samples.value, 1.0), np.nan)
    for c, colour in enumerate(colours):
        axis.plot(angle, ratio[c], ".", markersize=2, color=colour, alpha=0.5, rasterized=True)
    edges = np.nanquantile(ratio, [0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2])
    widest = float(np.clip(np.max(np.maximum(edges, 1 / edges)), *RATIOS))
    axis.axhline(1.0, color="gray", linewidth=0.8)
    axis.set(ylim=(1 / widest, widest), title="residuals: fit over file, all channels")
    if widest > 2:
        axis.set(yscale="log")
    axis.grid(alpha=0.2)


def _spectrum(axis: Axes, result: Result, name: str, wavelengths_um: list[float]) -> None:
    """A parameter over the wavelength, with its 90 % interval by the Laplace approximation where there is one."""
    entries = [q for q in result.parameters if q.parameter == name]
    order = np.argsort(wavelengths_um)
    um = np.array(wavelengths_um)[order]
    value = np.array([q.value for q in entries])[order]
    ends = np.array([(q.laplace.q05, q.laplace.q95) if q.laplace else (np.nan, np.nan) for q in entries])[order].T
    axis.plot(1e3 * um, value, "o-", markersize=3, linewidth=1.0, color="#2f5fb3")
    axis.fill_between(1e3 * um, *ends, alpha=0.25, linewidth=0, color="#2f5fb3")
    axis.set(
        xlabel="wavelength (nm)", ylabel=symbol(entries[0].symbol, name), title=plain(f"{name}: {entries[0].meaning}")
    )
    axis.grid(alpha=0.2)
