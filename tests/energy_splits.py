"""The two energy splits compared as fits: `python -m tests.energy_splits` writes results/splits.json and splits.md.

Neural reconstructions of ten MERL materials. The printed split is fitted as `merlfit fit` does; the conserving one goes
on from there, coarse grid first, then all bins: what is compared is one optimum with the other, not two searches.
"""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from merlfit.fitting import metrics, run
from merlfit.fitting.compilation import use_persistent_cache
from merlfit.fitting.config import parse
from merlfit.fitting.levenberg_marquardt import solve
from merlfit.fitting.residuals import make_problem, weighted_samples
from merlfit.fitting.transforms import layout_of
from merlfit.merl_io.binary import read
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import thin

ROOT = Path(__file__).parents[1]
MAKER = ROOT.parent / "shared" / "data" / "make_merl.py"
RESULTS = ROOT / "results"
STORE = RESULTS / "splits.json"
MATERIALS = {
    "nickel": "none", "brass": "none", "gold-metallic-paint2": "none", "aluminium": "none", "alum-bronze": "none",
    "gray-plastic": "plastic", "alumina-oxide": "plastic", "red-plastic": "plastic", "white-marble": "plastic",
    "yellow-phenolic": "plastic",
}  # fmt: skip
COARSE_STEPS, FULL_STEPS = 60, 20
SHOWN = ("beta", "p", "b", "c", "sigma_s", "grazing_exponent", "n_G", "k_G", "eta_G", "albedo_G")


def row_of(effects, z, solution, measurement, samples, whole, seconds):
    predicted = run.predict_samples(effects, z, samples, whole)
    errors = metrics.errors(
        measurement.values, np.concatenate([predicted, predicted[..., ::-1]], -1), measurement.valid, merl_grid()
    )
    layout = layout_of(effects)
    values = layout.values(jnp.asarray(z))
    flat = np.concatenate([np.ravel(values[q.name]) for q in layout.parameters])
    return {
        "cost": solution.cost, "rmse": errors.rmse, "converged": solution.converged, "seconds": round(seconds, 1),
        "parameters": dict(zip(layout.names, flat.tolist(), strict=True)),
    }  # fmt: skip


def compared(path, body):
    config = parse({"effects": {"body": body}, "posterior": {"enabled": False}}, "energy_splits")
    measurement = read(path)
    samples = weighted_samples(measurement)
    whole, coarse = make_problem(samples), make_problem(thin(samples, run.COARSE))
    start = time.perf_counter()
    fitted = run.fit(measurement, samples, config, lambda _: None, run._Clock())
    printed = fitted.solution
    first = row_of(fitted.effects, printed.z, printed, measurement, samples, whole, time.perf_counter() - start)
    effects = replace(fitted.effects, split="conserving")
    start = time.perf_counter()
    near = solve(effects, printed.z, coarse, COARSE_STEPS)
    conserving = solve(effects, near.z, whole, FULL_STEPS)
    second = row_of(effects, conserving.z, conserving, measurement, samples, whole, time.perf_counter() - start)
    return {"material": path.stem, "body": body, "printed": first, "conserving": second}


def main(names):
    """All materials, or those named anew beside what is there."""
    use_persistent_cache()
    rows = [r for r in json.loads(STORE.read_text())["rows"] if r["material"] not in names] if names else []
    with tempfile.TemporaryDirectory() as folder:
        for name in names or MATERIALS:
            subprocess.run([sys.executable, str(MAKER), folder, name], check=True, stdout=subprocess.DEVNULL)
            path = Path(folder) / f"{name}.binary"
            rows.append(compared(path, MATERIALS[name]))
            path.unlink()
            print(json.dumps(rows[-1]), flush=True)
            write(rows)


def write(rows):
    what = (
        "Neural reconstructions of MERL materials (Sztrajman et al. 2021), not measurements; cost of HP17 Eq. 56 "
        "relative to the measurement's weighted energy, RMSE in 1/sr; * not converged at the step limit"
    )
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
            star = "" if r["converged"] else r"\*"
            head = [row["material"], row["body"], split, f"{r['cost']:.4g}{star}", f"{r['rmse']:.4g}"]
            lines.append("| " + " | ".join(head + cells) + " |")
    RESULTS.joinpath("splits.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
