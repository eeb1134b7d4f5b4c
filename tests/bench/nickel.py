"""Nickel's parameters beside those printed in HP17 (Fig. 16-17): intervals, and what the printed values cost."""

import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import compress
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.posterior.likelihood import on_all
from merlfit.fitting.posterior.sampling import draw
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.weighted import quantiles
from merlfit.merl_io.binary import read
from scipy.optimize import least_squares

from .materials import file
from .processes import worker
from .record import RECONSTRUCTIONS, Record

PRINTED = {"beta": 0.1196, "b": 4.8418, "sigma_s": 0.0273}
HALF_Q = np.sqrt(2)  # Eq. 33 with Q/2 for Q: twice the phase variance diffracts as much light, where it is small
READINGS = {
    "as printed": PRINTED,
    "sigma_s for Q/2": {**PRINTED, "sigma_s": PRINTED["sigma_s"] * HALF_Q},
    "sigma_s for Q/2, beta free": {"b": PRINTED["b"], "sigma_s": PRINTED["sigma_s"] * HALF_Q},
    "sigma_s for Q/2, beta squared": {
        "beta": PRINTED["beta"] ** 2, "b": PRINTED["b"], "sigma_s": PRINTED["sigma_s"] * HALF_Q,
    },
    "beta squared alone": {"beta": PRINTED["beta"] ** 2},
}  # fmt: skip
# where the search begins
OTHERWISE = {
    "beta": 0.02,
    "b": 5.0,
    "c": 2.0,
    "sigma_s": 0.04,
    "grazing_exponent": 0.5,
    "grazing_exponent_diffracted": 0.3,
}
KURTOSES = (0.35, 0.5, 0.8, 1.2)
STEP = 1e-5  # of the differences that take derivatives from free coordinates to logarithms


def lowest(layout, problem, fixed):
    """Least cost with some parameters held, and the values that have it: all others are searched."""
    own = [name for name in ("p", *OTHERWISE) if name not in fixed]

    def values(x):
        e = np.exp(x)
        return {**fixed, **dict(zip(own, e, strict=False)), "n": e[len(own) : len(own) + 3], "k": e[len(own) + 3 :]}

    def near(x):
        z = np.asarray(layout.free(values(x)))
        return compress(z, Objective(layout, problem).normal_equations(z))

    def slope(x):
        steps = STEP * np.eye(len(x))
        by_x = [layout.free(values(x + s)) - layout.free(values(x - s)) for s in steps]
        return np.asarray(near(x).slope) @ np.transpose(by_x) / (2 * STEP)

    found = []
    for p in KURTOSES:
        x = np.log([*({**OTHERWISE, "p": p}[name] for name in own), *(1.0,) * 3, *(1.5,) * 3])
        best = values(least_squares(lambda x: np.asarray(near(x).value), x, slope, x_scale="jac", max_nfev=60).x)
        at = layout.values(jnp.asarray(layout.free(best)))
        found.append((float(jnp.sum(Objective(layout, problem).costs(at))), best))
    return min(found, key=lambda each: each[0])


def measure(path):
    """Rows of the table, and intervals by parameter."""
    config, measurement = load(body="none"), read(path)
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    fitted, problem = fit(measurement, samples, config), make_problem(samples)
    layout, least, z = fitted.layout, fitted.solution.cost, fitted.solution.z
    likelihood = on_all(layout, z, problem, fitted.noise).log_likelihood
    rows = [("fit", least, layout.values(jnp.asarray(z)))]
    rows += [(name, *lowest(layout, problem, fixed)) for name, fixed in READINGS.items()]
    with tempfile.TemporaryDirectory() as folder:
        drawn = draw(fitted, samples, config.posterior.max_steps, config.seed, Path(folder) / "chain.npz")
    physical = layout.flat(drawn.draws)
    found = dict(zip(layout.names, quantiles(physical, drawn.weights).T.tolist(), strict=True))
    return {
        "rows": [
            {"held": name, **{q: float(v[q]) for q in ("beta", "p", "b", "c", "sigma_s")}, "cost": s,
             "log L": float(np.diff(likelihood(np.stack([z, layout.free(v)])))[0])}
            for name, s, v in rows
        ],
        "count": fitted.count, "message": drawn.message, "sufficient": drawn.sufficient,
        "intervals": {q: found[q] for q in PRINTED},
    }  # fmt: skip


def run(folder, out, every):
    """One material."""
    seen, _ = worker("nickel", file(folder, "nickel"))
    told = ", ".join(f"{q} {m:.3g} ({low:.3g} .. {high:.3g})" for q, (low, m, high) in seen["intervals"].items())
    record = Record(
        "nickel", "Nickel beside HP17", RECONSTRUCTIONS,
        [f"HP17 Fig. 16-17 print {', '.join(f'{k} {v}' for k, v in PRINTED.items())} (lengths in um). Median and 90 % "
         f"interval of ours: {told if seen['sufficient'] else 'none'} ({seen['message']}).",
         "Each row: some of the three held, every other parameter searched; the least cost, and the logarithm "
         f"of the likelihood there relative to the fit's (N = {seen['count']:.1f}, docs/statistics.md). sigma_s for "
         "Q/2: times sqrt(2), as Eq. 33 is evaluated with Q/2 in place of the printed Q."],
        folder=out,
    )  # fmt: skip
    for row in seen["rows"]:
        record.add(row)
    record.finish()
