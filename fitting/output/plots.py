"""Pictures of a fit: its lobes beside the file's, and the corner plot of the posterior. They return figures."""

import textwrap
from functools import partial
from pathlib import Path

import corner
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullFormatter, NullLocator
from scipy.interpolate import RegularGridInterpolator

from ...merl_io.atomic import write_atomically
from ...merl_io.binary import Measurement
from ...merl_io.grid import MerlGrid, merl_grid
from ...model.geometry import Geometry
from ...model.reflectance import Reflectance, evaluate
from ..objective.weights import THETA_MAX, within
from ..pipeline.run import chain_of
from ..results.schema import Model, ParameterResult, Result
from ..support.tables import UNSOUND
from .report import number

INCIDENCES_DEG = (0, 20, 40, 60, 80)
WIDEST_DEG = 89.0  # of the viewers of the lobe plot
BAND_DRAWS = 100  # of the posterior, for the bands of the lobe plot
PEAK_DIFFERENCE_DEG = 5.0  # theta_d of the peak's panel
RATIO_AZIMUTHS = 7  # of 180, of the panels of residuals
LEAST_RATIO, MOST_RATIO = 1.3, 12.0  # of fit and file: how far these panels reach
RATIO_TICKS = 1.1, 1.25, 1.5, 2, 3, 5, 10
HIGHLIGHT = 0.1  # of the rise from the darkest datum to the peak: every datum that is brighter than this is drawn
CORNER_INCHES = 1.4  # of a panel
CORNER_LABEL, CORNER_VALUE, CORNER_TICK = 17, 12.5, 11.5  # sizes of letters, in points
WIDE_AXIS = 8.0  # times its lower end, from which on a logarithmic axis has ticks at 1, 3 or 10
WATERMARK = "CHAIN TOO SHORT"
UNITS = {"1": "", "um": "µm"}
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


def predicted_lobe(model: Model, values: dict, i: np.ndarray, o: np.ndarray, loss: bool = True) -> np.ndarray:
    """BRDF of the fitted material, (3, N): as the apparatus would have measured it, or without its loss."""
    return brdf_of(model, values, Geometry.from_vectors(i, o), loss)


def brdf_of(model: Model, values: dict, geometry: Geometry, loss: bool = True) -> np.ndarray:
    """BRDF of the fitted material, (C, ...): as the apparatus would have measured it, or without its loss."""
    seen = model.measured if loss else model.material
    return np.asarray(_compiled(seen, values, geometry, jnp.asarray(model.wavelengths_um)))


