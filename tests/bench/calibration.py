"""Simulation-based calibration: ranks of the truth among draws from the posterior of synthetic materials."""

import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache, partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.run import fit, predict_samples
from merlfit.fitting.posterior.sampling import draw
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.fitting.support.threads import CORES
from merlfit.merl_io import inputs
from merlfit.merl_io.binary import Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.scattered import alike
from scipy.ndimage import gaussian_filter1d
from scipy.stats import binom, norm

from ..measured import files_of
from ..measured_halves import half_of
from .record import Record, Target

MATERIALS, FEW = 200, 50  # with noise of each reach
OWN = "two-scale"
KINDS = {  # settings by model, of which materials take turns
    OWN: ({"index": "complex", "body": "none"}, {"index": "real", "body": "lambert"}),
    "ggx": ({"model": "ggx"},), "hp15": ({"model": "hp15"},),
    "epd+two-scale": ({"model": "epd+two-scale", "index": "complex", "body": "none"},),
}  # fmt: skip
RIVALS = tuple(name for name in KINDS if name != OWN)
# bins along theta_h, theta_d, phi_d: deviations of the kernel that correlates the noise
REACHES = {"short": (1.0, 4.0, 16.0), "long": (4.0, 16.0, 64.0)}
ALIKE = 0.8  # correlation of the channels' noise
SCATTERED = ("unstated", "stated")  # of directions of genuine files: whether the file says how uncertain values are
COST = (1e-3, 3e-2)  # of the noise, relative to the energy: log-uniform
STATED = (0.01, 0.1)  # typical uncertainty that a file states, relative to the value: log-uniform
APART = 3.0  # times that of a sample, or the same part of it, at the most: log-uniform
ROUNDS = 20  # in which weights become those of the noisy values
BINS = 10  # of the histogram of ranks
TOLD = 10  # materials after which the table is written anew
DRAWN = 4000  # samples of uniform ranks, by which others are judged
STRAYS = (
    "p: in how many of 4000 samples of uniform ranks their distribution strays as far anywhere, by the binomial "
    "probability there (simultaneous bands, Säilynoja et al. 2022)"
)
DATA = "synthetic: drawn from the priors of the fit, noise of the stated kind"
GENUINE = (
    "synthetic values, drawn from the priors of the fit, in directions and with residuals of genuine measurements: RGL "
    "EPFL material database (Dupuy & Jakob 2018), CC0"
)
WORDS = {
    "short": "short correlation", "long": "long correlation", "unstated": "residuals of genuine files",
    "stated": "residuals of genuine files and stated noise",
}  # fmt: skip
IN_BINS = (
    f"The noise is Gaussian, alike by {ALIKE} in all channels, and blurred: "
    f"{' and '.join(f'{k}, over {v} bins' for k, v in REACHES.items())} (standard deviations by theta_h, theta_d, "
    "phi_d, reflected where the grid ends; the same parameters and the same white noise for both), of variance 1/w "
    "times a number; its"
)
IN_DIRECTIONS = (
    "Directions are those of a genuine file of RGL, each once, twenty files in turn. The noise is what that file's own "
    "fit leaves (weighted residuals, with either sign, channels in any order) times a number. So it has the "
    "correlations and the few large residuals of genuine ones, and lacks what that fit took. Stated noise comes "
    f"besides: independent, of a typical {STATED[0]:.0%} to {STATED[1]:.0%} of the value (log-uniform by file), and "
    f"of up to {APART:g} times as much or as little (by sample), and the file says of how much. Both kinds "
    "have the same parameters and residuals. Of the residuals alone the"
)


def noise(rng, shape, reach):
    """Correlated along the angles and over the channels; of variance 1 everywhere."""
    fields = rng.standard_normal((4, *shape[1:]))
    for axis, deviation in enumerate(REACHES[reach], 1):
        fields = gaussian_filter1d(fields, deviation, axis, mode="reflect")
        answers = gaussian_filter1d(np.eye(fields.shape[axis]), deviation, 0, mode="reflect")
        fields /= np.expand_dims(np.linalg.norm(answers, axis=1), tuple({0, 1, 2, 3} - {axis}))
    return np.sqrt(ALIKE) * fields[3] + np.sqrt(1 - ALIKE) * fields[:3]


def synthetic(seed, reach, model):
    """Settings, layout, truth in free coordinates, measurement and noisy samples of a material of the prior."""
    rng, kinds = np.random.default_rng([20261122, seed]), KINDS[model]
    config, make = load(**kinds[seed % len(kinds)]), of_bins
    if reach in SCATTERED:
        config, make = config.for_scattered, of_directions
    layout = layout_for(config, candidates(config)[0])
    truth = rng.standard_normal(layout.size)
    return config, layout, truth, *make(rng, seed, reach, config, layout, truth)


