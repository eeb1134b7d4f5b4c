"""Cold start: from the start of a process with a warm cache to the first normal equations, and to the JSON."""

import statistics
import tempfile
import time

from .materials import file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target

REPEATS = 3
CASES = (("nickel", "none"), ("gray-plastic", "plastic"), ("nickel", "auto"))


def measure(path, body):
    """`merlfit fit` in this process: on the system's clock, when normal equations of each size first came out."""
    from merlfit.fitting.commands import cli
    from merlfit.fitting.fit.residuals import Objective

    first = {}

    def timed(real):
        def call(objective, points):
            found = real(objective, points)
            first.setdefault(sum(part.target.size for part in objective.problem.parts), time.monotonic())
            return found

        return call

    for name in ("normal_equations", "normal_equations_of_many"):
        setattr(Objective, name, timed(getattr(Objective, name)))
    with tempfile.TemporaryDirectory() as out:
        cli.app(["fit", path, "-o", out, "--body", body, "--no-posterior"], standalone_mode=False)
        json_ = time.monotonic()
    sizes = sorted(first)
    return {"first": first[sizes[0]], "all_bins": first[sizes[-1]], "json": json_}


def run(folder, out, every):
    """Medians of some starts, after one that fills the cache."""
    record = Record(
        "cold", "Cold start", RECONSTRUCTIONS,
        [f"A new process each time, compiled programs in the cache (from an earlier start), median of {REPEATS}. "
         "First iteration: the first normal equations of the solver, of the first starting point on the coarse grid; "
         "beside it the first ones of all bins. Body `auto` compares five kinds of interface and body."],
        {body + material: Target(f"cold start to the first iteration, {material}, body {body}", 6, "s")
         for material, body in CASES},
        folder=out,
    )  # fmt: skip
    for material, body in CASES:
        path, starts = file(folder, material), []
        for _ in range(REPEATS + 1):
            begun = time.monotonic()
            seen, _ = worker("cold", path, body)
            starts.append({name: at - begun for name, at in seen.items()})
        middle = {name: statistics.median(s[name] for s in starts[1:]) for name in starts[0]}
        record.add(
            {"material": material, "body": body, "first iteration s": middle["first"],
             "first of all bins s": middle["all_bins"], "JSON s": middle["json"]},
            {"starts": starts},
        )  # fmt: skip
        record.set(body + material, middle["first"])
    record.finish()
