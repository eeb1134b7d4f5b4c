"""The two energy splits compared as fits: `python -m tests.energy_splits` writes results/splits.json and splits.md.

Neural reconstructions of ten MERL materials. The printed split is fitted as `merlfit fit` does; the conserving one goes
on from there, coarse grid first, then all bins: what is compared is one optimum with the other, not two searches.
"""

import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from merlfit.fitting.support.compilation import use_persistent_cache

from .support import refit
from .support.reconstructions import make

RESULTS = Path(__file__).parents[1] / "results"
STORE = RESULTS / "splits.json"
MATERIALS = {
    "nickel": "none", "brass": "none", "gold-metallic-paint2": "none", "aluminium": "none", "alum-bronze": "none",
    "gray-plastic": "plastic", "alumina-oxide": "plastic", "red-plastic": "plastic", "white-marble": "plastic",
    "yellow-phenolic": "plastic",
}  # fmt: skip
SHOWN = (
    "beta",
    "p",
    "b",
    "c",
    "sigma_s",
    "grazing_exponent",
    "grazing_exponent_diffracted",
    "n_G",
    "k_G",
    "eta_G",
    "albedo_G",
)


def told(fitted, seconds):
    """A fit as plain data."""
    solution = fitted.solution
    return {
        "cost": solution.cost, "rmse": fitted.errors.rmse, "converged": solution.converged,
        "seconds": round(seconds, 1), "parameters": dict(zip(fitted.layout.names, fitted.values.tolist(), strict=True)),
    }  # fmt: skip


def compared(path, body):
    material, start = refit.Material(path), time.perf_counter()
    printed = material.searched(body)
    middle = time.perf_counter()
    conserving = material.continued(printed, replace(printed.material, split="conserving"))
    seconds = middle - start, time.perf_counter() - middle
    both = {"printed": told(printed, seconds[0]), "conserving": told(conserving, seconds[1])}
    return {"material": path.stem, "body": body, **both}


def main(names):
    """All materials, or those named anew beside what is there."""
    use_persistent_cache()
    rows = [r for r in json.loads(STORE.read_text())["rows"] if r["material"] not in names] if names else []
    with tempfile.TemporaryDirectory() as folder:
        for name in names or MATERIALS:
            path = make(folder, name)
            rows.append(compared(path, MATERIALS[name]))
            path.unlink()
            print(json.dumps(rows[-1]), flush=True)
            write(rows)


def write(rows):
    what = f"{refit.WHAT}; {refit.STARS}"
    STORE.write_text(json.dumps({"what": what, "rows": rows}, indent=1) + "\n")
    lines = [
        f"Energy splits compared as fits, {len(rows)} of {len(MATERIALS)} materials. {what}. The printed split is "
        "searched for as `merlfit fit` does; the conserving one goes on from its optimum, which favours the former. "
        "Made by `python -m tests.energy_splits`.", "",
        "| material | body | split | cost | RMSE | " + " | ".join(SHOWN) + " |", "|" + "---|" * (5 + len(SHOWN)),
    ]  # fmt: skip
    for row in rows:
        for split in ("printed", "conserving"):
            r = row[split]
            cells = [f"{r['parameters'][q]:.4g}" if q in r["parameters"] else "" for q in SHOWN]
            head = [row["material"], row["body"], split, refit.cost(r["cost"], r["converged"]), f"{r['rmse']:.4g}"]
            lines.append("| " + " | ".join(head + cells) + " |")
    RESULTS.joinpath("splits.md").write_text("\n".join(["# Energy splits as fits", "", *lines]) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
