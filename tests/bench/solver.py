"""Our trust region against optimistix' own parts, from the same starting points on the coarse grid."""

import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from merlfit.fitting.fit.levenberg_marquardt import OFFSET_TOLERANCE, compress, relative_offset, solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.search import COARSE, COARSE_AZIMUTHS, COARSE_ORDER, cheaper
from merlfit.fitting.settings.config import load
from merlfit.merl_io.binary import read
from merlfit.merl_io.samples import thin

from .materials import TWELVE, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record

FOUR = ("nickel", "gold-metallic-paint2", "gray-plastic", "white-marble")
STARTS, MOST, SPREAD = 10, 200, 1.0  # SPREAD: of the starting points, in units of the prior's
SCALE = 100.0  # of the residuals, with which the stock solver's first damping, 1, is a light one
SAME = 1e-3  # of the cost: ends so near to each other are the same


class OfParts(optx.AbstractGaussNewton):
    """optimistix' Gauss-Newton with a descent and a search of choice."""

    rtol: float
    atol: float
    descent: optx.AbstractDescent
    search: optx.AbstractSearch
    norm: Callable = optx.max_norm
    verbose: Callable = lambda **_: None


TOLERANCES = {"rtol": 1e-5, "atol": 1e-5}
SOLVERS = {
    "stock": optx.LevenbergMarquardt(**TOLERANCES),
    "indirect": OfParts(
        **TOLERANCES, descent=optx.IndirectDampedNewtonDescent(),
        search=optx.ClassicalTrustRegion(high_cutoff=0.75, low_cutoff=0.25),
    ),
}  # fmt: skip


def driven(solver, evaluate, z):
    """Cost with prior, evaluations, and whether it converged, of a solver driven as `solve` drives ours."""
    size = len(z)

    def affine(z, near):
        value, slope, at = near
        return SCALE * (value + slope @ (z - at)), None

    start = jnp.zeros(size)
    near = (jnp.zeros(size + 1), jnp.zeros((size + 1, size)), start)
    shape = jax.ShapeDtypeStruct((size + 1,), start.dtype)
    state = solver.init(affine, start, near, {}, shape, None, frozenset())
    _, static = eqx.partition(state, eqx.is_array)

    @jax.jit
    def step(y, dynamic, normal):
        state = eqx.combine(dynamic, static)
        found = compress(state.y_eval, normal)
        near = (found.value, found.slope, state.y_eval)
        y, state, _ = solver.step(affine, y, near, {}, state, frozenset())
        kept = (state.num_steps_since_acceptance == 0, relative_offset(found.value), jnp.sum(found.value**2))
        return y, eqx.filter(state, eqx.is_array), state.terminate, *kept

    y = jnp.asarray(z)
    dynamic, cost = eqx.filter(eqx.tree_at(lambda s: s.y_eval, state, y), eqx.is_array), np.inf
    for steps in range(1, MOST + 1):
        y, dynamic, stop, accepted, offset, here = step(y, dynamic, evaluate(eqx.combine(dynamic, static).y_eval))
        cost = float(here) if accepted or steps == 1 else cost
        if bool(stop) or (bool(accepted) and offset < OFFSET_TOLERANCE):
            return cost, steps, True
    return cost, MOST, False


def ours(layout, z, problem):
    """The same of `solve`."""
    found = solve(Objective(layout, problem), z, MOST)
    return found.objective, found.steps, found.converged


def measure(path, body):
    """Costs, evaluations and ends of all from random starting points, and seconds of each."""
    config = load(body=body)
    layout = cheaper(layout_for(config, *candidates(config)), COARSE_ORDER)
    problem = make_problem(thin(weighted_samples(read(path)), COARSE), COARSE_AZIMUTHS)
    rng, rows = np.random.default_rng(0), {name: [] for name in (*SOLVERS, "ours")}
    for _ in range(STARTS):
        z = SPREAD * rng.standard_normal(layout.size)
        for name in rows:
            begun = time.perf_counter()
            found = (
                ours(layout, z, problem)
                if name == "ours"
                else driven(SOLVERS[name], lambda x: Objective(layout, problem).normal_equations(x), z)
            )
            rows[name].append([*found, time.perf_counter() - begun])
    return rows


NOTES = [
    f"{STARTS} starting points each, drawn from the prior with {SPREAD:g} times its standard deviation; the same for "
    f"all. At most {MOST} evaluations of the normal equations; all stop at the same relative offset. stock: "
    "`optimistix.LevenbergMarquardt` with its defaults, residuals times 100; indirect: optimistix' own parts for a "
    "trust region, `IndirectDampedNewtonDescent` and `ClassicalTrustRegion` with thresholds 0.75 and 0.25, residuals "
    "times 100; ours: `fitting/fit/trust_region.py`. The driving loop is the same.",
    f"Same end: pairs whose costs differ by less than {SAME:.1%}, for which evaluations are compared (ratio of "
    "medians, the other's over ours). Lower: pairs in which one ended lower by more than that.",
]


def run(folder, out, every):
    """Four materials, or all twelve."""
    record = Record("solver", "The trust region against optimistix' own parts", RECONSTRUCTIONS, NOTES, folder=out)
    for material in TWELVE if every else FOUR:
        seen, _ = worker("solver", file(folder, material), TWELVE[material])
        ended = {name: int(sum(converged for _, _, converged, _ in rows)) for name, rows in seen.items()}
        row = {"material": material, "body": TWELVE[material], **{f"{name} converged": n for name, n in ended.items()}}
        for name in SOLVERS:
            cost, steps, _, _ = (np.array(x) for x in zip(*(np.array(seen[q]).T for q in (name, "ours")), strict=True))
            relative = cost[0] / cost[1] - 1
            same = np.abs(relative) < SAME
            middle = [float(np.median(s[same])) if same.any() else float("nan") for s in steps]
            row |= {
                f"{name}: same end": int(same.sum()), f"{name} evaluations": middle[0],
                f"ours beside {name}": middle[1],
                f"{name} ratio": middle[0] / middle[1], f"{name} lower": int((relative < -SAME).sum()),
                f"ours lower than {name}": int((relative > SAME).sum()),
            }  # fmt: skip
        record.add(row, seen)
    for name in SOLVERS:
        ratio = np.nanmedian(record.column(f"{name} ratio"))
        record.notes.append(f"{name}, evaluations to the same end: {ratio:.2g} times as many in the median.")
    record.finish()
