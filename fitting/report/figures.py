"""What the page of a material shows: numbers of its charts, and its pictures."""

import io
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from jax import Array
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from ...merl_io.atomic import write_atomically
from ...merl_io.binary import DIMS, Dims, Measurement
from ...merl_io.grid import merl_grid
from ...merl_io.samples import folded
from ...model.geometry import Geometry
from ...model.reflectance import Reflectance, contributions, evaluate
from ...scene.colour import difference, displayed
from ..assess.picture import View, view
from ..objective.weights import THETA_MAX, within
from ..output import plots
from ..results.schema import Model, Result

INCIDENCES_DEG = (0, 15, 30, 45, 60, 75)
BETWEEN = 61  # viewers of a lobe that see no row of theta_h
ISOLINES_DEG = (30, 60)  # theta_i
ISOLINE_PIXELS = 121
LEVELS_A_DECADE = 3
SIDE = {"lamp": 224, "environment": 112}  # pixels of a sphere
THUMBNAIL = 72
LARGEST_SHOWN = 10.0  # CIELAB distance that is brightest in a picture of differences
FACTOR_SHOWN = 4.0  # of fit and file, at the ends of the error map's scale
HALVES_SHOWN = 6.0  # half widths that the plot of normalised peaks reaches to
INK = "#222222"
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Lobes:
    """Rows of charts, a row a direction and channel; what there is not is None.

    Attributes:
        plane: ``i``, ``o`` (deg), ``channel``, ``file``, ``fit``, ``alone`` (without the grazing loss), and ``low``,
            ``high`` of the posterior's predictions.
        parts: ``i``, ``o``, ``part``, ``value``: what each lobe and the body add, of the middle channel.
        peak: ``h`` (deg), ``channel``, ``file``, ``fit``, and both over their first value: ``file_rel``, ``fit_rel``.
        widths: theta_h (deg) at which a channel has fallen to half: ``channel``, ``file``, ``fit``.
    """

    plane: Rows
    parts: Rows
    peak: Rows
    widths: Rows


def lobes(result: Result, measurement: Measurement | None, chain: dict[str, np.ndarray] | None) -> Lobes:
    """Lobes in the plane of incidence, what they consist of, and the peak."""
    m, values = result.model, result.values()
    assert m is not None
    grid = merl_grid(_dims(measurement))
    rows_deg, parts_of = np.degrees(grid.theta_h), len(m.channels) // 2
    plane: Rows = []
    parts: Rows = []
    for degrees in INCIDENCES_DEG:
        angles, is_datum = plots.viewers(degrees, rows_deg, BETWEEN)
        i, o = plots.plane_of_incidence(np.radians(degrees), np.radians(angles))
        fit = plots.predicted_lobe(m, values, i, o)
        alone = plots.predicted_lobe(m, values, i, o, loss=False) if m.measured.loses else None
        file = None if measurement is None else plots.measured_lobe(measurement, grid, *plots.half_difference(i, o))
        shaded = None if chain is None else plots.band(result, chain, i, o)
        told = is_datum | (np.abs(angles) < plots.WIDEST_DEG)
        for c, channel in enumerate(m.channels):
            for k in np.flatnonzero(told):
                plane.append({
                    "i": degrees, "o": _short(angles[k], 5), "channel": channel, "fit": _short(fit[c, k]),
                    "file": _short(file[c, k]) if file is not None and is_datum[k] else None,
                    "alone": None if alone is None else _short(alone[c, k]),
                    "low": None if shaded is None else _short(shaded[0, c, k]),
                    "high": None if shaded is None else _short(shaded[1, c, k]),
                })  # fmt: skip
        added = _parts(m.material, values, Geometry.from_vectors(i, o), jnp.asarray(m.wavelengths_um))
        for name, brdf in added.items():
            lobe = np.asarray(brdf)[parts_of]
            parts += [
                {"i": degrees, "o": _short(angles[k], 5), "part": name, "value": _short(lobe[k])}
                for k in np.flatnonzero(told)
            ]
    peak, widths = _peak(result, measurement)
    return Lobes(plane, parts, peak, widths)


