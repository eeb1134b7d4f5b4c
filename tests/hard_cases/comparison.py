"""Values and gradients of the model at hard cases beside those of 30 digits, in both precisions.

All cases of an effect go through one compiled, vmapped function, in forward and reverse mode.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cache, cached_property

import jax
import jax.numpy as jnp
import numpy as np

from .effects import MODEL
from .table import PRECISIONS, Case, reference, table

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
