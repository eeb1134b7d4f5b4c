"""Growth of one solve's time and memory with the number of directions that it evaluates."""

import time

import numpy as np
from merlfit.fitting.fit.hints import hints_of
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.search import GRIDS
from merlfit.fitting.settings.config import load
from merlfit.merl_io.binary import read
from merlfit.merl_io.samples import thin

from .materials import file
from .processes import resident_peak, worker
from .record import RECONSTRUCTIONS, Record, exponent
from .start import REPEATS

MATERIAL, BODY, STEPS = "nickel", "none", 6
SIZES = (("coarse", 8), ("medium", 8), ("fine", 8), ("fine", 16), ("fine", 32))  # rows, nodes of a row
PRECISIONS = ("float64", "float32")
OPTICS = {"n": np.ones(3), "k": np.ones(3)}  # where it starts
NEVER = 1e-14  # tolerance that no step meets


def measure(path, grid, azimuths, precision):
    """Seconds a step of a solve that has not converged, and the peaks before and after it (MiB)."""
    config = load(body=BODY)
    layout = layout_for(config, *candidates(config))
    samples = thin(weighted_samples(read(path)), GRIDS[grid])
    problem = make_problem(samples, int(azimuths), precision)
    typical = {q.name: q.default for q in layout.parameters}
    start = layout.free(
        {**typical, **OPTICS, **hints_of(layout.model).starts(start_hints(samples), layout.bands.middle_um)[0]}
    )
    before = resident_peak()
    runs = []
    for _ in range(REPEATS + 1):  # the first one compiles
        begun = time.perf_counter()
        solution = solve(Objective(layout, problem), start, STEPS, NEVER)
        runs.append((time.perf_counter() - begun) / solution.steps)
    if solution.steps != STEPS or solution.converged:
        raise RuntimeError(f"{grid}, {azimuths} nodes, {precision}: ended after {solution.steps} of {STEPS} steps")
    directions = sum(part.directions.log_base.size for part in problem.parts)
    return {
        "bins": samples.cos_i.size, "directions": directions, "before": before,
        "seconds": float(np.median(runs[1:])),
        "after": resident_peak(),
    }  # fmt: skip


def run(folder, out, every):
    """Every size in both precisions, each in a process of its own; exponents among the notes."""
    record = Record(
        "growth", "Growth with the number of bins", f"{RECONSTRUCTIONS}: {MATERIAL}, body {BODY}",
        [f"A solve of {STEPS} steps from a starting point that it cannot converge from, each size in a process of its "
         "own. Bins: folded ones that the problem stands for; directions: those it evaluates. Peak memory before the "
         "solve is that of reading the file and gathering azimuths. "
         f"After compilation, median of {REPEATS}."],
        folder=out,
    )  # fmt: skip
    path = file(folder, MATERIAL)
    for precision in PRECISIONS:
        for grid, azimuths in SIZES:
            seen, peak = worker("growth", path, grid, azimuths, precision)
            record.add({
                "precision": precision, "grid": grid, "nodes of a row": azimuths, "bins": seen["bins"],
                "directions": seen["directions"], "s a step": seen["seconds"],
                "us a direction": 1e6 * seen["seconds"] / seen["directions"], "peak before GiB": seen["before"] / 1024,
                "peak GiB": peak / 1024,
            })  # fmt: skip
    for precision in PRECISIONS:
        directions, seconds = (record.column(name, precision=precision) for name in ("directions", "s a step"))
        record.notes.append(
            f"{precision}: a step's time grows as directions^{exponent(directions, seconds):.2f} over all sizes, "
            f"^{exponent(directions[2:], seconds[2:]):.2f} from {directions[2]} on."
        )
    speed = np.divide(*(record.column("s a step", precision=p) for p in PRECISIONS))
    record.notes.append(f"float64 takes {speed.min():.2g} to {speed.max():.2g} times as long as float32.")
    record.finish()