def of_bins(rng, seed, reach, config, layout, truth):
    """Measurement without noise, whose values the weights are of, and samples with noise."""
    grid = merl_grid()
    used = grid.above & (grid.weight > 0)
    blank = Measurement(Path(f"synthetic-{seed}"), np.ones((3, *used.shape)), used, 0, 0, 0, "", "")
    clean = predict_samples(layout, truth, weighted_samples(blank, 0.0, np.pi / 2))
    whole = np.concatenate([clean, clean[..., ::-1]], -1)
    measurement = replace(blank, values=np.where(used, whole, 0.0))
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    energy = np.sum(samples.weight * samples.value**2)
    share = np.exp(rng.uniform(*np.log(COST)))
    root = np.sqrt(np.where(samples.weight > 0, samples.weight, np.inf))
    scale = np.sqrt(share * energy / np.sum(samples.weight > 0))
    noisy = clean + scale * noise(rng, clean.shape, reach) / root
    return measurement, replace(samples, value=noisy)


def of_directions(rng, seed, reach, config, layout, truth):
    """Noisy measurement in directions of a genuine file, with what its own fit leaves as noise, and its samples.

    Weights are those of noisy values, as of genuine files: so the values are those whose own weights make this noise.
    """
    files = [path for path in files_of() if path.parent.name == "rgl"]
    measured, left = residuals(files[seed % len(files)])
    weigh = partial(weighted_samples, exponent=config.exponents[0], theta_max=config.fit.theta_max)
    samples, rows = weigh(measured), ordered(measured, config.fit.theta_max)
    clean = np.full(left.shape, np.nan)
    clean[:, rows] = np.where(samples.weight > 0, predict_samples(layout, truth, samples), np.nan)
    share = np.exp(rng.uniform(*np.log(COST)))
    left = rng.choice([-1, 1]) * left[rng.permutation(len(left))]
    values, energy = clean, None
    for _ in range(ROUNDS):
        measured, weight = replace(measured, values=values), np.full(left.shape, np.inf)
        samples, rows = weigh(measured), ordered(measured, config.fit.theta_max)
        weight[:, rows] = np.where(samples.weight > 0, samples.weight, np.inf)
        energy = energy or np.sum(samples.weight * samples.value**2)
        values = clean + np.sqrt(share * energy / np.sum(left**2)) * left / np.sqrt(weight)
    stated = None
    if reach == "stated":
        stated = clean * np.exp(rng.uniform(*np.log(STATED)) + rng.uniform(-1, 1, clean.shape) * np.log(APART))
        values = values + stated * rng.standard_normal(clean.shape)
    measured = replace(measured, values=values, uncertainty=stated)
    return measured, weigh(measured)


@cache
def residuals(path):
    """A genuine file, each direction once, and the weighted residuals of its fit, (C, N), 0 where there is none."""
    config, whole = load(posterior=False).for_scattered, inputs.read(path)
    first = np.unique(alike(whole.theta_i, whole.theta_o, whole.phi), return_index=True)[1]
    measured, found = half_of(whole, first), np.zeros((len(whole.values), len(first)))
    samples = weighted_samples(measured, config.exponents[0], config.fit.theta_max)
    fitted = fit(measured, samples, config)
    predicted = predict_samples(fitted.layout, fitted.solution.z, samples)
    found[:, ordered(measured, config.fit.theta_max)] = np.sqrt(samples.weight) * (samples.value - predicted)
    return measured, found


def ordered(measured, theta_max):
    """Index of each sample among the directions of a file that has every direction once, (S,)."""
    numbers = np.where(measured.valid, 1.0 + np.arange(len(measured.phi)), np.nan)
    return np.rint(weighted_samples(replace(measured, values=numbers), 0.0, theta_max).value.max(0)).astype(int) - 1


