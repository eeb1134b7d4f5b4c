"""All 100 materials of MERL: `python -m tests.merl100`, about half an hour on two cores; goes on where it was stopped.

Every material is fitted from its file as `merlfit fit` does it, with compressive weights and with none, and with each
of the weights that `--weights adaptive` tries: three objectives, compressive, adaptive, none. Tables and pictures are
`tests.merl100_report`. MERL_RECONSTRUCTIONS may name a folder in which to keep the files that are made, 3.5 GB.
"""

import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from merlfit.fitting.fit.selection import nearest
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import layout_for, two_scale
from merlfit.fitting.pipeline.run import descend, fit
from merlfit.fitting.results.storage import finite
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.clock import Clock
from merlfit.fitting.support.compilation import use_persistent_cache
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
        "index": fitted.material.index, "body": fitted.material.body, "status": fitted.status.name,
        "weights": fitted.exponent,
        "cost": s.cost, "steps": s.steps, "effective_bins": fitted.count, "seconds": seconds,
        "at_bound": [n for n, bound in zip(names, fitted.at_bound, strict=True) if bound != "no"],
        "parameters": dict(zip(names, fitted.values.tolist(), strict=True)),
        **{name: finite(x) for name, x in asdict(fitted.errors).items()},
    }  # fmt: skip


def searched(path, weights):
    """A file fitted as `merlfit fit` does it, and the kinds that were compared."""
    start, config = time.perf_counter(), load(posterior=False, weights=weights)
    measurement = read(path)
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    fitted = fit(measurement, samples, config)
    candidates = {"candidates": [c.model_dump() for c in fitted.candidates]} if weights == "compressive" else {}
    return {**candidates, weights: told(fitted, time.perf_counter() - start)}


def ladder(path, row):
    """The same material with one weight after the other, from where the compressive one ended."""
    start, config = time.perf_counter(), load(posterior=False, weights="adaptive")
    first = row["compressive"]
    layout, measurement = layout_for(config, two_scale(config, (first["index"], first["body"]))), read(path)
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    tried = descend(layout, layout.free(by_name(layout, first)), measurement, samples, config, Clock())
    spent = first["seconds"] + time.perf_counter() - start
    kept = nearest([(f.errors.picture, f.errors.highlight) for f in tried])
    every = [told(f, None) for f in tried]
    return {"adaptive": told(tried[kept], spent), "tried": every}


def by_name(layout, fit):
    """Parameters of a row as the model takes them."""
    flat = fit["parameters"]
    return {
        q.name: np.array([flat[f"{q.name}_{channel}"] for channel in layout.channels])
        if q.per_channel
        else flat[q.name]
        for q in layout.parameters
    }


def main(names=()):
    """Fit what is not there yet, all materials with the compressive weight first; then write tables and pictures."""
    use_persistent_cache()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows = {row["material"]: row for row in (json.loads(FITS.read_text()) if FITS.is_file() else [])}
    for stage in ("compressive", "none", "adaptive"):
        for material in names or every():
            row = rows.setdefault(material, {"material": material})
            if stage in row:
                continue
            with TemporaryDirectory() as made:
                path = file(os.environ.get("MERL_RECONSTRUCTIONS", made), material)
                row |= ladder(path, row) if stage == "adaptive" else searched(path, stage)
            text = json.dumps([rows[name] for name in sorted(rows)], indent=1) + "\n"
            write_atomically(FITS, lambda target, text=text: target.write(text.encode()))
            r = row[stage]
            print(
                f"{stage} {material}: {r['index']} {r['body']} RMSE {r['rmse']:.3g} sMAPE {r['smape']:.3g} "
                f"dE {r['picture']:.3g} peak {r['highlight'] or np.nan:.2f} {r['status']} {r['seconds']:.1f} s",
                flush=True,
            )
    merl100_report.write([rows[name] for name in sorted(rows)], FOLDER)


if __name__ == "__main__":
    main(sys.argv[1:])
