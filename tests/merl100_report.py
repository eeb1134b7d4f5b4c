"""Tables and pictures of the fits of all 100 materials: `python -m tests.merl100_report`, some minutes.

RMSE and sMAPE are on the 8,466 bins on which the published parameter sets are evaluated beside them: theta_h[1::3],
theta_d[1::3], phi_d[3::12], both directions at theta < 1.4.
"""

import csv
import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure
from merlfit.fitting.fit.error_metrics import SIN_FLOOR
from merlfit.fitting.fit.weights import weighted_samples, within
from merlfit.fitting.pipeline.models import layout_for, two_scale
from merlfit.fitting.pipeline.run import predict_samples
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.choices import THETA_MAX
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.binary import read
from merlfit.merl_io.grid import merl_grid
from merlfit.model import published
from merlfit.model.geometry import Geometry
from merlfit.scene.spheres import distances, render, sphere

from .bench.materials import file
from .bench.record import RECONSTRUCTIONS, cell, machine

OBJECTIVES = ("compressive", "adaptive", "none")
SETS = {
    "sgd": "SGD", "smooth": "Smooth", "cook-torrance": "Cook-Torrance (E2)", "he": "He",
    "cook-torrance-ngan": "Cook-Torrance (Ngan)",
}  # fmt: skip
BINS = np.ix_(np.arange(1, 90, 3), np.arange(1, 90, 3), np.arange(3, 180, 12))
SIDE = 44  # pixels of a sphere on the contact sheet
COLUMNS = 5  # of the contact sheet


def errors(measured, predicted, used):
    """RMSE and sMAPE of (3, 30, 30, 15) on the common bins, as ../shared/data/README.md defines them."""
    grid = merl_grid()
    theta_h, theta_d = grid.theta_h[BINS[0].ravel()], grid.theta_d[BINS[1].ravel()]
    cos_i = np.clip(grid.cos_i[BINS], 0, 1)
    measure = (np.sin(theta_h) * np.gradient(theta_h))[:, None, None] * np.sin(2 * theta_d)[:, None]
    weight = np.where(used, measure * cos_i**2 / np.maximum(np.sqrt(1 - cos_i**2), SIN_FLOOR), 0.0)
    m, p = (np.where(used, x, 0.0) for x in (measured, predicted))
    total = np.abs(m) + np.abs(p)
    smape = np.abs(m - p) / np.where(total > 0, total, 1.0)
    return (
        float(np.sqrt(np.sum(weight * (m - p) ** 2) / weight.sum() / 3)),
        float(smape[:, used].mean()),
    )


def by_name(layout, flat):
    """Parameters of a row as the model takes them."""
    return {
        q.name: np.array([flat[f"{q.name}_{ch}"] for ch in layout.channels]) if q.per_channel else flat[q.name]
        for q in layout.parameters
    }


def judged(row, path, pixels):
    """Errors of all fits and published sets of one material, and its spheres by objective."""
    grid, config, measurement = merl_grid(), load(posterior=False), read(path)
    samples = weighted_samples(measurement)
    used = (measurement.valid & within(grid, THETA_MAX))[BINS]
    measured = measurement.values[:, *BINS]
    lit = np.all(samples.weight > 0, 0)
    found, spheres = {}, {"measured": render(pixels, np.where(lit, samples.value, 0.0))}
    for objective in filter(row.__contains__, OBJECTIVES):
        fit = row[objective]
        layout = layout_for(config, two_scale(config, (fit["index"], fit["body"])))
        predicted = predict_samples(layout, layout.free(by_name(layout, fit["parameters"])), samples)
        unfolded = np.concatenate([predicted, predicted[..., ::-1]], -1)
        found[objective] = errors(measured, unfolded[:, *BINS], used)
        fit["picture"] = distances(samples.value, predicted, lit)[0]
        spheres[objective] = render(pixels, np.where(lit, predicted, 0.0))
    theta_h, theta_d, phi_d = grid.theta_h[BINS[0]], grid.theta_d[BINS[1]], grid.phi_d[BINS[2]]
    geometry = Geometry.from_half_difference(theta_h, theta_d, phi_d)
    for name in SETS:
        if row["material"] in published.materials(name):
            brdf = published.evaluate(row["material"], name, geometry, rescaled=True)
            found[name] = errors(measured, np.asarray(brdf), used)
    return found, spheres


