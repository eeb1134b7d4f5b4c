"""Simulation-based calibration: ranks of the truth among draws from the posterior of synthetic materials."""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.objective.weights import weighted_samples
from merlfit.fitting.pipeline.run import fit, predict_samples
from merlfit.fitting.posterior.sampling import draw
from merlfit.fitting.settings.config import load
from merlfit.fitting.settings.models import layout_for, two_scale
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.fitting.support.threads import CORES
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.grid import merl_grid
from scipy.ndimage import gaussian_filter
from scipy.stats import chisquare

from .record import Record, Target

MATERIALS, FEW = 200, 20
KINDS = (("complex", "none"), ("real", "lambert"))  # in turn
BLUR = (1.0, 4.0, 16.0)  # bins along theta_h, theta_d, phi_d: deviations of the kernel that correlates the noise
ALIKE = 0.8  # correlation of the channels' noise
COST = (1e-3, 3e-2)  # of the noise, relative to the energy: log-uniform
BINS = 10  # of the histogram of ranks
TOLD = 10  # materials after which the table is written anew


def noise(rng, shape):
    """Unit variance, correlated along the angles and over the channels."""
    fields = np.array([gaussian_filter(rng.standard_normal(shape[1:]), BLUR, mode="wrap") for _ in range(4)])
    fields /= fields.std((1, 2, 3), keepdims=True)
    return np.sqrt(ALIKE) * fields[3] + np.sqrt(1 - ALIKE) * fields[:3]


def synthetic(seed):
    """Layout, truth in free coordinates and noisy samples of one material drawn from the prior."""
    rng, kind = np.random.default_rng([20261122, seed]), KINDS[seed % len(KINDS)]
    config = load(index=kind[0], body=kind[1])
    layout = layout_for(config, two_scale(config, kind))
    truth, grid = rng.standard_normal(layout.size), merl_grid()
    used = grid.above & (grid.weight > 0)
    blank = Measurement(Path(f"synthetic-{seed}"), np.ones((3, *used.shape)), used, 0, 0, 0, "", "")
    clean = predict_samples(layout, truth, weighted_samples(blank, 0.0, np.pi / 2))
    whole = np.concatenate([clean, clean[..., ::-1]], -1)
    measurement = replace(blank, values=np.where(used, whole, 0.0))
    samples = weighted_samples(measurement, config.rungs[0], config.fit.theta_max)
    energy = np.sum(samples.weight * samples.value**2)
    share = np.exp(rng.uniform(*np.log(COST)))
    root = np.sqrt(np.where(samples.weight > 0, samples.weight, np.inf))
    scale = np.sqrt(share * energy / np.sum(samples.weight > 0))
    return config, layout, truth, measurement, replace(samples, value=clean + scale * noise(rng, clean.shape) / root)


def measure(seed):
    """Rank of the truth by coordinate, and how the fit and the chain ended."""
    config, layout, truth, measurement, samples = synthetic(int(seed))
    fitted = fit(measurement, samples, config)
    told = {"body": layout.material.body}
    if fitted is None or not fitted.status.succeeded:
        return {**told, "message": "no fit" if fitted is None else fitted.status.name, "ranks": None}
    with tempfile.TemporaryDirectory() as folder:
        p = draw(fitted, samples, config.posterior.max_steps, config.seed, Path(folder) / "chain.npz")
    values, true = (np.asarray(jax.vmap(layout.flat)(jnp.asarray(z))) for z in (p.draws, truth[None]))
    ranks = p.weights @ (values < true)
    found = {"count": fitted.count, "message": p.message, "k": p.pareto_k, "steps": p.diagnosis.steps}
    return {**told, **found, "ranks": dict(zip(layout.names, ranks.tolist(), strict=True)) if p.sufficient else None}


def run(folder, out, every):
    """200 materials, or 20; the table is by parameter."""
    record = Record(
        "calibration", "Calibration by simulation",
        "synthetic: drawn from the priors of the fit, noise of the stated kind",
        ["Parameters are drawn from the prior (bodies none and lambert in turn). The noise is Gaussian, its variance "
         f"in proportion to 1/w, blurred over {BLUR} bins (standard deviations by theta_h, theta_d, phi_d), alike "
         f"by {ALIKE} in all channels; its cost is log-uniform in {COST} of the energy. Fitted and sampled as "
         "`merlfit fit` does it. Ranks: of the truth among the weighted draws, how many in each tenth; p: of a "
         "chi-square test that they are uniform; coverage: of the 90 % intervals."],
        {"p": Target("smallest p of the rank histograms", 0.01, "", at_least=True),
         "low": Target("smallest coverage of 90 % intervals", 85, "%", at_least=True),
         "high": Target("largest coverage of 90 % intervals", 95, "%")},
        folder=out,
    )  # fmt: skip
    kept = Record("calibration_runs", "Runs of the calibration", record.data, [], folder=out)
    kept.resume()
    seeds = range(len(kept.rows), MATERIALS if every else FEW)
    with ProcessPoolExecutor(CORES, get_context("spawn"), use_persistent_cache) as pool:
        for seed, found in zip(seeds, pool.map(measure, seeds), strict=True):
            kept.add({"seed": seed, "body": found["body"], "message": found["message"]}, found)
            if len(kept.rows) % TOLD == 0:
                tell(record, kept)
    kept.finish()
    tell(record, kept)
    record.finish()


def tell(record, kept):
    """The table of all materials so far, by parameter."""
    told = [r["details"] for r in kept.rows]
    good = [r for r in told if r["ranks"] is not None]
    record.rows.clear()
    if not good:
        return
    covered = []
    for name in dict.fromkeys(name for r in good for name in r["ranks"]):
        ranks = np.array([r["ranks"][name] for r in good if name in r["ranks"]])
        seen, inside = np.histogram(ranks, BINS, (0, 1))[0], (ranks > 0.05) & (ranks < 0.95)
        covered.extend(inside)
        row = {"parameter": name, "materials": len(ranks), "p": float(chisquare(seen).pvalue)}
        record.rows.append({**row, "coverage %": 100 * float(inside.mean()), "ranks": " ".join(map(str, seen))})
    record.notes[1:] = [
        f"{len(told)} materials so far, {len(told) - len(good)} of which failed the fit or a diagnostic and have no "
        f"intervals. Of all 90 % intervals together {100 * np.mean(covered):.1f} % hold the truth. Of a parameter with "
        "n intervals the coverage is known to 30 / sqrt(n) % (standard deviation, of exact intervals)."
    ]
    record.set("p", min(record.column("p")))
    record.set("low", min(record.column("coverage %")))
    record.set("high", max(record.column("coverage %")))
    record.write()
