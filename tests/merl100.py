"""All 100 materials of MERL: `python -m tests.merl100`, about half an hour on two cores; goes on where it was stopped.

Every material is fitted from its file as `merlfit fit` does it, then once more with each of the weights that
`--weights adaptive` tries, which gives the fits of three objectives: compressive, adaptive, none. Tables and pictures
are `tests.merl100_report`.
"""

import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from merlfit.fitting.clock import Clock
from merlfit.fitting.compilation import use_persistent_cache
from merlfit.fitting.config import load
from merlfit.fitting.export import finite
from merlfit.fitting.run import descend, fit
from merlfit.fitting.selection import nearest
from merlfit.fitting.weights import weighted_samples
from merlfit.merl_io.atomic import write_atomically
from merlfit.merl_io.binary import read

from . import merl100_report
from .bench.materials import every, file

FOLDER = Path(__file__).parents[1] / "results" / "merl100"
FITS = FOLDER / "two_scale.json"


def told(fitted, seconds):
    """What is kept of one fit."""
    s, names = fitted.solution, fitted.layout.names
    return {
        "index": fitted.effects.index, "body": fitted.effects.body, "status": fitted.status.name,
        "weights": fitted.bend,
        "cost": s.cost, "steps": s.steps, "effective_bins": fitted.count, "seconds": seconds,
        "at_bound": [n for n, bound in zip(names, fitted.at_bound, strict=True) if bound != "no"],
        "parameters": dict(zip(names, fitted.values.tolist(), strict=True)),
        **{name: finite(x) for name, x in asdict(fitted.errors).items()},
    }  # fmt: skip


def measure(path):
    """Fits of one file with three objectives, and the scores of the kinds that were compared."""
    start = time.perf_counter()
    config = load(posterior=False)
    measurement = read(path)
    samples = weighted_samples(measurement, config.rungs[0], config.fit.theta_max)
    compressive = fit(measurement, samples, config)
    seconds = time.perf_counter() - start
    ladder = config.model_copy(update={"fit": config.fit.model_copy(update={"weights": "adaptive"})})
    tried = descend(compressive.layout, compressive.solution.z, measurement, samples, ladder, Clock())
    tried[0] = replace(compressive, bend=config.rungs[0])
    kept = nearest([(f.errors.picture, f.errors.highlight) for f in tried])
    spent = time.perf_counter() - start
    return {
        "material": path.stem, "candidates": [c.model_dump() for c in compressive.candidates],
        "compressive": told(compressive, seconds), "adaptive": told(tried[kept], spent),
        "none": told(tried[-1], spent), "tried": [told(f, None) for f in tried],
    }  # fmt: skip


def main(names=()):
    """Fit what is not there yet, then write tables and pictures."""
    use_persistent_cache()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows = json.loads(FITS.read_text()) if FITS.is_file() else []
    with TemporaryDirectory() as made:
        for material in names or every():
            if material in (row["material"] for row in rows):
                continue
            path = file(made, material)
            rows = sorted([*rows, measure(path)], key=lambda row: row["material"])
            path.unlink()
            text = json.dumps(rows, indent=1) + "\n"
            write_atomically(FITS, lambda target, text=text: target.write(text.encode()))
            row = next(r for r in rows if r["material"] == material)
            said = " | ".join(
                f"{name} {r['index']} {r['body']} RMSE {r['rmse']:.3g} sMAPE {r['smape']:.3g} dE {r['picture']:.3g} "
                f"peak {r['highlight'] or np.nan:.2f} {r['status']} {r['seconds']:.1f} s"
                for name, r in ((name, row[name]) for name in ("compressive", "adaptive", "none"))
            )
            print(f"{len(rows)} {material}: {said}", flush=True)
    merl100_report.write(rows, FOLDER)


if __name__ == "__main__":
    main(sys.argv[1:])