def write(rows, folder):
    """two_scale.csv, two_scale.md, sorted_errors.png and a contact sheet of spheres for each of two objectives."""
    use_persistent_cache()
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    positions = np.stack(np.meshgrid(axis, -axis), -1).reshape(-1, 2)
    inside = np.sum(positions**2, -1) < 0.99
    pixels, table, spheres = sphere("lamp", positions[inside]), [], {}
    with TemporaryDirectory() as made:
        for row in rows:
            path = file(os.environ.get("MERL_RECONSTRUCTIONS", made), row["material"])
            found, spheres[row["material"]] = judged(row, path, pixels)
            table.append((row, found))
            if path.parent == Path(made):
                path.unlink()
    _csv(table, folder / "two_scale.csv")
    (folder / "two_scale.md").write_text(_markdown(table))
    _sorted_errors(table).savefig(folder / "sorted_errors.png", dpi=120)
    for objective in (o for o in ("compressive", "adaptive") if all(o in row for row, _ in table)):
        _contact_sheet(table, spheres, inside, objective).savefig(folder / f"spheres_{objective}.png", dpi=100)


def _csv(table, path):
    with path.open("w", newline="") as target:
        out, head = csv.writer(target), None
        for row, found in table:
            for objective in filter(row.__contains__, OBJECTIVES):
                fit = row[objective]
                line = {
                    "material": row["material"], "objective": objective, "index": fit["index"], "body": fit["body"],
                    "status": fit["status"], "weights": fit["weights"], "rmse": found[objective][0],
                    "smape": found[objective][1], **{k: fit[k] for k in ("cube_root", "log", "picture", "highlight")},
                    "cost": fit["cost"], "seconds": fit["seconds"], "at_bound": " ".join(fit["at_bound"]),
                    "parameters": json.dumps(fit["parameters"]),
                    **{f"{kind}_{name}": found[name][k] if name in found else ""
                       for name in SETS for k, kind in enumerate(("rmse", "smape"))},
                }  # fmt: skip
                if head is None:
                    out.writerow(head := list(line))
                out.writerow(f"{x:.6g}" if isinstance(x, float) else x for x in line.values())


def _beaten(table, objectives, which):
    """Materials on which the best of these objectives is better than every published set."""
    count = 0
    for _, found in table:
        rivals = [found[name][which] for name in SETS if name in found]
        count += min(found[o][which] for o in objectives if o in found) < min(rivals)
    return count


def _markdown(table):
    m = machine()
    lines = [
        "# The two-scale model on all 100 materials of MERL", "",
        f"Data: {RECONSTRUCTIONS}. Published parameter sets are evaluated as they were printed, Ngan's on the scale of "
        f"MERL's files. Machine: {m['cores']} cores of {m['processor']}; Python {m['python']}, jax {m['jax']}; "
        f"{m['date']}. Made by `make merl100`.", "",
        "RMSE (1/sr) and sMAPE on the bins theta_h[1::3], theta_d[1::3], phi_d[3::12] with both directions at "
        "theta < 1.4; dE: mean CIELAB distance of spheres under a lamp and an environment; peak: fitted over measured "
        "highlight (theta_h = 0, theta_d < 60 degrees). The three objectives: `--weights` compressive, adaptive, none. "
        "Seconds (s) are of the whole fit from the file, whatever else the machine did.",
        "", "| | compressive | adaptive | none |", "|---|---|---|---|",
    ]  # fmt: skip

    fitted = {objective: [(row, found) for row, found in table if objective in row] for objective in OBJECTIVES}

    def over(what, value):
        cells = (cell(value(objective)) if fitted[objective] else "-" for objective in OBJECTIVES)
        lines.append(f"| {what} | " + " | ".join(cells) + " |")

    over("materials fitted", lambda o: len(fitted[o]))

    over("median RMSE (1/sr)", lambda o: float(np.median([found[o][0] for _, found in fitted[o]])))
    over("median sMAPE", lambda o: float(np.median([found[o][1] for _, found in fitted[o]])))
    over("median dE", lambda o: float(np.median([row[o]["picture"] for row, _ in fitted[o]])))
    over("peak within a factor of two", lambda o: sum(0.5 <= row[o]["highlight"] <= 2 for row, _ in fitted[o]))
    over("RMSE below every published set", lambda o: _beaten(fitted[o], [o], 0))
    over("sMAPE below every published set", lambda o: _beaten(fitted[o], [o], 1))
    usable = ("CONVERGED", "AT_BOUND", "STEP_LIMIT")
    over("failed", lambda o: sum(row[o]["status"] not in usable for row, _ in fitted[o]))
    over("stopped at the step limit", lambda o: sum(row[o]["status"] == "STEP_LIMIT" for row, _ in fitted[o]))
    over("a parameter at a bound", lambda o: sum(bool(row[o]["at_bound"]) for row, _ in fitted[o]))
    over("median seconds from file to fit", lambda o: float(np.median([row[o]["seconds"] for row, _ in fitted[o]])))
    lines += [
        "", f"RMSE below every published set with one of the three objectives: {_beaten(table, OBJECTIVES, 0)} of "
        f"{len(table)}; sMAPE: {_beaten(table, OBJECTIVES, 1)}.", "",
        "Medians of the published sets: " + "; ".join(
            f"{said} RMSE {np.median([f[name][0] for _, f in table if name in f]):.3f}, sMAPE "
            f"{np.median([f[name][1] for _, f in table if name in f]):.3f} ({sum(name in f for _, f in table)} sets)"
            for name, said in SETS.items()) + ".", "",
        "![sorted errors](sorted_errors.png)", "", "Spheres: " + ", ".join(
            f"[{o}](spheres_{o}.png)" for o in OBJECTIVES[:2] if len(fitted[o]) == len(table)),
        "", "Parameters and all columns: [two_scale.csv](two_scale.csv).", "",
        "Sorted by dE of the compressive fit, the worst first.", "",
        "| material | interface, body | status | RMSE | sMAPE | dE | peak | adaptive: exponent | RMSE | dE | peak "
        "| none: RMSE | best published RMSE | s |", "|---" * 14 + "|",
    ]  # fmt: skip
    for row, found in sorted(table, key=lambda each: -each[0]["compressive"]["picture"]):
        c, a, plain = row["compressive"], row.get("adaptive"), found.get("none", ("-",))
        adapted = "----"
        if a:
            adapted = [cell(a["weights"]), cell(found["adaptive"][0]), cell(a["picture"]), cell(a["highlight"])]
        rivals = {name: found[name][0] for name in SETS if name in found}
        best = min(rivals, key=rivals.get)
        lines.append("| " + " | ".join([
            row["material"], f"{c['index']} {c['body']}", c["status"], *(cell(x) for x in found["compressive"]),
            cell(c["picture"]), cell(c["highlight"]), *adapted, cell(plain[0]), f"{cell(rivals[best])} {SETS[best]}",
            cell(c["seconds"]),
        ]) + " |")  # fmt: skip
    return "\n".join(lines) + "\n"


