"""The hard cases of cases.toml: arguments, tolerances, and references of 30 digits.

Dear references, two-dimensional integrals, are read from references.json, each under a mark of its
arguments, all under one of the oracles' sources; `write_references` makes anew what is out of date.
"""

import hashlib
import json
import math
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mpmath as mp
import numpy as np

from ..oracles import precise
from .effects import CHOICES, DEAR, ORACLE

HERE = Path(__file__).parent
TABLE, REFERENCES = HERE / "cases.toml", HERE / "references.json"
ORACLES = Path(precise.__file__).parent
PRECISIONS = {"": np.float64, "32": np.float32}
LOGARITHMIC = {"beta": 0.0, "p": 0.0, "b": 0.0, "b_over_lambda": 0.0, "B": 0.0, "tau": 0.0, "c": 1.0}  # log(x - offset)
EDGES = {"k": (0, None), "sigma_s": (0, None), "eta": (1, None), "albedo": (0, 1), "weight": (0, 1), "exponent": (0, 1),
         "tau": (0, None), "theta_h": (0, float(np.pi / 2))}  # fmt: skip
EDGES_OF_BODIES = {**EDGES, "n": (1, None)}  # the real index of an interface
STATIC = (*CHOICES, "exact")
ALWAYS = (
    "theta_h = 0, p = 5 and B beta = 2",
    "plastic of albedo 1, retro-reflection",
    "conserving without masking: both at 89 degrees",
)  # dear ones that tests compute anew


def number(entry):
    """A number, or an angle in degrees as "cos 30", "sin 30", "rad 30", "sin2 30", "-sin2 30"; right angles exact."""
    if not isinstance(entry, str):
        return float(entry)
    kind, degrees = entry.split()
    angle = math.radians(float(degrees))
    sine, cosine = (math.sin(angle), math.cos(angle)) if float(degrees) != 90 else (1.0, 0.0)
    return {"cos": cosine, "sin": sine, "rad": angle, "sin2": sine**2, "-sin2": -(sine**2)}[kind]


def rounded(x, kind):
    """x in a precision, towards 0: no angle leaves the quarter circle."""
    near = kind(x)
    return float(near if abs(float(near)) <= abs(x) else np.nextafter(near, kind(0)))


@dataclass(frozen=True)
class Case:
    """One line of the table: an effect, its arguments, tolerances by quantity (value, gradient, value32 ...).

    Gradients must be finite in all ``parameters``; in those of ``unchecked`` that is all that is asked for.
    """

    name: str
    effect: str
    inputs: dict
    static: dict
    parameters: tuple
    tolerance: dict
    reason: str = ""
    unchecked: tuple = ()

    @property
    def checked(self):
        """Parameters whose derivatives are compared."""
        return tuple(q for q in self.parameters if q not in self.unchecked)

    def at(self, precision):
        """The arguments as this precision holds them; where references are dear, one serves both precisions."""
        kind = np.float32 if dear(self) and "value32" in self.tolerance else PRECISIONS[precision]
        return {name: rounded(x, kind) for name, x in self.inputs.items()}

    def scale(self, name, precision):
        """What turns d/dparameter into the table's gradient."""
        return self.at(precision)[name] - LOGARITHMIC[name] if name in LOGARITHMIC else 1.0

    def mark(self):
        """Hash of what a reference depends on, the oracles' sources aside."""
        told = json.dumps([ORACLE[self.effect].__name__, self.static, self.at("")])
        return hashlib.sha1(told.encode()).hexdigest()[:12]

    def compute(self, precision):
        """Value and gradient at 30 digits: (value, {parameter: derivative in the table's scale})."""
        oracle, at = ORACLE[self.effect], self.at(precision)
        edges = EDGES_OF_BODIES if self.effect in ("plastic", "subsurface") else EDGES

        def value(**numbers):
            return oracle(**numbers, **self.static)

        slopes = {q: precise.slope(value, at, q, *edges.get(q, ())) for q in self.checked}
        return value(**at), {q: slope * self.scale(q, precision) for q, slope in slopes.items()}


@cache
def table():
    """The parsed table: cases, known failures, degenerate fits."""
    raw = tomllib.loads(TABLE.read_text())
    cases = [parsed(dict(entry), raw["effect"][entry["effect"]]) for entry in raw["case"]]
    return cases, raw["known_failures"], raw.get("fit", [])


def parsed(entry, defaults):
    """One case of the file; ``defaults`` are its effect's tolerances and parameters."""
    effect, name, reason = entry.pop("effect"), entry.pop("name"), entry.pop("reason", "")
    unchecked = tuple(entry.pop("unchecked", ()))
    tolerance = {q: entry.pop(q, limit) for q, limit in defaults.items() if q != "parameters"}
    static = {k: entry.pop(k) for k in STATIC if k in entry}
    inputs = {k: number(v) for k, v in entry.items()}
    parameters = tuple(q for q in defaults["parameters"] if q in inputs)
    return Case(name, effect, inputs, static, parameters, tolerance, reason, unchecked)


def dear(case):
    """Whether its reference is stored."""
    return case.effect in DEAR


def oracles():
    """Hash of the sources of all oracles: what others have computed is never read."""
    code = b"".join(path.read_bytes() for path in sorted(ORACLES.glob("*.py")))
    return hashlib.sha256(code).hexdigest()[:16]


@cache
def stored():
    """References of the dear cases by name.

    Raises:
        LookupError: an oracle is not what it was when they were computed.
    """
    found = json.loads(REFERENCES.read_text()) if REFERENCES.is_file() else {"oracles": oracles()}
    if found.pop("oracles", None) != oracles():
        raise LookupError("the oracles have changed: run python -m tests.hard_cases --references")
    return found


def reference(case, precision):
    """Value and gradient at 30 digits: computed where that is cheap, else read.

    Raises:
        LookupError: there is no stored reference for the case as it is now, or the oracles have changed.
    """
    if not dear(case):
        return case.compute(precision)
    found = stored().get(case.name)
    if found is None or found["inputs"] != case.mark():
        raise LookupError(f"{case.name}: no reference; run python -m tests.hard_cases --references")
    return mp.mpf(found["value"]), {name: mp.mpf(x) for name, x in found["gradient"].items()}


def write_references():
    """Compute the references that are missing or out of date, drop those of cases that are gone."""
    try:
        before = stored()
    except LookupError:
        before = {}
    kept = {}
    for case in filter(dear, table()[0]):
        if before.get(case.name, {}).get("inputs") == case.mark():
            kept[case.name] = before[case.name]
        else:
            value, gradient = case.compute("")
            text = {name: mp.nstr(x, 20) for name, x in gradient.items()}
            kept[case.name] = {"inputs": case.mark(), "value": mp.nstr(value, 20), "gradient": text}
            print(case.name, kept[case.name]["value"], flush=True)
            _write({**before, **kept})  # what is done is not lost
    _write(kept)
    stored.cache_clear()


def _write(references):
    REFERENCES.write_text(json.dumps({"oracles": oracles(), **references}, indent=1) + "\n")