@partial(jax.jit, static_argnums=0)
def _parts(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> dict[str, Array]:
    return contributions(model, values, geometry, wavelengths_um)


def _short(x: float, digits: int = 4) -> float | None:
    return float(f"{x:.{digits}g}") if np.isfinite(x) else None


def _peak(result: Result, measurement: Measurement | None) -> tuple[Rows, Rows]:
    """Of file and fit at one theta_d and phi_d, over theta_h; as HP17 Fig. 15, also over their values at the origin."""
    m, grid = result.model, merl_grid(_dims(measurement))
    assert m is not None
    d = int(np.argmin(np.abs(np.degrees(grid.theta_d) - plots.PEAK_DIFFERENCE_DEG)))
    p = len(grid.phi_d) // 2
    seen = grid.theta_h < np.pi / 2 - grid.theta_d[d]
    theta_h = np.where(seen, grid.theta_h, grid.theta_h[seen][-1])  # of one shape for all
    geometry = Geometry.from_half_difference(
        jnp.asarray(theta_h), jnp.asarray(grid.theta_d[d]), jnp.asarray(grid.phi_d[p])
    )
    fit = plots.brdf_of(m, result.values(), geometry)
    file = np.full_like(fit, np.nan) if measurement is None else measurement.values[:, :, d, p]
    rows: Rows = []
    widths: Rows = []
    degrees = np.degrees(grid.theta_h)
    for c, channel in enumerate(m.channels):
        widths.append({"channel": channel, "file": _half(degrees, file[c]), "fit": _half(degrees, fit[c])})
        reach = HALVES_SHOWN * max(widths[-1]["fit"] or 0, widths[-1]["file"] or 0)
        rows += [
            {
                "h": _short(degrees[k]), "channel": channel, "file": _short(file[c, k]), "fit": _short(fit[c, k]),
                "file_rel": _short(file[c, k] / file[c, 0]), "fit_rel": _short(fit[c, k] / fit[c, 0]),
                "near": int(degrees[k] < reach),
            }
            for k in np.flatnonzero(seen)
        ]  # fmt: skip
    return rows, widths


def _half(degrees: np.ndarray, values: np.ndarray) -> float | None:
    """Where values that fall from the first one reach half of it, linear between; None where they do not."""
    below = np.flatnonzero(values < values[0] / 2)
    if not below.size or below[0] == 0:
        return None
    k = below[0]
    share = (values[k - 1] - values[0] / 2) / (values[k - 1] - values[k])
    return _short(degrees[k - 1] + share * (degrees[k] - degrees[k - 1]))


@partial(jax.jit, static_argnums=(0, 3))
def _all_bins(model: Reflectance, values: dict, wavelengths_um: Array, dims: Dims) -> Array:
    grid = merl_grid(dims)
    half = len(grid.phi_d) // 2
    geometry = Geometry.from_half_difference(
        jnp.asarray(grid.theta_h)[:, None, None], jnp.asarray(grid.theta_d)[:, None], jnp.asarray(grid.phi_d[:half])
    )
    return evaluate(model, values, geometry, wavelengths_um)


def all_bins(m: Model, values: dict, measurement: Measurement | None) -> np.ndarray:
    """The fit as the apparatus would have measured it, on the file's folded bins (C, H, D, P/2), or on MERL's."""
    return np.asarray(_all_bins(m.measured, values, jnp.asarray(m.wavelengths_um), _dims(measurement)))


def _dims(measurement: Measurement | None) -> Dims:
    return DIMS if measurement is None else measurement.dims


@cache
def _sphere(lighting: str, side: int, dims: Dims) -> tuple[np.ndarray, View]:
    """Pixels of a square that are inside the sphere's disc, and how to light them."""
    axis = (np.arange(side) + 0.5) / side * 2 - 1
    positions = np.stack(np.meshgrid(axis, -axis), -1).reshape(-1, 2)
    inside = np.sum(positions**2, -1) < 0.99
    return inside, view(lighting, positions[inside], dims)  # pyright: ignore[reportArgumentType] - one of its two


def spheres(measurement: Measurement | None, predicted: np.ndarray, theta_max: float) -> dict[str, Image.Image]:
    """Spheres under a lamp and an environment by name: ``LIGHT-file``, ``LIGHT-fit``, ``LIGHT-difference``.

    The two are compared where the file has data below ``theta_max`` (rad); without a file the fit is shown everywhere.
    """
    dims = _dims(measurement)
    grid, half = merl_grid(dims), dims[2] // 2
    if measurement is None:
        planes = {"fit": np.where(grid.above[..., :half], predicted, 0.0)}
    else:
        values, valid = folded(measurement)
        used = valid & within(grid, theta_max)[..., :half]
        planes = {"file": np.where(used, values, 0.0), "fit": np.where(used, predicted, 0.0)}
    found = {}
    for lighting, side in SIDE.items():
        inside, lit = _sphere(lighting, side, dims)
        radiance = {name: lit.render(brdf) for name, brdf in planes.items()}
        for name, pixels in radiance.items():
            found[f"{lighting}-{name}"] = _round(displayed(pixels), inside, side)
        if len(radiance) == 2:
            apart = np.clip(difference(radiance["file"], radiance["fit"]) / LARGEST_SHOWN, 0, 1)
            found[f"{lighting}-difference"] = _round(mpl.colormaps["inferno"](apart, bytes=True)[:, :3], inside, side)
    return found


def sphere_figure(pictures: dict[str, Image.Image]) -> Figure:
    """Pictures of :func:`spheres` of a file and its fit side by side, a row for each light."""
    columns = {"file": "file", "fit": "fit", "difference": rf"difference ($\Delta E$ up to {LARGEST_SHOWN:.0f})"}
    figure = Figure(figsize=(6.6, 4.6), layout="constrained")
    for row, lighting in zip(figure.subplots(len(SIDE), len(columns)), SIDE, strict=True):
        for panel, (what, title) in zip(row, columns.items(), strict=True):
            panel.imshow(pictures[f"{lighting}-{what}"])
            panel.set_axis_off()
            panel.set_title(f"{title}, {lighting}" if what == "file" else title, fontsize=9)
    return figure


def _round(colours: np.ndarray, inside: np.ndarray, side: int) -> Image.Image:
    picture = np.zeros((side * side, 4), np.uint8)
    picture[inside] = np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], 1)
    return Image.fromarray(picture.reshape(side, side, 4), "RGBA")


