"""Synthetic spectral materials recovered from scattered directions; `make spectral` writes results/spectral.md.

31 wavelengths from 400 to 700 nm. Directions as a goniometer has them: seven incidences, viewers all over the
hemisphere and close around the mirror's direction; or those of the nodes of a file of RGL's kind (bsdf). Values come
from the model's own quadrature at every direction, of a higher order than that of the fit, and not from the tables that
the fit looks up.
"""

import json
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

import jax
import numpy as np
import typer
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.model.reflectance import evaluate
from merlfit.model.two_scale import TwoScale

from .support import rgl_files
from .support.compiled import from_vectors

ROOT = Path(__file__).parents[1]
WAVELENGTHS_UM = np.round(np.arange(0.40, 0.7001, 0.01), 3)
ORDER = 48  # of the convolution in the data; fits have 32
TARGET = 1e-3


def metal(um):
    """Index of a made-up metal: free electrons and one absorption band, as copper's has (Drude and Lorentz)."""
    energy = 1.2398 / um  # eV
    epsilon = 3.0 - 8.5**2 / (energy**2 + 0.1j * energy) + 14.0 / (2.9**2 - energy**2 - 1.1j * energy)
    root = np.sqrt(epsilon)
    return {"n": root.real, "k": np.abs(root.imag)}


def plastic(um):
    """Cauchy's dispersion, and the albedo of a red dye."""
    return {"eta": 1.47 + 0.0062 / um**2, "albedo": 0.04 + 0.5 / (1 + np.exp(-(um - 0.59) / 0.015))}


SURFACE = {"beta": 0.12, "p": 0.7, "b": 3.0, "c": 2.1, "sigma_s": 0.03}
CASES = {
    "metal": (TwoScale("none"), {**SURFACE, **metal(WAVELENGTHS_UM)}),
    "plastic": (TwoScale("plastic"), {**SURFACE, "beta": 0.08, "b": 1.6, **plastic(WAVELENGTHS_UM)}),
}
ROWS = {
    "metal": ("metal", 0.0, "csv"), "metal-noise": ("metal", 0.01, "csv"), "plastic": ("plastic", 0.0, "csv"),
    "plastic-noise": ("plastic", 0.01, "csv"), "plastic-rgl": ("plastic", 0.0, "bsdf"),
}  # fmt: skip


def directions(each=280, incidences=(0, 10, 20, 30, 45, 60, 70)):
    """theta_i, theta_o, phi (deg): half of the viewers even over the hemisphere, half around the mirror's direction."""
    k = np.arange(each // 2) + 0.5
    turn = k * np.pi * (3 - np.sqrt(5))
    rows = []
    for incidence in np.radians(incidences):
        wide = np.arccos(1 - k / len(k) * (1 - np.cos(np.radians(78))))
        o = np.stack([np.sin(wide) * np.cos(turn), np.sin(wide) * np.sin(turn), np.cos(wide)], -1)
        away = np.radians(30) * (k / len(k)) ** 2
        mirror = np.array([-np.sin(incidence), 0.0, np.cos(incidence)])
        across, up = np.array([0.0, 1.0, 0.0]), np.array([np.cos(incidence), 0.0, np.sin(incidence)])
        around = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
        near = np.cos(away)[:, None] * mirror + np.sin(away)[:, None] * around
        both = np.concatenate([o, near])
        both = both[both[:, 2] > np.cos(np.radians(79))]
        rows.append(np.stack([
            np.full(len(both), np.degrees(incidence)), np.degrees(np.arccos(both[:, 2])),
            np.degrees(np.arctan2(both[:, 1], both[:, 0])) % 360,
        ]))  # fmt: skip
    return np.concatenate(rows, 1)


def geometry(angles):
    theta_i, theta_o, phi = np.radians(angles)
    i = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1)
    o = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], -1)
    return from_vectors(i, o)


