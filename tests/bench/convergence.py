"""How often the pipeline as shipped arrives at the best optimum known, its starting point replaced by a random one."""

from dataclasses import replace

import numpy as np
from jax import numpy as jnp
from merlfit.fitting.fit.outcome import Fitted
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.settings.config import load
from merlfit.merl_io.binary import read

from .materials import TWELVE, measured
from .record import RECONSTRUCTIONS, Record, Target

FOUR = ("nickel", "brass", "gray-plastic", "yellow-phenolic")
STARTS, FEW_STARTS = 20, 5
LONGER = 32  # fit.starts of one longer search, so that the best known does not come from the runs alone
SAME = 1e-3  # of what is minimised


def told(fitted: Fitted):
    """What one run came to."""
    s = fitted.solution
    return {"objective": s.objective, "cost": s.cost, "status": fitted.status.name, "z": s.z.tolist()}


def measure(path, body, starts):
    """Runs of a material with one body."""
    return measure_of(path, starts, body=body)


def measure_of(path, starts, effects=None, **settings):
    """The runs from random points, the one from the data, and one of a longer search."""
    config = load({"effects": effects or {}}, **settings, posterior=False)
    measurement = read(path)
    (model,) = candidates(config)
    samples, layout = (
        weighted_samples(measurement, config.exponents[0], config.fit.theta_max),
        layout_for(config, model),
    )

    def run(config, first=None):
        return told(fit(measurement, samples, config, first=first))

    found = []
    for seed in range(int(starts)):
        values = layout.values(jnp.asarray(np.random.default_rng([20261122, seed]).standard_normal(layout.size)))
        found.append(run(config, {name: float(x) for name, x in values.items() if np.ndim(x) == 0}))
    longer = replace(config, fit=replace(config.fit, starts=LONGER))
    return {"random": found, "data": run(config), "longer": run(longer)}


def compared(seen, within=()):
    """Columns of a table: how many runs arrived, and how far they and the others are from the best.

    Args:
        within: also count the runs whose excess is at most this, as pairs of a column's name and the excess.
    """
    ends = np.array([r["objective"] for r in seen["random"]])
    data, longer = seen["data"]["objective"], seen["longer"]["objective"]
    best = min(ends.min(), data, longer)
    shares = {
        name: 100 * float(np.mean(ends <= best * (1 + excess))) for name, excess in (("arrived %", SAME), *within)
    }
    return {
        **shares, "best cost": seen["longer"]["cost"], "median excess": float(np.median(ends)) / best - 1,
        "worst excess": float(ends.max()) / best - 1, "from the data": data / best - 1,
        "longer search": longer / best - 1,
    }  # fmt: skip


def run(folder, out, every):
    """Twelve materials, or four from fewer points."""
    starts = STARTS if every else FEW_STARTS
    record = Record(
        "convergence", "Fits that arrive", RECONSTRUCTIONS,
        [f"`merlfit fit --body BODY` as shipped, all its stages, {starts} times a material: instead of reading its "
         "first starting point off the data it is given one drawn from the whole prior (beta, p, b, c, sigma_s and the "
         "grazing exponents; optical constants are projected, as always), around which it scatters the others. "
         f"Arrived: what is minimised (cost on all bins, and prior) is within {SAME:.1%} of the lowest of these runs, "
         f"of the run from the data and of a longer search with fit.starts = {LONGER}.",
         "Excess: of the median and of the worst run over the best. From the data, longer search: their excess."],
        {"all": Target("runs that arrive, of all materials", 99, "%", at_least=True),
         "each": Target("runs that arrive, of the worst material", 95, "%", at_least=True)},
        folder=out,
    )  # fmt: skip
    for material, seen in measured(record, TWELVE if every else FOUR, folder, starts):
        record.add({"material": material, "body": TWELVE[material], **compared(seen)}, seen)
        record.set("all", np.mean(record.column("arrived %")))
        record.set("each", np.min(record.column("arrived %")))
    record.finish()