def error_map(measurement: Measurement, predicted: np.ndarray, theta_max: float) -> Figure:
    """Fit over file by theta_h and theta_d: the mean of the logarithm over phi_d and channels."""
    grid = merl_grid(measurement.dims)
    values, valid = folded(measurement)
    used = valid & within(grid, theta_max)[..., : valid.shape[-1]] & np.all((values > 0) & (predicted > 0), 0)
    ratio = np.where(used, np.log2(np.where(used, predicted, 1) / np.where(used, values, 1)).mean(0), 0.0)
    count = used.sum(-1)
    mean = np.where(count > 0, ratio.sum(-1) / np.maximum(count, 1), np.nan)
    figure = Figure(figsize=(4.6, 3.7), layout="constrained")
    axis, most = figure.subplots(), np.log2(FACTOR_SHOWN)
    edges = [np.degrees(edge) for edge in grid.edges[:2]]
    drawn = axis.pcolormesh(
        np.sqrt(edges[0] / 90), edges[1], mean.T, cmap="PuOr", norm=TwoSlopeNorm(0, -most, most), rasterized=True
    )
    ticks = [0, 1, 5, 15, 30, 60, 90]
    axis.set_xticks(np.sqrt(np.array(ticks) / 90), [str(x) for x in ticks])
    axis.set(xlabel=r"$\theta_h$ (deg), as MERL samples it", ylabel=r"$\theta_d$ (deg)", yticks=[0, 30, 60, 90])
    steps = [-2, -1, 0, 1, 2]
    bar = figure.colorbar(drawn, ax=axis, ticks=steps, extend="both")
    bar.ax.set_yticklabels(["1/4", "1/2", "1", "2", "4"])
    bar.set_label("fit over file")
    return figure