def values_of(model, truth, angles, wavelengths_um=WAVELENGTHS_UM):
    """BRDF, (C, N)."""
    fine = model if model.diffraction == "off" else type(model)(**{**model.__dict__, "order": ORDER})
    where = jax.tree.map(np.asarray, geometry(angles))
    compiled = jax.jit(lambda g: evaluate(fine, truth, g, wavelengths_um))
    parts = np.array_split(np.arange(angles.shape[1]), -(-angles.shape[1] // 250))
    return np.concatenate(
        [np.asarray(compiled(jax.tree.map(lambda x, rows=rows: x[rows], where))) for rows in parts], 1
    )


def write_csv(path, angles, values, names):
    head = ",".join(["theta_i_deg", "theta_o_deg", "phi_deg", *names])
    rows = np.concatenate([angles, values]).T
    path.write_text("\n".join([head, *(",".join(f"{x:.17g}" for x in row) for row in rows)]) + "\n")


def errors(result, truth):
    """Largest relative error by parameter."""
    found = result.values()
    return {name: float(np.max(np.abs(found[name] / truth[name] - 1))) for name in found}


def write_bsdf(path, model, truth):
    """A file of RGL's kind, float32: nodes around a lobe like the material's, values at the nodes' own directions."""
    where = rgl_files.parameterization(alpha=0.15, nodes=16)

    def brdf(theta_i, theta_o, phi):
        return values_of(model, truth, np.degrees([theta_i, theta_o, phi]))

    return rgl_files.write(path, rgl_files.made(where, brdf, 1e3 * WAVELENGTHS_UM))


def case(name, noise=0.0, seed=0, config=None, keep=None, form="csv"):
    """Fit one: the result and its largest relative errors.

    Args:
        noise: of the values, in CSV alone. form: of the file, csv or bsdf.
    """
    model, truth = CASES[name]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(keep or scratch)
        file = folder / f"{name}.{form}"
        if form == "bsdf":
            write_bsdf(file, model, truth)
        else:
            angles = directions()
            values = values_of(model, truth, angles)
            values = values * (1 + noise * np.random.default_rng(seed).standard_normal(values.shape))
            write_csv(file, angles, np.maximum(values, 1e-12), [f"{round(1e3 * x)}nm" for x in WAVELENGTHS_UM])
        result = fit_file(file, folder, config or load(posterior=False), report=lambda stage: print(stage, flush=True))
    return result, errors(result, truth)


def line(held):
    """A row of the table."""
    worst = max(held["errors"], key=held["errors"].get)
    right = held["kind"] == held["found"]
    missed = " **missed**" if held["noise"] == 0 and held["errors"][worst] > TARGET else ""
    return (
        f"| {held['material']} | {held['form']} | {held['noise']:.0%} | {held['samples']} x {held['wavelengths']} | "
        f"{held['status']} | {held['found']}{'' if right else ' (WRONG)'} | {held['cost']:.2g} | "
        f"{held['errors'][worst]:.3g} ({worst}){missed} | {held['seconds']['total']:.0f} | {held['date']} |"
    )


def measured(name, noise, form):
    """What the table and its JSON tell of a fit."""
    result, found = case(name, noise, form=form)
    return {
        "material": name, "form": form, "noise": noise, "samples": result.fit.bins,
        "wavelengths": len(result.model.channels), "status": result.fit.status, "kind": CASES[name][0].variant,
        "found": result.model.material.variant, "cost": result.fit.cost, "errors": found, "seconds": result.seconds,
        "date": datetime.now(UTC).date().isoformat(),
    }  # fmt: skip


def write(path, kept):
    """Both files."""
    path.write_text(json.dumps(kept, indent=1) + "\n")
    path.with_suffix(".md").write_text(
        f"# Spectral materials recovered\n\n{__doc__.split(chr(10), 2)[2].strip()}\n\n"
        f"Synthetic data; the target is {TARGET:.1%} in every parameter without noise. A fit compares the five kinds "
        "of material and knows nothing of the truth. Noise is relative, of every value, and independent. "
        "With noise the largest errors are those of what the data say little of: n of a metal at single wavelengths "
        "where k is many times larger, and b and c, which the little diffracted light fixes. A file of RGL's kind "
        "holds float32.\n\n"
        "| material | file | noise | samples x wavelengths | status | kind found | cost | largest relative error | s | "
        "date |\n" + "|---" * 10 + "|\n" + "\n".join(line(kept[key]) for key in ROWS) + "\n"
    )


def main(only: list[str] = typer.Argument(None, help=f"Of {', '.join(ROWS)}; all by default.")) -> None:
    """Fit, and write the table; rows that are not asked for stay as they are."""
    use_persistent_cache()
    path = ROOT / "results" / "spectral.json"
    kept = json.loads(path.read_text())
    for key in only or ROWS:
        kept[key] = measured(*ROWS[key])
        print(line(kept[key]), json.dumps(kept[key]["errors"]), flush=True)
    write(path, kept)
    exact = [each for each in kept.values() if each["noise"] == 0]
    sys.exit(0 if all(x <= TARGET for each in exact for x in each["errors"].values()) else "the target is missed")


if __name__ == "__main__":
    typer.run(main)
