"""Whether intervals from two disjoint halves of a material's bins agree."""

import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import numpy as np
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.result import parameter_results, with_quantiles
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.posterior.sampling import sample
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.threads import CORES
from merlfit.merl_io.binary import read

from .materials import TWELVE, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target

FOUR = ("nickel", "aluminium", "white-marble", "red-plastic")
COLUMN, ROW = np.arange(90)[:, None], np.arange(90)
HALVES = {
    "even phi_d": ROW % 2 == 0, "odd phi_d": ROW % 2 == 1, "low theta_d": COLUMN < 45, "high theta_d": COLUMN >= 45,
}  # fmt: skip
PAIRS = (("even phi_d", "odd phi_d"), ("low theta_d", "high theta_d"))


def half_of(samples, kept):
    """Only the bins that are kept, (D, P); the shape stays."""
    weight = samples.weight * kept
    part = np.sum(weight * samples.value**2) / np.sum(samples.weight * samples.value**2)
    return replace(samples, weight=weight, scatter=samples.scatter * float(part))


def intervals(measurement, samples, config):
    """Of a fit to these samples: intervals of its parameters, or why there are none."""
    fitted = fit(measurement, samples, config)
    with tempfile.TemporaryDirectory() as folder:
        chain = Path(folder) / "chain.npz"
        sampled = sample(fitted, samples, config.posterior.max_steps, config.seed, chain)
    return {
        "count": fitted.count, "message": sampled.posterior.message, "steps": sampled.posterior.diagnosis.steps,
        "k": sampled.posterior.pareto_k,
        "parameters": {
            q.name: [q.value, *((q.quantiles.q05, q.quantiles.q50, q.quantiles.q95) if q.quantiles else ())]
            for q in with_quantiles(parameter_results(fitted), sampled)
        },
    }  # fmt: skip


def measure(path, body):
    """Of every half: intervals of its parameters, or why there are none."""
    config, measurement = load(body=body), read(path)
    whole = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    return {name: intervals(measurement, half_of(whole, kept), config) for name, kept in HALVES.items()}


def apart(one, other):
    """Parameters whose intervals have no point in common; None without intervals of both."""
    pairs = {name: (a[1:], other["parameters"][name][1:]) for name, a in one["parameters"].items()}
    if not all(a and b for a, b in pairs.values()):
        return None
    return [name for name, (a, b) in pairs.items() if max(a[0], b[0]) > min(a[2], b[2])]


def overlap(one, other):
    """Share of the parameters whose intervals have a point in common; nan without intervals of both."""
    found = apart(one, other)
    return float("nan") if found is None else 1 - len(found) / len(one["parameters"])


def run(folder, out, every):
    """Twelve materials, or four."""
    record = Record(
        "halves", "Intervals from disjoint halves of the bins", RECONSTRUCTIONS,
        ["Every material is fitted and sampled four times, as `merlfit fit --body BODY` does it, on half of its bins: "
         "even and odd rows of phi_d, theta_d below and above 45 degrees. Overlap: share of the parameters whose 90 % "
         "intervals from both halves have a point in common. N: effective bins of the residuals of each half.",
         "A material one half of which failed a diagnostic has no intervals to compare, and counts for nothing."],
        {"phi": Target("intervals that overlap, even and odd phi_d", 80, "%", at_least=True),
         "theta": Target("intervals that overlap, low and high theta_d", 80, "%", at_least=True)},
        folder=out,
    )  # fmt: skip
    record.resume()
    left = [m for m in (TWELVE if every else FOUR) if m not in record.column("material")]
    with ThreadPoolExecutor(CORES) as pool:
        runs = {pool.submit(worker, "halves", file(folder, m), TWELVE[m]): m for m in left}
        for run in as_completed(runs):  # written as they end: one may take an hour
            material, (found, _) = runs[run], run.result()
            shares = {f"overlap {a}": overlap(found[a], found[b]) for a, b in PAIRS}
            counts = {f"N {name}": found[name]["count"] for name in HALVES}
            record.add({"material": material, "body": TWELVE[material], **shares, **counts}, found)
    for target, (a, _) in zip(("phi", "theta"), PAIRS, strict=True):
        record.set(target, 100 * np.nanmean(record.column(f"overlap {a}")))
    record.finish()
