"""Pictures of a fit: lobes in the plane of incidence, and the corner plot of the posterior. They return figures."""

from pathlib import Path

import corner
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import RegularGridInterpolator

from ..merl_io.atomic import write_atomically
from ..merl_io.binary import Measurement
from ..merl_io.grid import MerlGrid, merl_grid
from ..model.geometry import Geometry
from ..model.two_scale import two_scale
from .export import Model, Result
from .report import in_words_of
from .tables import UNSOUND

matplotlib.use("Agg")
INCIDENCES_DEG = (0, 20, 40, 60, 80)
BAND_DRAWS = 100  # of the posterior, for the bands of the lobe plot
CHANNEL_COLOURS = {"R": "#c0392b", "G": "#2e8b57", "B": "#2f5fb3"}


class NoPicture(ValueError):
    """A picture that cannot be drawn; the message says why."""


def plane_of_incidence(theta_i: float, theta_o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of light (at ``-x``) and viewers at signed angles, positive on the mirror's side (rad)."""
    i = np.array([-np.sin(theta_i), 0.0, np.cos(theta_i)])
    o = np.stack([np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], -1)
    return np.broadcast_to(i, o.shape), o


def half_difference(i: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rusinkiewicz angles (rad) of pairs of directions in one plane with the normal: phi_d is 0 or pi there.

    cos_i = cos_h cos_d - sin_h sin_d cos(phi_d), so phi_d = 0 where the light is the lower of the two.
    """
    h = i + o
    theta_h = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    theta_d = np.arctan2(np.linalg.norm(i - o, axis=-1), np.linalg.norm(h, axis=-1))
    return theta_h, theta_d, np.where(i[..., 2] < o[..., 2], 0.0, np.pi)


def measured_lobe(
    measurement: Measurement, grid: MerlGrid, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> np.ndarray:
    """Measured BRDF (3, N) at some angles, linear between bin centres (for pictures only); NaN beside masked bins."""
    axes = (grid.theta_h, grid.theta_d, grid.phi_d)
    points = np.stack([np.clip(x, a[0], a[-1]) for x, a in zip((theta_h, theta_d, phi_d), axes, strict=True)], -1)
    return np.stack([RegularGridInterpolator(axes, plane)(points) for plane in measurement.values])


def predicted_lobe(model: Model, values: dict, i: np.ndarray, o: np.ndarray) -> np.ndarray:
    """What the apparatus would have measured of the fitted material, (3, N)."""
    geometry = Geometry.from_vectors(i, o)
    return np.asarray(two_scale(values, geometry, model.effects, model.wavelengths_um))


def chain_file(result: Result, folder: Path) -> dict[str, np.ndarray]:
    """Names, weighted draws (physical values) and weights of the posterior, from the chain beside the result.

    Raises:
        NoPicture: it was not sampled, is not to be trusted, or its chain is missing or of another fit.
    """
    if result.posterior is None:
        raise NoPicture("the posterior was not sampled")
    if not result.posterior.sufficient:
        raise NoPicture(result.posterior.message)
    path = folder / Path(result.posterior.chain_file).name
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as chain:
            found = {name: chain[name] for name in ("names", "values", "weights")}
    except UNSOUND as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "it is damaged, or no finished chain"
        raise NoPicture(f"{path}: cannot be read ({why})") from None
    if [str(n) for n in found["names"]] != [q.name for q in result.parameters]:
        raise NoPicture(f"{path}: is the chain of another fit")
    count, size = len(found["weights"].ravel()), len(result.parameters)
    if found["values"].shape != (count, size) or not all(np.isfinite(found[k]).all() for k in ("values", "weights")):
        raise NoPicture(f"{path}: is damaged: its draws are not {size} finite numbers each")
    return found


def band(result: Result, chain: dict[str, np.ndarray], i: np.ndarray, o: np.ndarray) -> np.ndarray:
    """5 and 95 % of what the posterior predicts for these directions, (2, 3, N)."""
    assert result.model is not None
    count = np.arange(BAND_DRAWS) + 0.5
    drawn = np.searchsorted(np.cumsum(chain["weights"]), count / BAND_DRAWS).clip(max=len(chain["weights"]) - 1)
    values = [result.values(chain["values"][k]) for k in drawn]
    stacked = {name: jnp.asarray([each[name] for each in values]) for name in values[0]}
    geometry, effects, wavelengths = Geometry.from_vectors(i, o), result.model.effects, result.model.wavelengths_um
    lobes = jax.jit(lambda all_: jax.lax.map(lambda v: two_scale(v, geometry, effects, wavelengths), all_))(stacked)
    return np.quantile(np.asarray(lobes), [0.05, 0.95], axis=0)


def lobe_figure(result: Result, measurement: Measurement, chain: dict[str, np.ndarray] | None = None) -> Figure:
    """Measured against fitted lobes in the plane of incidence, one panel an incidence, cube root scale.

    Args:
        chain: draws from the posterior (`chain_file`), of whose predictions 5 to 95 % are shaded.
    """
    assert result.model is not None
    grid, values = merl_grid(), result.values()
    theta_o = np.radians(np.linspace(-89, 89, 357))
    figure = Figure(figsize=(15, 4.5), layout="constrained")
    for axis, degrees in zip(figure.subplots(1, len(INCIDENCES_DEG), sharey=True), INCIDENCES_DEG, strict=True):
        i, o = plane_of_incidence(np.radians(degrees), theta_o)
        measured = measured_lobe(measurement, grid, *half_difference(i, o))
        fitted = predicted_lobe(result.model, values, i, o)
        shaded = None if chain is None else np.cbrt(band(result, chain, i, o))
        for k, (name, m, f) in enumerate(zip(result.model.channels, measured, fitted, strict=True)):
            style = {"color": CHANNEL_COLOURS.get(name, "black")}
            axis.plot(np.degrees(theta_o), np.cbrt(f), "-", linewidth=1.0, label=f"{name} fitted", **style)
            if shaded is not None:
                axis.fill_between(np.degrees(theta_o), *shaded[:, k], alpha=0.2, linewidth=0, color=style["color"])
            seen = slice(2 * k, None, 2 * len(measured))  # channels take turns: one does not hide another
            axis.plot(np.degrees(theta_o[seen]), np.cbrt(m[seen]), "o", markersize=3.2, fillstyle="none", **style)
        axis.axvline(degrees, color="gray", linewidth=0.6, linestyle=":")
        axis.set(title=rf"$\theta_i = {degrees}^\circ$", xlabel=r"$\theta_o$ (deg), mirror side positive")
        axis.set_xticks([-60, -30, 0, 30, 60])
        axis.grid(alpha=0.2)
    first = figure.axes[0]
    first.set_ylabel(r"cube root of BRDF (sr$^{-1/3}$)")
    first.plot([], [], "o", color="gray", fillstyle="none", markersize=3.2, label="file")
    if chain is not None:
        first.fill_between([], [], [], color="gray", alpha=0.3, linewidth=0, label="5 to 95 % of the posterior")
    first.legend(fontsize=7)
    body = in_words_of(result.model.effects)
    origin = "genuine MERL measurement" if result.source.genuine_merl else "not a genuine MERL file"
    figure.suptitle(f"{result.source.material} ({origin}): two-scale fit, {body}, with the acquisition's grazing loss")
    return figure


def corner_figure(result: Result, chain: dict[str, np.ndarray]) -> Figure:
    """Corner plot of the posterior's draws (`chain_file`)."""
    values, names = chain["values"], result.parameters
    best = [q.value for q in result.parameters]
    labels = [f"${q.symbol}$" if q.channel is None else f"${q.symbol}$ {q.channel}" for q in result.parameters]
    figure = Figure(figsize=(1.1 * len(names), 1.1 * len(names)))
    corner.corner(
        values, weights=chain["weights"], labels=labels, truths=best, quantiles=[0.05, 0.5, 0.95], fig=figure,
        range=[0.995] * len(names), smooth=1.0, plot_datapoints=False, label_kwargs={"fontsize": 9},
        truth_color="#c0392b", truth_kwargs={"markersize": 3, "linewidth": 0.8}, max_n_ticks=3, labelpad=0.25,
    )  # fmt: skip
    for axis in figure.axes:
        axis.tick_params(labelsize=6)
    figure.subplots_adjust(left=0.08, bottom=0.08)
    figure.suptitle(f"{result.source.material}: posterior (lines: fitted value, 5/50/95 % quantiles)")
    return figure


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a PNG, atomically; OSError if it cannot be written."""
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=dpi))
