"""Seconds of a posterior by stage, and on how many materials its intervals are given."""

import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.posterior.sampling import sample
from merlfit.fitting.settings.config import load
from merlfit.merl_io.binary import read

from .materials import TWELVE, file
from .materials import every as every_material
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target

STAGES = {"posterior: tuning": "tuning", "posterior: step": "chain", "posterior: all data": "all bins"}
TOGETHER = 10  # materials of one process


def measure(folder, *materials):
    """Of each: what its posterior took, and how it ended."""
    return [one(Path(folder) / f"{material}.binary", material) for material in materials]


def one(path, material):
    """The fit of a file and its posterior."""
    config, measurement = load(), read(path)
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    fitted, reports = fit(measurement, samples, config), [("begin", time.perf_counter())]
    with tempfile.TemporaryDirectory() as scratch:
        sampled = sample(
            fitted, samples, config.posterior.max_steps, config.seed, Path(scratch) / "chain.npz",
            report=lambda stage: reports.append((stage, time.perf_counter())),
        )  # fmt: skip
    end = time.perf_counter()
    spent = dict.fromkeys([*STAGES.values(), "else"], 0.0)
    for (_, before), (stage, now) in pairwise(reports):
        kind = next((name for begins, name in STAGES.items() if stage.startswith(begins)), "else")
        spent[kind] += now - before
    spent["else"] += end - reports[-1][1]
    p = sampled.posterior
    return {
        "material": material, "interface, body": fitted.material.variant, "seconds": end - reports[0][1], **spent,
        "steps": p.diagnosis.steps, "autocorrelation": float(p.diagnosis.times.max()),
        "least size": float(min(p.effective_size.min(), p.diagnosis.bulk.min(), p.diagnosis.tail.min())),
        "Pareto k": p.pareto_k, "N": fitted.count, "retrainings left": p.chain.retrainings,
        "intervals": "yes" if p.sufficient else "no", "message": p.message,
    }  # fmt: skip


def run(folder, out, every):
    """All 100 materials, or twelve."""
    record = Record(
        "posterior", "Posteriors", RECONSTRUCTIONS,
        ["Every file is fitted as `merlfit fit` does it, and its posterior sampled: 32 walkers, until every coordinate "
         "has 400 effective draws and all other conditions of docs/statistics.md hold, or for 6000 steps. Seconds: of "
         f"the posterior alone, {TOGETHER} materials one after the other in a process, programs that the process has "
         "not loaded yet included; by stage: tuning, chain, weights of all bins, all else (choice of the few bins, "
         "derived quantities). least size: the smallest effective size of any coordinate, of the chain and of the "
         "weighted draws. retrainings left: of five, after each of which a chain begins anew."],
        {"seconds": Target("seconds of a posterior, median of the 12 materials of the other sections", 60, "s"),
         "aim": Target("the same, the aim", 30, "s"),
         "given": Target("materials with intervals", 95, "%", at_least=True)},
        folder=out,
    )  # fmt: skip
    record.resume()
    names = list(TWELVE) + ([m for m in every_material() if m not in TWELVE] if every else [])
    left = [m for m in names if m not in record.column("material")]
    for begin in range(0, len(left), TOGETHER):
        materials = left[begin : begin + TOGETHER]
        for material in materials:
            file(folder, material)
        for row in worker("posterior", Path(folder).resolve(), *materials)[0]:
            told = {k: row.pop(k) for k in ("message",)}
            record.add(row, told)
        twelve = [r["seconds"] for r in record.rows if r["material"] in TWELVE]
        record.set("seconds", np.median(twelve))
        record.set("aim", np.median(twelve))
        record.set("given", 100 * np.mean([given == "yes" for given in record.column("intervals")]))
        record.write()
    record.finish()
