"""Grazing exponent fitted freely against derived from the footprint: `python -m tests.grazing_exponent`.

Makes neural reconstructions of twelve MERL materials, fits each with the exponent free, derived, and 0, and writes
results/grazing.json and results/grazing.md. Some minutes a material; names of materials may be given.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from merlfit.fitting import config
from merlfit.fitting.run import fit_file
from merlfit.model.acquisition import APPARATUS, Apparatus, derived_exponent

ROOT = Path(__file__).parents[1]
MAKER = ROOT.parent / "shared" / "data" / "make_merl.py"
RESULTS = ROOT / "results"
MATERIALS = {  # sharp to dull; the body is fixed, so that only the exponent differs between the fits
    "chrome": "none", "chrome-steel": "none", "tungsten-carbide": "none", "nickel": "none", "aluminium": "none",
    "brass": "none", "gold-metallic-paint": "none", "black-obsidian": "plastic", "specular-black-phenolic": "plastic",
    "alumina-oxide": "plastic", "blue-acrylic": "plastic", "red-fabric": "lambert",
}  # fmt: skip
WHAT = (
    "Neural reconstructions of MERL materials (Sztrajman et al. 2021), not measurements: their sharp peaks are lower "
    "than measured, and a network may smooth away what the apparatus did."
)
MAX_STEPS = 100  # without an exponent, sharp metals take more than the default
LAMP = Apparatus(
    lamp_sigma_rad=2 * APPARATUS.footprint_rad
)  # blurs the half vector at normal incidence as the pixel does


def fitted(path, out, acquisition, body):
    """One fit as plain data: exponent, cost, RMSE, lobe, body, status."""
    effects = {"acquisition": acquisition, "body": body}
    data = {"effects": effects, "fit": {"max_steps": MAX_STEPS}, "posterior": {"enabled": False}}
    settings = config.parse(data, "grazing_exponent")
    fit_file(path, out, settings)
    result = json.loads((out / f"{path.stem}.json").read_text())
    values = {q["name"]: q for q in result["parameters"]}
    exponent = values.get("grazing_exponent", {})
    return {
        "status": result["fit"]["status"], "max_steps": MAX_STEPS, "body": result["model"]["effects"]["body"],
        "cost": result["fit"]["cost"], "rmse": result["metrics"]["rmse"],
        "beta": values["beta"]["value"], "p": values["p"]["value"],
        "k": result["model"]["grazing_exponent"], "k_standard_error": exponent.get("standard_error"),
    }  # fmt: skip


def implied_footprint(beta, p, k):
    """Footprint (rad) at which an apparatus with a lamp of twice its spread would have this exponent; None if none."""

    def excess(footprint):
        wide = Apparatus(1.0, float(footprint), lamp_sigma_rad=2 * float(footprint))
        return float(derived_exponent(jnp.asarray(beta), jnp.asarray(p), wide)) - k

    low, high = np.log(1e-4), np.log(0.1)
    if not excess(np.exp(low)) < 0 < excess(np.exp(high)):
        return None
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(np.exp(middle)) < 0 else (low, middle)
    return float(np.exp(middle))


def compared(path, out):
    """All variants of one material; k derived both in the fit that uses it and from the lobe of the free fit."""
    variants = {"free": "free", "derived": "derived", "none": 0.0}
    fits = {name: fitted(path, out, acquisition, MATERIALS[path.stem]) for name, acquisition in variants.items()}
    return with_derived({"material": path.stem, **fits})


def with_derived(row):
    """A row with the exponents derived for its free lobe, and the footprint that its free exponent implies."""
    beta, p, k = (row["free"][name] for name in ("beta", "p", "k"))
    pixel, lamp = (
        float(derived_exponent(jnp.asarray(beta), jnp.asarray(p), apparatus)) for apparatus in (APPARATUS, LAMP)
    )
    return {**row, "k_pixel": pixel, "k_lamp": lamp, "implied_footprint_rad": implied_footprint(beta, p, k)}


def number(x, digits):
    return "" if x is None else f"{x:.{digits}f}"


def marked(fit):
    """Cost; starred where the solver met its limit of steps, with a dagger where no light at all would fit better."""
    star = f"\\*({fit['max_steps']})" if fit["status"] == "STEP_LIMIT" else ""
    return number(fit["cost"], 5) + star + ("†" if fit["cost"] > 1 else "")


def table(rows):
    lines = [
        "# Grazing exponent: free, derived, none", "", WHAT, "",
        f"Footprint `derived` takes: {APPARATUS.footprint_rad:g} rad ({APPARATUS.pixel_sigma_px:g} px on a sphere",
        f"of radius {APPARATUS.sphere_radius_px:g} px: an assumption).",
        "beta, p and k are of the free fit, k with its standard error (Laplace). *k pixel* and *k lamp* derive from",
        f"that lobe, for a point lamp and for one with a spread of {LAMP.lamp_sigma_rad:g} rad; *k derived* is of the",
        "fit that uses it (its own beta and p, point lamp). Cost of HP17 Eq. 56 relative to the measurement's weighted",
        "energy. \\*(n): the solver met its limit of n steps. †: above 1, the cost of predicting no light: such a fit",
        "is no global minimum and does not tell what the exponent is worth. Where another is better than the",
        "free one, which contains it, the free one is at a local minimum too. *Footprint*: what k free would take of",
        "an apparatus whose lamp has twice the footprint's spread; one apparatus would give one number.", "",
        "| material | body | beta | p | k free | k pixel | k lamp | k derived | footprint (rad) "
        "| cost free | cost derived | cost k = 0 | RMSE free | RMSE derived | RMSE k = 0 |",
        "|---|---|" + "---:|" * 13,
    ]  # fmt: skip
    for row in rows:
        free, derived, none = row["free"], row["derived"], row["none"]
        error = number(free["k_standard_error"], 3)
        cells = [
            row["material"], free["body"], number(free["beta"], 4), number(free["p"], 3),
            number(free["k"], 3) + (f" ± {error}" if error else " (no error)"),
            number(row["k_pixel"], 3), number(row["k_lamp"], 3), number(derived["k"], 3),
            number(row["implied_footprint_rad"], 4) or "none",
            *(marked(v) for v in (free, derived, none)),
            *(number(v["rmse"], 4) for v in (free, derived, none)),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(materials):
    rows = []
    for material in materials:
        with tempfile.TemporaryDirectory() as folder:  # 35 MB a file, one at a time
            subprocess.run([sys.executable, MAKER, folder, material], check=True, stdout=subprocess.DEVNULL)
            rows.append(compared(Path(folder) / f"{material}.binary", Path(folder)))
        print(json.dumps(rows[-1]), flush=True)
        save(rows)


def save(rows):
    RESULTS.mkdir(exist_ok=True)
    summary = {
        "what": WHAT,
        "footprint_rad": APPARATUS.footprint_rad,
        "lamp_sigma_rad": LAMP.lamp_sigma_rad,
        "rows": rows,
    }
    (RESULTS / "grazing.json").write_text(json.dumps(summary, indent=2) + "\n")
    (RESULTS / "grazing.md").write_text(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:] or list(MATERIALS))