@partial(jax.jit, static_argnums=0)
def _compiled(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> Array:
    return evaluate(model, values, geometry, wavelengths_um)


@partial(jax.jit, static_argnums=0)
def _compiled_of_many(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> Array:
    return jax.lax.map(lambda v: evaluate(model, v, geometry, wavelengths_um), values)


def chain_file(result: Result, path: Path) -> dict[str, np.ndarray]:
    """Names, weighted draws (physical values) and weights of the posterior, from the chain beside the result.

    Args:
        path: of the result. Where the chain has another name than the result says, which a JSON cannot if it is no
            UTF-8, that of the result's own file counts.

    Raises:
        NoPicture: it was not sampled, or its chain is missing or of another fit.
    """
    if result.posterior is None:
        raise NoPicture("the posterior was not sampled")
    named = path.parent / Path(result.posterior.chain_file).name
    path = named if named.is_file() or not chain_of(path).is_file() else chain_of(path)
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


def states(result: Result, path: Path) -> np.ndarray | None:
    """All states of the walkers in free coordinates, (steps, walkers, P); None if the chain cannot be read."""
    assert result.posterior is not None
    try:
        with (
            (path.parent / result.posterior.chain_file).open("rb") as opened,
            np.load(opened, allow_pickle=False) as chain,
        ):
            return chain["chain_free"]
    except UNSOUND:
        return None


def band(result: Result, chain: dict[str, np.ndarray], i: np.ndarray, o: np.ndarray) -> np.ndarray:
    """5 and 95 % of what the posterior predicts for these directions, (2, 3, N)."""
    assert result.model is not None
    count = np.arange(BAND_DRAWS) + 0.5
    drawn = np.searchsorted(np.cumsum(chain["weights"]), count / BAND_DRAWS).clip(max=len(chain["weights"]) - 1)
    values = [result.values(chain["values"][k]) for k in drawn]
    stacked = {name: jnp.asarray([each[name] for each in values]) for name in values[0]}
    geometry, wavelengths = Geometry.from_vectors(i, o), jnp.asarray(result.model.wavelengths_um)
    lobes = _compiled_of_many(result.model.measured, stacked, geometry, wavelengths)
    return np.quantile(np.asarray(lobes), [0.05, 0.95], axis=0)


def lobe_figure(result: Result, measurement: Measurement, chain: dict[str, np.ndarray] | None = None) -> Figure:
    """File and fit: lobes in the plane of incidence, their peak, and the ratio of fit and file over all angles.

    Lobes have one panel an incidence, above with a cube root scale, below with a logarithmic one for shiny materials.
    Data are those of all rows of theta_h, in the highlight every one, elsewhere every third of a channel.
    The fit is drawn with the grazing loss of the apparatus and, dashed, without it.

    Args:
        chain: draws from the posterior (`chain_file`), of whose predictions 5 to 95 % are shaded.
    """
    assert result.model is not None
    figure = Figure(figsize=(15, 12), layout="constrained")
    rows = figure.add_gridspec(3, 1)
    specs = [rows[k].subgridspec(1, count) for k, count in enumerate((len(INCIDENCES_DEG), len(INCIDENCES_DEG), 3))]
    cubic, logarithmic = [], []
    for axes, spec in ((cubic, specs[0]), (logarithmic, specs[1])):
        for k in range(len(INCIDENCES_DEG)):
            axes.append(figure.add_subplot(spec[k], sharey=axes[0] if axes else None))
            axes[k].tick_params(labelleft=k == 0)
    _lobes(cubic, logarithmic, result, measurement, chain)
    peak, by_half, by_difference = (figure.add_subplot(specs[2][k]) for k in range(3))
    _peak(peak, result, measurement)
    _ratios(by_half, by_difference, result, measurement)
    origin = "genuine MERL measurement" if result.source.genuine_merl else "not a genuine MERL file"
    figure.suptitle(f"{result.source.material} ({origin}): fit of {result.model.material.words}")
    return figure


def _lobes(
    cubic: list[Axes], logarithmic: list[Axes], result: Result, measurement: Measurement,
    chain: dict[str, np.ndarray] | None,
) -> None:  # fmt: skip
    """File and fit in the plane of incidence, on two scales."""
    assert result.model is not None
    grid, values, loses = merl_grid(measurement.dims), result.values(), result.model.measured.loses
    brightest, darkest = 0.0, np.inf
    for k, degrees in enumerate(INCIDENCES_DEG):
        degrees_o, is_datum = viewers(degrees, np.degrees(grid.theta_h))
        i, o = plane_of_incidence(np.radians(degrees), np.radians(degrees_o))
        measured = measured_lobe(measurement, grid, *half_difference(i, o))
        fitted = predicted_lobe(result.model, values, i, o)
        alone = predicted_lobe(result.model, values, i, o, loss=False) if loses else fitted
        shaded = None if chain is None else band(result, chain, i, o)
        for c, name in enumerate(result.model.channels):
            colour, m = CHANNEL_COLOURS.get(name, "black"), measured[c]
            drawn = shown(np.where(is_datum, m, np.nan), np.cumsum(is_datum) % len(measured) == c)
            for axis, scale in ((cubic[k], np.cbrt), (logarithmic[k], np.asarray)):
                axis.plot(degrees_o, scale(fitted[c]), "-", linewidth=1.0, color=colour, label=f"{name} fitted")
                if loses:
                    axis.plot(degrees_o, scale(alone[c]), "--", linewidth=0.8, color=colour, alpha=0.7)
                if shaded is not None:
                    axis.fill_between(degrees_o, *scale(shaded[:, c]), alpha=0.2, linewidth=0, color=colour)
                axis.plot(degrees_o[drawn], scale(m[drawn]), "o", markersize=2.4, fillstyle="none", color=colour,
                          markeredgewidth=0.6)  # fmt: skip
        brightest = np.nanmax([brightest, np.nanmax(np.where(np.isfinite(measured), fitted, 0)), np.nanmax(measured)])
        darkest = np.nanmin([darkest, np.nanmin(np.where(measured > 0, measured, np.nan))])
        for axis in (cubic[k], logarithmic[k]):
            axis.axvline(degrees, color="gray", linewidth=0.6, linestyle=":")
            axis.set_xticks([-60, -30, 0, 30, 60])
            axis.grid(alpha=0.2)
        cubic[k].set(title=rf"$\theta_i = {degrees}^\circ$")
        logarithmic[k].set(xlabel=r"$\theta_o$ (deg), mirror side positive", yscale="log")
    cubic[0].set_ylabel(r"cube root of BRDF (sr$^{-1/3}$)")
    logarithmic[0].set_ylabel(r"BRDF (1/sr), logarithmic")
    cubic[0].set_ylim(0, 1.1 * np.cbrt(brightest))  # without the loss a fit is far brighter at grazing angles
    logarithmic[0].set_ylim(max(darkest, brightest / 1e6) / 2, 3 * brightest)
    cubic[0].plot([], [], "o", color="gray", fillstyle="none", markersize=2.4, label="file (every datum of the peak)")
    if loses:
        cubic[0].plot([], [], "--", color="gray", linewidth=0.8, label="fitted, without the grazing loss")
    if chain is not None:
        cubic[0].fill_between([], [], [], color="gray", alpha=0.3, linewidth=0, label="5 to 95 % of the posterior")
    cubic[0].legend(fontsize=8.5)


def viewers(incidence_deg: float, theta_h_deg: np.ndarray, between: int = 357) -> tuple[np.ndarray, np.ndarray]:
    """Angles of viewers in the plane of incidence (deg), sorted, and which of them see a row of theta_h.

    Args:
        between: number of others, evenly spread.

    Their number is the same for every incidence: one compiled program does for all.
    """
    rows = incidence_deg + 2 * np.concatenate([-theta_h_deg, theta_h_deg])
    seen = np.abs(rows) < WIDEST_DEG
    angles = np.concatenate([np.linspace(-WIDEST_DEG, WIDEST_DEG, between), np.where(seen, rows, WIDEST_DEG)])
    order = np.argsort(angles, kind="stable")
    return angles[order], np.concatenate([np.zeros(between, bool), seen])[order]


def shown(measured: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Which data of a channel are drawn: all of the highlight, elsewhere those of its turn. No mark hides another."""
    finite = np.isfinite(measured)
    if not finite.any():
        return finite
    low, high = np.nanmin(measured), np.nanmax(measured)
    return finite & (turn | (measured > low + HIGHLIGHT * (high - low)))


def _peak(axis: Axes, result: Result, measurement: Measurement) -> None:
    """Every datum of the highlight, at one theta_d and phi_d, against theta_h on a logarithmic scale."""
    assert result.model is not None
    grid = merl_grid(measurement.dims)
    d, p = int(np.argmin(np.abs(np.degrees(grid.theta_d) - PEAK_DIFFERENCE_DEG))), len(grid.phi_d) // 2
    seen = grid.theta_h < np.pi / 2 - grid.theta_d[d]
    theta_h = np.geomspace(grid.theta_h[0] / 1.5, grid.theta_h[seen][-1], 200)
    fitted = _predicted(result.model, result.values(), theta_h, grid.theta_d[d], grid.phi_d[p])
    for k, name in enumerate(result.model.channels):
        colour = CHANNEL_COLOURS.get(name, "black")
        axis.plot(np.degrees(theta_h), fitted[k], "-", linewidth=1.0, color=colour)
        data = measurement.values[k, seen, d, p]
        axis.plot(np.degrees(grid.theta_h[seen]), data, "os^"[k % 3], markersize=3.5, fillstyle="none", color=colour)
    axis.set(
        xscale="log", yscale="log", xlabel=r"$\theta_h$ (deg), logarithmic", ylabel="BRDF (1/sr)",
        title=rf"peak: every datum at $\theta_d = {np.degrees(grid.theta_d[d]):.1f}^\circ$, "
        rf"$\phi_d = {np.degrees(grid.phi_d[p]):.0f}^\circ$",
    )  # fmt: skip
    axis.grid(alpha=0.2, which="both")


def _predicted(
    model: Model, values: dict, theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike, loss: bool = True
) -> np.ndarray:
    """The fit's BRDF by half and difference angles, (3, ...)."""
    geometry = Geometry.from_half_difference(jnp.asarray(theta_h), jnp.asarray(theta_d), jnp.asarray(phi_d))
    return brdf_of(model, values, geometry, loss)


def _ratios(by_half: Axes, by_difference: Axes, result: Result, measurement: Measurement) -> None:
    """Fit over file: median over the other angles, with the middle 80 % shaded; dashed without the grazing loss."""
    assert result.model is not None
    grid = merl_grid(measurement.dims)
    d, p = np.arange(0, len(grid.theta_d), 2), np.linspace(0, len(grid.phi_d) - 1, RATIO_AZIMUTHS).astype(int)
    where = grid.theta_h[:, None, None], grid.theta_d[d][None, :, None], grid.phi_d[p][None, None, :]
    here = np.ix_(np.arange(len(grid.theta_h)), d, p)
    limit = float(result.config["fit"].get("theta_max", THETA_MAX))
    inside = (measurement.valid & grid.above & within(grid, limit))[here]
    widest = LEAST_RATIO
    lines = {"-": True, "--": False} if result.model.measured.loses else {"-": True}  # with the loss, without
    for line, loss in lines.items():
        fitted = _predicted(result.model, result.values(), *where, loss=loss)
        for k, name in enumerate(result.model.channels):
            file = measurement.values[k][here]
            ratio = np.where(inside & (file > 0), fitted[k] / np.where(inside & (file > 0), file, 1.0), np.nan)
            for axis, angle, others in ((by_half, grid.theta_h, (1, 2)), (by_difference, grid.theta_d[d], (0, 2))):
                some = np.isfinite(ratio).any(others)
                kept = ratio[some] if axis is by_half else ratio[:, some]
                low, middle, high = np.nanquantile(kept, [0.1, 0.5, 0.9], axis=others)
                colour = CHANNEL_COLOURS.get(name, "black")
                axis.plot(np.degrees(angle[some]), middle, line, linewidth=1.0, color=colour)
                if line == "-":
                    edges = np.concatenate([low, high])
                    widest = max(widest, float(np.quantile(np.maximum(edges, 1 / edges), 0.95)))
                    axis.fill_between(np.degrees(angle[some]), low, high, alpha=0.12, linewidth=0, color=colour)
    by_half.set(xscale="log", xlabel=r"$\theta_h$ (deg), logarithmic", ylabel="fit over file",
                title=r"residuals: fit over file, by $\theta_h$")  # fmt: skip
    by_difference.set(xlabel=r"$\theta_d$ (deg)", title=r"residuals: fit over file, by $\theta_d$")
    for axis in (by_half, by_difference):
        axis.axhline(1.0, color="gray", linewidth=0.8)
        widest = min(widest, MOST_RATIO)
        axis.set(yscale="log", ylim=(1 / widest, widest))
        shown = [x for x in RATIO_TICKS if widest**0.1 < x < widest]  # neither beyond the axis nor upon each other
        ticks = {1 / x: f"1/{x:g}" for x in shown} | {x: f"{x:g}" for x in shown}
        axis.set_yticks([1.0, *ticks], ["1", *ticks.values()])
        axis.set_yticks([], minor=True)
        axis.grid(alpha=0.2)
    by_difference.plot([], [], "-", color="gray", label="median (shaded: 10 to 90 %)")
    if len(lines) > 1:
        by_difference.plot([], [], "--", color="gray", label="median without the grazing loss")
    by_difference.legend(fontsize=8.5)


def corner_figure(result: Result, chain: dict[str, np.ndarray]) -> Figure:
    """Corner plot of the posterior's draws (`chain_file`); a chain that is too short gets a watermark.

    Parameters with log-normal priors have logarithmic axes. Over the diagonal are the fitted values and the quantiles
    of 5 and 95 % of the draws.
    """
    names, weights = result.parameters, chain["weights"].ravel()
    spread = [_interval(chain["values"][:, k], weights) for k in range(len(names))]
    scales = [
        "log" if "log-normal" in q.prior and low > 0 else "linear" for q, (low, *_) in zip(names, spread, strict=True)
    ]
    ranges = [
        _range(low, high, q.value, scale) for q, (low, _, _, high), scale in zip(names, spread, scales, strict=True)
    ]
    size = CORNER_INCHES * len(names) + 1.6
    figure = Figure(figsize=(size, size))
    corner.corner(
        chain["values"], weights=weights, truths=[q.value for q in names], fig=figure, range=ranges,
        axes_scale=scales,  # pyright: ignore[reportArgumentType] - a list is taken, too: its docstring
        smooth=1.0, plot_datapoints=False, truth_color="#c0392b", truth_kwargs={"markersize": 4, "linewidth": 0.9},
        fill_contours=True,
    )  # fmt: skip
    axes = np.array(figure.axes).reshape(len(names), len(names))
    for k, (q, (_, low, high, _)) in enumerate(zip(names, spread, strict=True)):
        label = _label(q)
        axes[-1, k].set_xlabel(label, fontsize=CORNER_LABEL)
        axes[-1, k].xaxis.set_label_coords(0.5, -0.5)
        if k:
            axes[k, 0].set_ylabel(label, fontsize=CORNER_LABEL)
            axes[k, 0].yaxis.set_label_coords(-0.5, 0.5)
        over = f"{q.name}\n{number(q.value, 3)}\n[{number(low, 3)}, {number(high, 3)}]"
        axes[k, k].set_title(over, fontsize=CORNER_VALUE, loc="left")  # to the right of it there is nothing
        for x in (low, high):
            axes[k, k].axvline(x, color="black", linewidth=0.8, linestyle="--")
        ticks = _ticks(*ranges[k], scales[k])
        said = [f"{x:g}" for x in ticks]
        for j in range(len(names)):
            if j >= k:
                _mark(axes[j, k].xaxis, ticks, said if j == len(names) - 1 else [])
            if j < k:
                _mark(axes[k, j].yaxis, ticks, said if j == 0 else [])
        axes[-1, k].tick_params(axis="x", labelsize=CORNER_TICK, labelrotation=45)
        axes[k, 0].tick_params(axis="y", labelsize=CORNER_TICK)
    figure.subplots_adjust(left=1.1 / size, bottom=1.1 / size, right=1 - 0.5 / size, top=1 - 1.1 / size,
                           wspace=0.08, hspace=0.08)  # fmt: skip
    figure.suptitle(
        f"{result.source.material}: posterior\nover the diagonal and red: fitted value; "
        "in brackets and dashed: 5 and 95 %", fontsize=CORNER_LABEL, x=0.98, ha="right",
    )  # fmt: skip
    if result.posterior is not None and not result.posterior.sufficient:
        _watermark(figure, result.posterior.message)
    return figure


def _label(q: ParameterResult) -> str:
    """Symbol, channel and unit."""
    unit = UNITS.get(q.unit, q.unit)
    return f"${q.symbol}$" + (f" {q.channel}" if q.channel else "") + (f" ({unit})" if unit else "")


def _interval(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Quantiles of weighted draws: 0.5, 5, 95 and 99.5 %."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) / weights.sum()
    found = np.searchsorted(reached, [0.005, 0.05, 0.95, 0.995]).clip(max=len(values) - 1)
    return values[order][found]


def _range(low: float, high: float, value: float, scale: str) -> tuple[float, float]:
    """What an axis shows: nearly all draws and the fitted value, with a margin."""
    forward, back = (np.log, np.exp) if scale == "log" else (np.asarray, np.asarray)
    a, b = (float(forward(x)) for x in (min(low, value), max(high, value)))
    margin = 0.05 * (b - a) or 0.05 * abs(a) or 1e-3
    return float(back(a - margin)), float(back(b + margin))


def _ticks(low: float, high: float, scale: str) -> list[float]:
    """Two to four round numbers."""
    if scale == "log" and high / low > WIDE_AXIS:
        decades = range(int(np.ceil(np.log10(low))), int(np.floor(np.log10(high))) + 1)
        found = [10.0**k for k in decades]
        if len(found) < 2:
            found = [x for k in range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high)))) for m in (1, 3)
                     if low <= (x := m * 10.0**k) <= high]  # fmt: skip
        return found[:: -(-len(found) // 4)] if found else [float(np.sqrt(low * high))]
    inner = (high - low) / 20
    found: list[float] = []
    for count in range(3, 9):
        steps = MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        found = [float(np.round(x, 12)) for x in steps if low + inner < x < high - inner]
        if len(found) > 1:
            break
    return found


def _mark(axis: Axis, ticks: list[float], said: list[str]) -> None:
    """Ticks of an axis, with or without words."""
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter(said) if said else NullFormatter())
    axis.set_minor_locator(NullLocator())


def _watermark(figure: Figure, message: str) -> None:
    """Across the picture, and why."""
    size = 4.5 * figure.get_figwidth()
    figure.text(0.5, 0.45, WATERMARK, fontsize=size, color="gray", alpha=0.4, rotation=35, ha="center", va="center")
    said = "\n".join(textwrap.wrap(message, 45))
    figure.text(0.98, 0.85, said, fontsize=CORNER_LABEL, color="#c0392b", ha="right", va="top")


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a PNG, atomically; OSError if it cannot be written."""
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=dpi))