def isolines(result: Result, measurement: Measurement | None) -> Figure:
    """Isolines of the middle channel over all viewers, on the projected hemisphere (HP17 Fig. 14)."""
    m, values = result.model, result.values()
    assert m is not None
    middle, grid = len(m.channels) // 2, merl_grid(_dims(measurement))
    axis = np.linspace(-1, 1, ISOLINE_PIXELS)
    x, y = np.meshgrid(axis, axis)
    seen = x**2 + y**2 < np.sin(np.radians(plots.WIDEST_DEG)) ** 2
    o = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, np.cos(np.radians(plots.WIDEST_DEG)) ** 2))], -1)
    o = o / np.linalg.norm(o, axis=-1, keepdims=True)
    columns = 1 if measurement is None else 2
    figure = Figure(figsize=(2.9 * columns + 0.5, 2.9 * len(ISOLINES_DEG)), layout="constrained")
    panels = figure.subplots(len(ISOLINES_DEG), columns, squeeze=False)
    for row, degrees in zip(panels, ISOLINES_DEG, strict=True):
        i = np.broadcast_to([-np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))], o.shape)
        shown = {"fit": plots.predicted_lobe(m, values, i, o)[middle]}
        if measurement is not None:
            shown = {"file": plots.measured_lobe(measurement, grid, *_angles(i, o))[middle]} | shown
        logs = {
            name: np.where(seen & (lobe > 0), np.log10(np.where(lobe > 0, lobe, 1)), np.nan)
            for name, lobe in shown.items()
        }
        ends = np.nanquantile(np.concatenate([log[np.isfinite(log)] for log in logs.values()]), [0.002, 1])
        first, last = np.floor(ends[0] * LEVELS_A_DECADE), np.ceil(ends[1] * LEVELS_A_DECADE)
        levels = np.arange(first, last + 1) / LEVELS_A_DECADE
        scale = ScalarMappable(Normalize(levels[0], levels[-1]), "viridis")
        for panel, (name, log) in zip(row, logs.items(), strict=True):
            panel.contour(x, y, log, levels=levels, cmap=scale.cmap, norm=scale.norm, linewidths=1.0)
            panel.add_artist(Circle((0, 0), 1, fill=False, color=INK, linewidth=0.8))
            panel.plot(np.sin(np.radians(degrees)), 0, "+", color=INK, markersize=8)
            panel.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), xticks=[], yticks=[], frame_on=False)
            panel.set_title(rf"{name}, $\theta_i = {degrees}^\circ$", fontsize=10)
        bar = figure.colorbar(scale, ax=list(row), shrink=0.8)
        whole = levels[np.isclose(levels, np.round(levels))]
        bar.set_ticks(whole, labels=[f"$10^{{{int(np.round(x))}}}$" for x in whole])
        bar.set_label("BRDF (1/sr)")
    return figure


def _angles(i: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rusinkiewicz angles (rad) of any pairs of directions."""
    theta_h, theta_d, _ = plots.half_difference(i, o)
    across = 2 * np.sin(theta_h) * np.sin(theta_d)  # cos_o - cos_i = across cos(phi_d)
    cos_phi = (o[..., 2] - i[..., 2]) / np.maximum(across, 1e-12)
    return theta_h, theta_d, np.arccos(np.clip(cos_phi, -1, 1))


def trace(chain_free: np.ndarray, names: list[str]) -> Figure:
    """Walkers of a chain (steps, walkers, coordinates): quantiles of 5, 50 and 95 % of all walkers, step by step."""
    rows = -(-len(names) // 3)
    figure = Figure(figsize=(9, 1.3 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, 3, squeeze=False, sharex=True).ravel()
    low, middle, high = np.quantile(chain_free, [0.05, 0.5, 0.95], axis=1)
    steps = np.arange(len(chain_free))
    for k, (panel, name) in enumerate(zip(panels, names, strict=False)):
        panel.fill_between(steps, low[:, k], high[:, k], alpha=0.3, linewidth=0, color="#2f5fb3")
        panel.plot(steps, middle[:, k], linewidth=0.7, color="#2f5fb3")
        panel.set_title(name, fontsize=9)
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    for panel in panels[max(0, len(names) - 3) : len(names)]:
        panel.set_xlabel("step")
    return figure


def save_figure(figure: Figure, path: Path, dpi: int = 110) -> None:
    """As WebP, without loss; WriteError if it cannot be written."""
    figure.canvas  # noqa: B018 - makes the renderer
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    save_picture(Image.open(drawn), path, lossless=True)


def save_picture(picture: Image.Image, path: Path, lossless: bool = False) -> None:
    """As WebP, atomically."""
    write_atomically(path, lambda file: picture.save(file, "WEBP", quality=90, lossless=lossless))


def limit_of(result: Result) -> float:
    """Up to which angle (rad) the file was fitted."""
    return float(result.config["fit"].get("theta_max", THETA_MAX))
