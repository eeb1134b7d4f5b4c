"""The fine stage against scipy's least_squares with the same JAX model: all bins as residuals, their whole Jacobian."""

import time

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import prior_factor
from merlfit.fitting.fit.problem import directions, energy, shares
from merlfit.fitting.fit.residuals import _predict
from merlfit.fitting.support.threads import CORES, side_by_side
from scipy.optimize import least_squares

from .materials import TWELVE, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target
from .start import REPEATS, TOLERANCES, coarse_optimum, fine_stage

FOUR = ("nickel", "gold-metallic-paint2", "gray-plastic", "white-marble")
MOST = 60  # residuals that scipy may ask for
NEAR = 1e-3  # of the final cost: near enough


class Whole:
    """Weighted residuals of all bins with light and their Jacobian, both by all cores, with the prior."""

    def __init__(self, layout, samples):
        where = directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
        self.parts = shares(where, where.log_base.size)
        root = np.sqrt(samples.weight / energy(samples))
        self.shape, self.used = root.shape, root > 0
        self.root, self.target = root[self.used], (root * samples.value)[self.used]
        predicted = lambda z, part: _predict(layout.model, layout.values(z), part)  # noqa: E731
        self.predicted, self.jacobian = jax.jit(predicted), jax.jit(jax.jacfwd(predicted))

    def rows(self, compute, z):
        """One row a bin and channel with light, of what is computed in blocks."""
        found = side_by_side(lambda part: np.asarray(compute(jnp.asarray(z), part)), self.parts)
        blocks = np.moveaxis(np.concatenate(found), 1, 0)
        return blocks.reshape(*self.shape, *blocks.shape[5:])[self.used]

    def bare(self, z):
        """Residuals of the data alone."""
        return self.target - self.root * self.rows(self.predicted, z)

    def residuals(self, z):
        return float(prior_factor(z)[0]) * self.bare(z)

    def slope(self, z):
        factor, rate = prior_factor(z)
        slope = self.rows(self.jacobian, z)
        slope *= -float(factor) * self.root[:, None]
        return slope + self.bare(z)[:, None] * np.asarray(rate)

    def cost(self, z):
        """Of the data alone, on all bins, relative to their energy."""
        return float(np.sum(self.bare(z) ** 2))

    def objective(self, z):
        """What both minimise: cost and prior."""
        return float(np.sum(self.residuals(z) ** 2))


def measure(path, body):
    """Seconds and final costs of both from the same start, with scipy's costs as time went by."""
    config, layout, samples, start = coarse_optimum(path, body)

    _, solution, runs = fine_stage(config, layout, samples, start)
    whole = Whole(layout, samples)
    whole.residuals(start), whole.slope(start)  # compiled
    trace, begun = [], time.perf_counter()

    def residuals(z):
        found = whole.residuals(z)
        trace.append((time.perf_counter() - begun, float(found @ found)))
        return found

    found = least_squares(residuals, start, whole.slope, method="trf", x_scale="jac", max_nfev=MOST, **TOLERANCES)
    seconds = time.perf_counter() - begun
    return {
        "ours": float(np.median(runs)), "runs": runs, "steps": solution.steps, "scipy": seconds, "nfev": found.nfev,
        "njev": found.njev, "message": found.message, "trace": trace, "rows": len(whole.target),
        "near": next(t for t, cost in trace if cost <= min(c for _, c in trace) * (1 + NEAR)),
        "cost": whole.cost(solution.z), "scipy_cost": whole.cost(found.x),
        "objective": whole.objective(solution.z), "scipy_objective": whole.objective(found.x),
    }  # fmt: skip


NOTES = [
    "Both start at the coarse optimum and minimise the same cost with the same prior, in float64, on both "
    f"cores, those of BLAS included, after compilation. merlfit: azimuths gathered, then solved (median of {REPEATS}). "
    "scipy: `least_squares(method='trf', x_scale='jac', ftol=1e-6, xtol=1e-5)` with the JAX residuals of all bins that "
    "hold light and their dense Jacobian (`jacfwd`), no gathering, one run. Near: when scipy had come within "
    f"{NEAR:.1%} of the lowest cost it found.",
    "Costs: of all bins, without the prior. Difference: merlfit's less scipy's; negative where merlfit's is lower.",
]


def run(folder, out, every):
    """Four materials, or all twelve."""
    record = Record(
        "against_scipy", "The fine stage against scipy's least_squares", RECONSTRUCTIONS, NOTES,
        {"ratio": Target("faster than scipy least_squares with the same model, median", 10, "times", True),
         "least": Target("the same, smallest ratio", 10, "times", True),
         "cost": Target("cost above scipy's, largest", 0.1, "%")},
        folder=out,
    )  # fmt: skip
    for material in TWELVE if every else FOUR:
        seen, peak = worker("against_scipy", file(folder, material), TWELVE[material], blas=CORES)
        ours, cost, theirs = seen["ours"], seen["cost"], seen["scipy_cost"]
        record.add(
            {
                "material": material, "body": TWELVE[material], "merlfit s": ours, "steps": seen["steps"],
                "scipy s": seen["scipy"], "evaluations": seen["nfev"], "Jacobians": seen["njev"],
                "ratio": seen["scipy"] / ours, "near s": seen["near"],
                "cost": cost, "scipy cost": theirs, "difference %": 100 * (cost / theirs - 1),
                "scipy peak GiB": peak / 1024,
            },
            seen,
        )  # fmt: skip
        record.set("ratio", np.median(record.column("ratio")))
        record.set("least", min(record.column("ratio")))
        record.set("cost", max(record.column("difference %")))
    record.finish()
