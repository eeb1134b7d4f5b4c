"""Grazing exponents fitted freely against derived from the footprint: `python -m tests.grazing_exponent`.

Neural reconstructions of twelve MERL materials, each fitted with both exponents free as `merlfit fit` does, and from
there with them derived, and 0; writes results/grazing.json and results/grazing.md. Minutes a material; names
of materials may be given.
"""

import json
import sys
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.model.apparatus import APPARATUS, Apparatus
from merlfit.model.measured import Measured

from .support import refit
from .support.lobes import derived_exponent
from .support.reconstructions import make

RESULTS = Path(__file__).parents[1] / "results"
MATERIALS = {  # sharp to dull; the body is fixed, so that only the exponent differs between the fits
    "chrome": "none", "chrome-steel": "none", "tungsten-carbide": "none", "nickel": "none", "aluminium": "none",
    "brass": "none", "gold-metallic-paint": "none", "black-obsidian": "plastic", "specular-black-phenolic": "plastic",
    "alumina-oxide": "plastic", "blue-acrylic": "plastic", "red-fabric": "lambert",
}  # fmt: skip
STEPS = 100  # without an exponent, sharp metals take more than the default
LAMP = Apparatus(
    lamp_sigma_rad=2 * APPARATUS.footprint_rad
)  # blurs the half vector at normal incidence as the pixel does


def told(fitted):
    """A fit as plain data."""
    layout, solution = fitted.layout, fitted.solution
    values = layout.values(jnp.asarray(solution.z))
    where = layout.names.index("grazing_exponent") if "grazing_exponent" in layout.names else None
    free = where is not None and fitted.at_bound[where] == "no"
    k, diffracted = (float(fitted.layout.model.exponent(lobe, values)) for lobe in ("specular", "diffracted"))
    return {
        "status": fitted.status.name, "converged": solution.converged, "cost": solution.cost,
        "rmse": fitted.errors.rmse, "beta": float(values["beta"]), "p": float(values["p"]), "k": k,
        "k_diffracted": diffracted,
        "k_standard_error": float(fitted.standard_errors[where]) if free else None,
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


def compared(path, body):
    """All variants of one material; k derived both in the fit that uses it and from the lobe of the free fit."""
    material = refit.Material(path)
    free = material.searched(body, STEPS)
    others = {
        name: told(material.continued(free, Measured(free.material, how), STEPS, STEPS))
        for name, how in (("derived", "derived"), ("none", 0.0))
    }
    return with_derived({"material": path.stem, "body": body, "free": told(free), **others})


def with_derived(row):
    """A row with the exponents derived for its free lobe, and the footprint that its free exponent implies."""
    beta, p, k = (row["free"][name] for name in ("beta", "p", "k"))
    pixel, lamp = (
        float(derived_exponent(jnp.asarray(beta), jnp.asarray(p), apparatus)) for apparatus in (APPARATUS, LAMP)
    )
    return {**row, "k_pixel": pixel, "k_lamp": lamp, "implied_footprint_rad": implied_footprint(beta, p, k)}


def number(x, digits):
    return "" if x is None else f"{x:.{digits}f}"


def table(rows):
    lines = [
        "# Grazing exponents: free, derived, none", "", f"{refit.WHAT}.", "",
        f"Footprint `derived` takes: {APPARATUS.footprint_rad:g} rad ({APPARATUS.pixel_sigma_px:g} px on a sphere",
        f"of radius {APPARATUS.sphere_radius_px:g} px: an assumption).",
        "beta, p and k are of the free fit, k of specular light with its standard error (Laplace),",
        "kd of diffracted light. *k pixel* and *k lamp* derive from",
        f"that lobe, for a point lamp and for one with a spread of {LAMP.lamp_sigma_rad:g} rad; *k derived* is of the",
        "fit that uses it (its own beta and p, point lamp). Fits with k derived and 0 go on from the free one, at most",
        f"{STEPS} steps on either grid; {refit.STARS}. Where another is better than the free one, which",
        "contains it, the free one is at a local minimum. *Footprint*: what k free would take of",
        "an apparatus whose lamp has twice the footprint's spread; one apparatus would give one number.", "",
        "| material | body | beta | p | k free | k pixel | k lamp | k derived | kd free | kd derived | footprint (rad) "
        "| cost free | cost derived | cost k = 0 | RMSE free | RMSE derived | RMSE k = 0 |",
        "|---|---|" + "---:|" * 15,
    ]  # fmt: skip
    for row in rows:
        free, derived, none = row["free"], row["derived"], row["none"]
        error = number(free["k_standard_error"], 3)
        cells = [
            row["material"], row["body"], number(free["beta"], 4), number(free["p"], 3),
            number(free["k"], 3) + (f" ± {error}" if error else " (no error)"),
            number(row["k_pixel"], 3), number(row["k_lamp"], 3), number(derived["k"], 3),
            number(free["k_diffracted"], 3), number(derived["k_diffracted"], 3),
            number(row["implied_footprint_rad"], 4) or "none",
            *(refit.cost(v["cost"], v["converged"]) for v in (free, derived, none)),
            *(number(v["rmse"], 4) for v in (free, derived, none)),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(materials):
    use_persistent_cache()
    rows = []
    for material in materials:
        with tempfile.TemporaryDirectory() as folder:  # 35 MB a file, one at a time
            rows.append(compared(make(folder, material), MATERIALS[material]))
        print(json.dumps(rows[-1]), flush=True)
        save(rows)


def save(rows):
    RESULTS.mkdir(exist_ok=True)
    summary = {
        "what": refit.WHAT,
        "footprint_rad": APPARATUS.footprint_rad,
        "lamp_sigma_rad": LAMP.lamp_sigma_rad,
        "rows": rows,
    }
    (RESULTS / "grazing.json").write_text(json.dumps(summary, indent=2) + "\n")
    (RESULTS / "grazing.md").write_text(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:] or list(MATERIALS))
