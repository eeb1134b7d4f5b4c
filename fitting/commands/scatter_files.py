"""Files of optical design programs from a fit: Zemax' table of scatter, ABg and K-correlation, with their errors."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ...merl_io import zemax
from ...merl_io.atomic import write_text
from ...merl_io.inputs import MerlError
from ...merl_io.scattered import ScatteredMeasurement, vectors_of
from ..fit.total_scatter import COUNT, USUAL, of_values
from ..results.schema import Model, Result
from ..show.inspection import file_of
from ..show.prediction import Fitted, predicted_lobe
from ..support.numbers import number
from ..support.tables import table
from . import scatter_formulas
from .scatter_formulas import FORMULAS

MISPLACED = 0.01  # of the light of an incidence, that linear interpolation of a table may put elsewhere
LARGEST = 400_000  # values of a channel
LOOKED_AT = 5  # incidences at which a table is compared
PART = 2**14  # directions that are evaluated at once: one program
STEEPEST = 80.0  # degrees, of the incidences of a table

Axes = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Incidences, azimuths and radial angles of a table (degrees)."""


def evaluated(fitted: Fitted, light: np.ndarray, viewers: np.ndarray) -> np.ndarray:
    """BRDF of the material (1/sr), (C, ...), for unit vectors of light and viewer (..., 3)."""
    i, o = (np.broadcast_to(x, viewers.shape).reshape(-1, 3) for x in (light, viewers))
    count = len(o)
    i, o = (np.concatenate([x, np.repeat(x[:1], -count % PART, 0)]) for x in (i, o))
    parts = [predicted_lobe(fitted, i[k : k + PART], o[k : k + PART], loss=False) for k in range(0, len(o), PART)]
    return np.concatenate(parts, -1)[:, :count].reshape(-1, *viewers.shape[:-1])


def _on(fitted: Fitted, axes: Axes) -> np.ndarray:
    """BRDF on a table, (C, T, A, R); 0 below the horizon."""
    return evaluated(fitted, *zemax.vectors(*map(np.radians, axes)))


def axes_for(fitted: Fitted) -> tuple[Axes, np.ndarray]:
    """Axes of a table, refined until linear interpolation is near enough, or the table too large.

    Returns:
        and the share of the light that interpolation puts elsewhere half-way between nodes of all axes, by channel and
        incidence of a few, (C, K).
    """
    r = np.geomspace(1e-3, 60, 200)
    lobe = _on(fitted, (np.zeros(1), np.zeros(1), r))[:, 0, 0].max(0)
    width = max(float(r[np.argmax(lobe < (lobe[0] + lobe[-1]) / 2)]), 0.01)
    sizes = [9, 13, 17]

    def axes(sizes: list[int]) -> Axes:
        radial = width * np.sinh(np.linspace(0, np.arcsinh((90 + STEEPEST) / width), sizes[2]))
        return np.linspace(0, STEEPEST, sizes[0]), np.linspace(0, 180, sizes[1]), radial

    while True:
        at = axes(sizes)
        misplaced = _misplaced(fitted, at, (0, 1, 2))
        finer = [[2 * n - 1 if k == axis else n for k, n in enumerate(sizes)] for axis in range(3)]
        possible = [axis for axis in range(3) if np.prod(finer[axis]) <= LARGEST]
        if misplaced.max() <= MISPLACED or not possible:
            return at, misplaced
        sizes = finer[max(possible, key=lambda axis: _misplaced(fitted, at, (axis,)).max())]


def _misplaced(fitted: Fitted, axes: Axes, between: tuple[int, ...]) -> np.ndarray:
    """Share of the light that is elsewhere half-way between nodes along some axes, by channel and incidence."""
    few = np.unique(np.round(np.linspace(0, len(axes[0]) - 2, LOOKED_AT)).astype(int))
    ends = [axes[0][few + step] for step in ((0, 1) if 0 in between else (0,))]
    values = np.mean([_on(fitted, (theta_i, *axes[1:])) for theta_i in ends], 0)
    at = [np.mean(ends, 0), *((x[1:] + x[:-1]) / 2 if k in between else x for k, x in enumerate(axes) if k)]
    for axis in (2, 3):
        if axis - 1 in between:
            last = values.shape[axis] - 1
            values = (np.take(values, np.arange(last), axis) + np.take(values, np.arange(1, last + 1), axis)) / 2
    light, viewers = zemax.vectors(*map(np.radians, at))
    cosine = np.maximum(viewers[..., 2], 0.0) * np.sin(np.radians(at[2])) * np.gradient(at[2])
    own = evaluated(fitted, light, viewers)
    return np.sum(np.abs(values - own) * cosine, (-2, -1)) / np.sum(own * cosine, (-2, -1))


def _tis(result: Result, theta_i: np.ndarray) -> np.ndarray:
    """Of the fit at incidences (rad), (A,): (C, A)."""
    assert result.model is not None
    values = {name: np.asarray(x)[None] for name, x in result.values().items()}
    return of_values(result.model.material, values, result.model.bands, theta_i)[0]


def targets_of(path: Path, result: Result, to: str, out: Path) -> list[Path]:
    """Files that are written: of Zemax one for each channel."""
    if to != "zemax":
        return [out / f"{path.stem}.{to}.json"]
    return [] if result.model is None else [out / f"{path.stem}.{c}.zemax.bsdf" for c in result.model.channels]


