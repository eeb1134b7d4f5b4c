"""Fits against scipy's least_squares on the plain NumPy model with finite differences, all bins scaled from subsets."""

import time
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import prior_factor
from merlfit.fitting.fit.problem import energy
from merlfit.fitting.fit.starts import start_hints, starting_points
from merlfit.fitting.pipeline.search import (
    CANDIDATE_ORDER,
    CANDIDATES,
    COARSE,
    FIRST_ROUND_EACH,
    GRIDS,
    cheaper,
    make_coarse,
    successive_halving,
)
from merlfit.merl_io.samples import thin
from scipy.optimize import least_squares

from . import plain_numpy
from .fit import fit_runs
from .materials import BODIES, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target, exponent
from .start import REPEATS, TOLERANCES, coarse_optimum, fine_stage

TWO = ("nickel", "gold-metallic-paint2")
SUBSETS = ((COARSE[0], 15, 1), COARSE, GRIDS["medium"])  # runs of rows (merl_io.samples.thin)
COARSE_RUNS = (*COARSE[:2], 5)  # merlfit's coarse rows, every fifth azimuth: for NumPy's own coarse stage
FIRST_RUNS = (*CANDIDATES[:2], 5)  # likewise, for the first round of successive halving


class Plain:
    """The plain model on some rows: weighted residuals as a function of the free coordinates, and how often asked."""

    def __init__(self, layout, samples):
        self.layout, self.samples, self.calls = layout, samples, 0
        self.root = np.sqrt(samples.weight / energy(samples))

    def residuals(self, z):
        """Of all bins, with the prior."""
        return float(prior_factor(z)[0]) * self.bare(z)

    def bare(self, z):
        """Of all bins, without the prior."""
        self.calls += 1
        s, values = self.samples, {k: np.asarray(x) for k, x in self.layout.values(jnp.asarray(z)).items()}
        found = plain_numpy.brdf(values, s.theta_h, s.theta_d, s.cos_i, s.cos_o)
        return (self.root * (s.value - found)).ravel()

    def cost(self, z):
        return float(np.sum(self.bare(z) ** 2))

    def solve(self, start, most):
        """least_squares with finite differences, asked for so many residuals at the most, differences not counted."""
        options = {"x_scale": "jac", "max_nfev": most, **TOLERANCES}
        return least_squares(self.residuals, start, "2-point", **options)


def coarse_stage(layout, samples, config):
    """Seconds of the search that `run.fit_coarse` makes, from merlfit's starting points, which cost nothing here."""
    rough, (_, roughly) = cheaper(layout, CANDIDATE_ORDER), make_coarse(samples)
    points = starting_points([rough], start_hints(samples), roughly, FIRST_ROUND_EACH * config.fit.starts)[0]
    begun, plain = time.perf_counter(), Plain(layout, thin(samples, COARSE_RUNS))
    begin = Plain(layout, thin(samples, FIRST_RUNS))

    def follow(points, stage):
        model = begin if stage.rough else plain
        ends = [[model.solve(z, stage.steps) for z in each] for each in points]
        return [[SimpleNamespace(z=end.x, objective=2 * end.cost) for end in each] for each in ends]

    (best,) = successive_halving([points], follow, config)
    return {"seconds": time.perf_counter() - begun, "calls": begin.calls + plain.calls, "cost": best.objective}


def subset(layout, samples, start, most):
    """Seconds, calls of the model and final cost of a solve on some rows."""
    begun, plain = time.perf_counter(), Plain(layout, samples)
    found = plain.solve(start, most)
    return {
        "bins": samples.cos_i.size, "seconds": time.perf_counter() - begun, "calls": plain.calls,
        "cost": 2 * found.cost, "message": found.message,
    }  # fmt: skip


def call_of(layout, samples, start):
    """Median seconds of one call of the model."""
    plain, seconds = Plain(layout, samples), []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        plain.residuals(start)
        seconds.append(time.perf_counter() - begun)
    return float(np.median(seconds))


def measure(path):
    """merlfit's fine stage and whole fit; NumPy's coarse stage, solves on subsets and one call on all bins."""
    config, layout, samples, start = coarse_optimum(path, "none")
    *_, fine = fine_stage(config, layout, samples, start)
    return {
        "call": call_of(layout, samples, start), "bins": samples.cos_i.size, "fine": fine,
        "subsets": [subset(layout, thin(samples, runs), start, config.fit.max_steps) for runs in SUBSETS],
        "coarse": coarse_stage(layout, samples, config), "whole": fit_runs(path, "none"),
    }  # fmt: skip


def growth(seen):
    """Power of the number of bins with which a call's time grows, over the subsets and all bins."""
    sizes = [(s["bins"], s["seconds"] / s["calls"]) for s in seen["subsets"]]
    return exponent(*zip(*sizes, (seen["bins"], seen["call"]), strict=True))


NOTES = [
    "NumPy: `tests/bench/plain_numpy.py`, one core, `least_squares(jac='2-point', x_scale='jac', ftol=1e-6, "
    f"xtol=1e-5)`, no more steps than `fit.max_steps`. merlfit: both cores, after compilation, median of {REPEATS}.",
    "**Scaled, not measured: NumPy's solve on all bins.** It is one call of the model on all bins (measured, median of "
    f"{REPEATS}) times the calls that the solve on the largest subset of rows took; how a call's time grows is shown.",
    "Fine stage: all bins from merlfit's coarse optimum, on both sides. Whole fit: merlfit from file to JSON; NumPy "
    "the fine stage (scaled) and a coarse stage as merlfit does it (the same search from the same starting points), "
    "measured, on the same rows with every fifth azimuth; without reading, weights, metrics and the choice of starting "
    "points.",
]


def run(folder, out, every):
    """Two conductors, or all six."""
    data = f"{RECONSTRUCTIONS}: {'all six' if every else 'two of the six'} conductors"
    record = Record(
        "against_numpy", "Fits against plain NumPy with finite differences", data, NOTES,
        {"fine": Target("fine stage faster than scipy on plain NumPy (scaled), median", 100, "times", True),
         "whole": Target("whole fit faster than scipy on plain NumPy (scaled), median", 100, "times", True),
         "least": Target("the same, smallest ratio", 100, "times", True)},
        folder=out,
    )  # fmt: skip
    for material in BODIES["none"] if every else TWO:
        seen, _ = worker("against_numpy", file(folder, material))
        fine, whole = float(np.median(seen["fine"])), float(np.median(seen["whole"]))
        solve, coarse, subsets = seen["call"] * seen["subsets"][-1]["calls"], seen["coarse"]["seconds"], seen["subsets"]
        record.add(
            {
                "material": material, "merlfit fine s": fine, "merlfit whole s": whole,
                "bins of subsets": " ".join(str(s["bins"]) for s in subsets),
                "their s": " ".join(f"{s['seconds']:.3g}" for s in subsets),
                "calls": " ".join(str(s["calls"]) for s in subsets), "s a call on all bins": seen["call"],
                "grows as bins^": growth(seen), "NumPy fine s (scaled)": solve, "NumPy coarse s": coarse,
                "ratio fine": solve / fine, "ratio whole": (solve + coarse) / whole,
                "NumPy's fine to merlfit's whole": solve / whole,
            },
            seen,
        )  # fmt: skip
        record.set("fine", np.median(record.column("ratio fine")))
        record.set("whole", np.median(record.column("ratio whole")))
        record.set("least", min(record.column("ratio whole")))
    record.finish()