def _sorted_errors(table):
    """HP17 Fig. 11: errors of every model, each sorted by itself."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    names = [*OBJECTIVES, *SETS]
    for axis, which, unit in zip(figure.subplots(1, 2), (0, 1), ("RMSE (1/sr)", "sMAPE"), strict=True):
        for name in names:
            found = np.sort([f[name][which] for _, f in table if name in f])
            if not len(found):
                continue
            ours = name in OBJECTIVES
            axis.plot(np.linspace(0, 100, len(found)), found, lw=2.0 if ours else 1.0, ls="-" if ours else "--",
                      label=f"two-scale, {name}" if ours else f"{SETS[name]}, published")  # fmt: skip
        axis.set(yscale="log", xlabel="materials, each model sorted by itself (%)", ylabel=unit)
        axis.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=7)
    figure.suptitle("Two-scale fits and published parameter sets on 100 neural reconstructions of MERL", fontsize=10)
    return figure


def _display(radiance, exposure):
    return np.clip(radiance * exposure, 0, 1) ** (1 / 2.2)


def _contact_sheet(table, spheres, inside, objective):
    """Spheres under the lamp as measured, as fitted, and twice their difference, the worst first."""
    order = sorted((each for each in table if objective in each[0]), key=lambda each: -each[0][objective]["picture"])
    lines = -(-len(order) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * 2.6, lines * 1.12))
    figure.suptitle(f"Neural reconstruction, fit ({objective}), twice the difference; the worst first", fontsize=10)
    axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, (row, _) in zip(axes, order, strict=False):
        seen, drawn = spheres[row["material"]]["measured"], spheres[row["material"]][objective]
        exposure = np.clip(0.8 / max(np.quantile(seen.mean(-1), 0.95), 1e-6), 0.3, 20)
        left, right = _display(seen, exposure), _display(drawn, exposure)
        picture = np.ones((SIDE * SIDE, 3, 3))
        picture[inside] = np.stack([left, right, np.minimum(2 * np.abs(left - right), 1)], 1)
        axis.imshow(np.moveaxis(picture.reshape(SIDE, SIDE, 3, 3), 2, 1).reshape(SIDE, 3 * SIDE, 3))
        fit = row[objective]
        axis.set_title(f"{row['material']}  dE {fit['picture']:.2f}, peak {fit['highlight']:.2f}", fontsize=6, pad=2)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.005, top=0.965, hspace=0.25, wspace=0.03)
    return figure


if __name__ == "__main__":
    from .merl100 import FITS, FOLDER

    write(json.loads(FITS.read_text()), FOLDER)