def measure(seed, reach, model=OWN, chain=True):
    """Rank of the truth by coordinate, and how the fit and the chain ended; without it those of the approximation."""
    config, layout, truth, measurement, samples = synthetic(seed, reach, model)
    fitted = fit(measurement, samples, config)
    row = {"seed": seed, "correlation": reach}
    row |= {"body": layout.material.body} if model == OWN else {"model": model}
    device = {"device": jax.devices()[0].device_kind}
    if fitted is None or not fitted.status.succeeded:
        return {**row, "N": None, "message": "no fit" if fitted is None else fitted.status.name}, device
    if not chain:
        middle = fitted.noise.covariance @ fitted.noise.precision @ unshrunk(fitted)
        found = norm.cdf((truth - middle) / np.sqrt(np.diag(fitted.noise.covariance)))
        ranks = dict(zip(layout.coordinates, found.tolist(), strict=True))
        return {**row, "N": fitted.count, "message": fitted.status.name}, {**device, "ranks": ranks}
    if fitted.model_error is not None:
        samples = weighted_samples(measurement, fitted.exponent, config.fit.theta_max, fitted.model_error)
    with tempfile.TemporaryDirectory() as folder:
        p = draw(fitted, samples, config.posterior.max_steps, config.seed, Path(folder) / "chain.npz")
    details = {**device, "k": p.pareto_k, "steps": p.diagnosis.steps, "retrainings left": p.chain.retrainings}
    if p.sufficient:
        values, true = layout.flat(p.draws), layout.flat(truth)
        details["ranks"] = dict(zip(layout.names, (p.weights @ (values < true)).tolist(), strict=True))
    return {**row, "N": fitted.count, "message": p.message}, details


def unshrunk(fitted):
    """Where the cost alone is least, to first order: the fit's has the weak prior besides."""
    normal = fitted.solution.normal.sum(0)
    hessian, gradient = normal[:-1, :-1], normal[:-1, -1]
    ridge = 1e-9 * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    return fitted.solution.z + np.linalg.solve(hessian + ridge, gradient)


def run(section, folder, out, every, chain=True, models=(OWN,), reaches=tuple(REACHES)):
    """200 materials with each kind of noise, or 50, as of each of several models; the table is by parameter.

    Args:
        reaches: kinds of noise, those of bins or `SCATTERED`.
    """
    what = "the posterior" if chain else "the normal approximation"
    of = "" if models == (OWN,) else f" of {', '.join(models)}"
    if reaches == SCATTERED:
        of += " in scattered directions"
    most = MATERIALS if models == (OWN,) else FEW
    count = most if every else FEW
    record = Record(
        section, f"Calibration of {what} by simulation{of}", DATA if reaches != SCATTERED else GENUINE,
        ["Parameters are drawn from the prior"
         f"{' (bodies none and lambert in turn)' if models == (OWN,) else ''}. "
         f"{IN_BINS if reaches != SCATTERED else IN_DIRECTIONS} cost is log-uniform in {COST} of the energy. "
         f"Fitted as `merlfit fit` does it. Ranks: of the truth in {what}"
         f"{' (weighted draws)' if chain else ' of the free coordinates'}, how many in each tenth; {STRAYS}; coverage: "
         "of the 90 % intervals.",
         "What chance does: of 38 p of exact intervals the smallest is below 0.01 in up to a third of such tables, "
         "below 0.01/38 in one of a hundred. Of 25 intervals more than 95 % would hold the truth in 27 % of cases, of "
         "50 in 11 %, of 200 in 0.4 %."],
        {f"{reach} {key}": Target(f"{what}, {WORDS[reach]}", limit, unit, at_least=least)
         for reach in reaches for key, what, limit, unit, least in (
             ("p", "smallest p, times the number of parameters", 0.01, "", True),
             ("all low", "coverage of all 90 % intervals", 88, "%", True),
             ("all high", "coverage of all 90 % intervals", 92, "%", False),
             ("low", "smallest coverage of a parameter's", 84, "%", True),
             ("high", "largest coverage of a parameter's", 96, "%", False))},
        folder=out,
    )  # fmt: skip
    kept = Record(f"{section}_runs", f"Runs of the calibration of {what}{of}", record.data, [], folder=out)
    kept.resume()
    fixed = tuple(record.notes)
    done = {(row["seed"], row["correlation"], row.get("model", OWN)) for row in kept.rows}
    jobs = [(seed, reach, model) for seed in range(count) for reach in reaches for model in models]
    left = [job for job in jobs if job not in done]
    with ProcessPoolExecutor(CORES, get_context("spawn"), use_persistent_cache) as pool:
        for run_of_one in as_completed([pool.submit(measure, *job, chain) for job in left]):
            kept.add(*run_of_one.result())
            if len(kept.rows) % TOLD == 0:
                record.notes = [*fixed, *tables(record, kept, models, reaches, most)]
                record.write()
    record.notes = [*fixed, *tables(record, kept, models, reaches, most)]
    kept.finished = record.finished = len(kept.rows) >= most * len(models) * len(reaches)
    kept.write()
    record.write()


