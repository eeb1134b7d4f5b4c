"""The table of hard cases: values and gradients of the model at its extremes against 30 digits, in both precisions.

``python -m tests.hard_cases`` prints it, with the degenerate files of tests/hard_fits.py as a second one, and writes
both to results/hard_cases.md; with ``--references`` it first computes the references of the dear cases (two-dimensional
integrals) into tests/hard_references.json: those that are missing, and all where an oracle's source has changed. All
cases of an effect go through one compiled, vmapped function, in forward and reverse mode.

The error of ``diffraction = "scaled"`` and ``"zonal"`` against HP17 Eq. 33 is no matter of this table but of
results/tiers.md: here they are held to what they say they are, a table's polynomial and a truncated sum.
"""

import math
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cache, cached_property

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.support.compilation import use_persistent_cache

if __package__:
    from . import hard_fits
    from .hard_effects import MODEL
    from .hard_table import HERE, PRECISIONS, Case, reference, table, write_references
else:
    import hard_fits
    from hard_effects import MODEL
    from hard_table import HERE, PRECISIONS, Case, reference, table, write_references

FLOOR = {"": 1e-280, "32": 1e-30}  # errors are relative to no less than this


@dataclass
class Found:
    """What the model says of one case: values and, per differentiation mode, gradients, by precision."""

    value: dict = field(default_factory=dict)
    gradient: dict = field(default_factory=dict)
    dtype: dict = field(default_factory=dict)


@cache
def found():
    """The model at every case, one compilation for each function and precision: {name: Found}."""
    groups, result = defaultdict(list), {case.name: Found() for case in table()[0]}
    for case in table()[0]:
        groups[MODEL[case.effect], tuple(case.static.items()), tuple(case.inputs)].append(case)
    for (function, static, _), cases in groups.items():
        run = _compiled(function, dict(static))
        for precision in PRECISIONS:
            if f"value{precision}" in cases[0].tolerance:
                _evaluate(run, cases, precision, result)
    return result


def _compiled(function, static):
    """The function at many cases: values, and gradients of forward and reverse mode."""

    def both(moving, fixed):
        # what jacfwd and jacrev do, from one trace
        at, forward = jax.linearize(lambda moving: function(**moving, **fixed, **static), moving)
        (reverse,) = jax.linear_transpose(forward, moving)(jnp.ones_like(at))
        units = {q: jnp.array([r == q for r in moving], moving[q].dtype) for q in moving}
        slopes = jax.lax.map(forward, units)  # a loop: in a third of the time to compile
        return at, dict(zip(moving, slopes, strict=True)), reverse

    return jax.jit(jax.vmap(both), compiler_options={"xla_cpu_use_fusion_emitters": False})


def _evaluate(run, cases, precision, result):
    """Enter what the model says of these cases into the result."""
    arrays = {q: jnp.asarray([c.at(precision)[q] for c in cases], PRECISIONS[precision]) for q in cases[0].inputs}
    moving = {q: arrays.pop(q) for q in cases[0].parameters}
    value, *slopes = run(moving, arrays)
    for j, case in enumerate(cases):
        mine = result[case.name]
        mine.value[precision], mine.dtype[precision] = float(value[j]), value.dtype
        mine.gradient[precision] = [
            {q: float(slope[q][j]) * case.scale(q, precision) for q in slope} for slope in slopes
        ]


@dataclass
class Row:
    """Errors of one case by quantity."""

    case: Case
    found: Found

    @cached_property
    def errors(self):
        """Relative errors as the table's head defines them; nan where the model is not finite."""
        result = {}
        for precision in self.found.value:
            expected, gradient = reference(self.case, precision)
            floor = max(abs(expected), FLOOR[precision])
            steep = floor if expected else 1  # differences about an exact 0 leave 1e-24
            result[f"value{precision}"] = float(abs(self.found.value[precision] - expected) / floor)
            worst = [
                float(abs(mode[q] - gradient[q]) / max(abs(gradient[q]), steep))
                for mode in self.found.gradient[precision]
                for q in self.case.checked
            ]
            result[f"gradient{precision}"] = float(np.max(worst))  # a nan stays
        return result

    @property
    def failures(self):
        """Quantities that exceed their tolerance, or are not finite."""
        return [q for q, error in self.errors.items() if not (math.isfinite(error) and error <= self.case.tolerance[q])]


def rows():
    """The whole table."""
    return [Row(case, found()[case.name]) for case in table()[0]]


def markdown(lines):
    """The table as Markdown; what exceeds its tolerance is bold."""
    quantities = ("value", "gradient", "value32", "gradient32")
    text = ["| case | effect | value | gradient | value, float32 | gradient, float32 |", "|---|---|---|---|---|---|"]
    for row in lines:
        cells = [f"{row.errors[q]:.1e}" if q in row.errors else "" for q in quantities]
        cells = [f"**{x}**" if q in row.failures else x for q, x in zip(quantities, cells, strict=True)]
        text.append(" | ".join(["| " + row.case.name, row.case.effect, *cells]) + " |")
    return "\n".join(text)


def main(arguments):
    """Print the tables, write them to results/; 1 where a case fails that is not known to, or a file's fit."""
    jax.config.update("jax_enable_x64", True)
    use_persistent_cache()
    if "--references" in arguments:
        write_references()
    lines, known = rows(), {entry["case"] for entry in table()[1]["entries"]}
    failing = [row for row in lines if row.failures]
    unknown = [row for row in failing if row.case.name not in known]
    files = hard_fits.rows()
    wrong = [row for row in files if row.failures]
    text = [
        markdown(lines),
        f"{len(lines)} cases, {len(lines) - len(failing)} pass, {len(failing) - len(unknown)} known failures",
        "## Degenerate files",
        hard_fits.markdown(files),
        f"{len(files)} files, {len(files) - len(wrong)} end as they should",
    ]
    print(*text, sep="\n\n")
    folder = HERE.parent / "results"
    folder.mkdir(exist_ok=True)
    (folder / "hard_cases.md").write_text("\n\n".join(["# Hard cases", *text]) + "\n")
    for name, failures in [(row.case.name, row.failures) for row in unknown] + [(r.name, r.failures) for r in wrong]:
        print(f"FAILED {name}: {', '.join(failures)}")
    return 1 if unknown or wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