def to_zemax(targets: list[Path], result: Result, said: str) -> list[str]:
    """Write a file for each channel; how near each is to the fit, in words."""
    assert result.model is not None
    model, fitted = result.model, Fitted.of(result.model, result.values())
    axes, misplaced = axes_for(fitted)
    values, theta_i = _on(fitted, axes), np.radians(axes[0])
    tis = _tis(result, theta_i)
    lines = []
    for channel, target in enumerate(targets):
        near = (
            f"interpolated linearly it has {misplaced[channel].mean():.2%} of the light elsewhere than the fit, "
            f"{misplaced[channel].max():.2%} at the worst incidence of {misplaced.shape[1]}"
        )
        remarks = (
            said, f"{1e3 * model.wavelengths_um[channel]:.10g} nm, channel {model.channels[channel]}",
            f"BRDF (1/sr), 0 below the horizon; TIS is the integral of BRDF cos(theta_s) of the fit; {near}",
        )  # fmt: skip
        zemax.write(target, axes, values[channel], tis[channel], remarks)
        found = zemax.read(target)
        some = np.linspace(0, len(found.phi) - 1, PART).astype(int)
        again = evaluated(fitted, *(x[some] for x in vectors_of(found)))[channel]
        apart = np.max(np.abs(found.values[0, some] - again) / again)
        lines.append(f"{target.name}: {near}; read back, its values differ from the fit's by {apart:.0e} at the most")
    return lines


def to_formulas(path: Path, target: Path, result: Result, to: str, said: str) -> Table:
    """Write parameters of formulas by incidence and channel; how near each is to the fit, as a table."""
    assert result.model is not None
    model, measured, rows = result.model, _file_at_hand(path, result), []
    fitted = Fitted.of(model, result.values())
    incidences = sorted({np.radians(q.theta_i_deg) for q in result.tis}) or USUAL.tolist()
    tis = _tis(result, np.array(incidences[:COUNT]))
    for k, theta_i in enumerate(incidences[:COUNT]):
        at = scatter_formulas.around(theta_i)
        light = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
        values = evaluated(fitted, light, at.o)
        for channel, (name, wavelength_um) in enumerate(zip(model.channels, model.wavelengths_um, strict=True)):
            for title, formula in FORMULAS[to].items():
                if own := _is_own(model, formula.model):
                    given = {name: float(np.ravel(x)[channel % np.size(x)]) for name, x in result.values().items()}
                    q = np.array(formula.given(given, wavelength_um))
                else:
                    q = scatter_formulas.nearest(formula, values[channel], at, np.cos(theta_i), wavelength_um)
                drawn = np.exp(formula.log(q, at.x, np.cos(theta_i) * at.o[:, 2], wavelength_um))
                beside = (
                    scatter_formulas.against(formula, q, measured, theta_i, channel)
                    if isinstance(measured, ScatteredMeasurement)
                    else None
                )
                rows.append({
                    "model": title, "fitted": own, "theta_i_deg": round(float(np.degrees(theta_i)), 3), "channel": name,
                    "wavelength_um": wavelength_um, "parameters": formula.told(q, wavelength_um),
                    "error": scatter_formulas.errors(drawn, values[channel], at.share), "error_to_file": beside,
                    "tis": scatter_formulas.tis_of(formula, q, theta_i, wavelength_um),
                    "tis_of_fit": float(tis[channel, k]),
                })  # fmt: skip
    told: dict[str, Any] = {
        "format": f"merlfit-{to} 1", "said": said,
        "models": {title: {"brdf": f.text, "source": f.source} for title, f in FORMULAS[to].items()},
        "fitted": "true where these are the parameters of the fit itself, which has this formula; else they are the "
        "nearest for that incidence",
        "x": "|beta - beta0|, beta the projection of the unit vector to the viewer, beta0 of the mirror direction",
        "error": "of the formula from the fit: log_rms of natural logarithms and sMAPE over viewers up to 80 degrees, "
        "as many at every x from 1e-4 on, which rises by a constant factor; error_to_file from the file's own samples",
        "rows": rows,
    }  # fmt: skip
    write_text(target, json.dumps(told, indent=2, allow_nan=False) + "\n")
    return _shown(rows)


def _is_own(model: Model, name: str) -> bool:
    """Whether a fit has a formula: it is of the model of that name, with nothing diffuse below."""
    return model.name == name and getattr(model.material, "diffuse", None) == "none"


def _shown(rows: list[dict[str, Any]]) -> Table:
    """What was written, with errors as factors."""
    formulas = sorted({row["model"] for row in rows})
    title = f"{' and '.join(formulas)}; off: by what factor of the BRDF, rms of logarithms"
    left = ("formula", "channel", "parameters")
    heads = ("formula", "light at", "channel", "parameters", "off the fit", "off the file", "TIS", "TIS of the fit")
    found = table(title, heads, left)
    for row in sorted(rows, key=lambda row: formulas.index(row["model"])):
        off = [None if error is None else np.exp(error["log_rms"]) for error in (row["error"], row["error_to_file"])]
        found.add_row(
            row["model"], f"{number(row['theta_i_deg'])} deg", row["channel"],
            ", ".join(f"{name} {number(x)}" for name, x in row["parameters"].items()),
            *("-" if x is None else f"{x:.2f}" for x in off), number(row["tis"]), number(row["tis_of_fit"]),
        )  # fmt: skip
    return found


def _file_at_hand(path: Path, result: Result) -> Any:  # noqa: ANN401 - a measurement of any kind, or None
    try:
        return result.source.read(file_of(path, result))
    except MerlError:
        return None