def tables(record, kept, models, reaches, most):
    """Rows and targets of all materials so far, by reach of the noise and parameter, and what is to be said of them."""
    record.rows.clear()
    devices = Counter(row["details"]["device"] for row in kept.rows)
    said = [f"Computed on: {', '.join(f'{name} ({many} runs)' for name, many in sorted(devices.items()))}."]
    for reach, model in product(reaches, models):
        rows = [row for row in kept.rows if (row["correlation"], row.get("model", OWN)) == (reach, model)]
        found = [row["details"]["ranks"] for row in rows if "ranks" in row["details"]]
        if not found:
            continue
        for name in dict.fromkeys(name for ranks in found for name in ranks):
            ranks = np.array([r[name] for r in found if name in r])
            seen = np.histogram(ranks, BINS, (0, 1))[0]
            record.rows.append({
                "correlation": reach, **({} if models == (OWN,) else {"model": model}), "parameter": name,
                "materials": len(ranks), "p": uniform(ranks), "coverage %": 100 * float(np.mean(held(ranks))),
                "ranks": " ".join(map(str, seen)),
            })  # fmt: skip
        many = np.quantile([row["N"] for row in rows if row["N"]], (0.1, 0.5, 0.9))
        said.append(
            f"{WORDS[reach].capitalize()}{'' if model == OWN else f', {model}'}: {len(rows)} of {most} materials; N is "
            f"{many[1]:.3g} in the median, {many[0]:.3g} to {many[2]:.3g} in eight of ten; "
            f"{len(rows) - len(found)} have no intervals, since the fit or a diagnostic failed. Of all 90 % intervals "
            f"{together(found, '')} Of parameters that all channels share: {together(found, 'shared')} "
            f"Of those of one channel: {together(found, 'channel')}"
        )
    for reach in reaches:
        found = [
            row["details"]["ranks"] for row in kept.rows if row["correlation"] == reach and "ranks" in row["details"]
        ]
        if not found:
            continue
        ps, whole = record.column("p", correlation=reach), 100 * np.mean([held(r[name]) for r in found for name in r])
        record.set(f"{reach} p", min(1.0, min(ps) * len(ps)))
        record.set(f"{reach} all low", float(whole))
        record.set(f"{reach} all high", float(whole))
        record.set(f"{reach} low", min(record.column("coverage %", correlation=reach)))
        record.set(f"{reach} high", max(record.column("coverage %", correlation=reach)))
    return said


def stray(ranks):
    """Of sorted ranks (..., N), the least probability over all of them that so few or so many others lie below."""
    count = ranks.shape[-1]
    below = np.arange(1, count + 1)
    few, many = binom.cdf(below, count, ranks), binom.sf(below - 2, count, ranks)
    return 2 * np.minimum(few, many).min(-1)


@cache
def strays(count):
    """Sorted, of many samples of uniform ranks."""
    return np.sort(stray(np.sort(np.random.default_rng(count).uniform(size=(DRAWN, count)), -1)))


def uniform(ranks):
    """How often uniform ranks stray as far, anywhere."""
    found = stray(np.sort(np.clip(ranks, 0.0, 1.0)))
    return float((1 + np.searchsorted(strays(len(ranks)), found, side="right")) / (1 + DRAWN))


def held(ranks):
    """Whether 90 % intervals hold the truth."""
    return (ranks > 0.05) & (ranks < 0.95)


def together(found, kind):
    """Coverage and spread of the ranks of many parameters, in words; errors are by material."""
    kinds = {name: "channel" if name.endswith(("_R", "_G", "_B")) else "shared" for ranks in found for name in ranks}
    each = [np.array([rank for name, rank in ranks.items() if kind in ("", kinds[name])]) for ranks in found]
    coverage = np.array([np.mean(held(ranks)) for ranks in each])
    spread = np.array([12 * np.mean((ranks - 0.5) ** 2) for ranks in each])
    (a, da), (b, db) = ((x.mean(), x.std(ddof=1) / np.sqrt(len(x))) for x in (coverage, spread))
    return (
        f"{100 * a:.1f} ± {100 * da:.1f} % hold the truth, and the ranks' variance is {b:.2f} ± {db:.2f} of that of "
        "uniform ones."
    )


calibration = partial(run, "calibration")
calibration_scattered = partial(run, "calibration_scattered", reaches=SCATTERED)
first_order = partial(run, "first_order", chain=False)
first_order_rivals = partial(run, "first_order_rivals", chain=False, models=RIVALS)
first_order_scattered = partial(run, "first_order_scattered", chain=False, reaches=SCATTERED)
