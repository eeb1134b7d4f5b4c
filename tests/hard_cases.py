"""The table of hard cases: values and gradients of the model at its extremes against 30 digits, in both precisions.

``python -m tests.hard_cases`` prints it and writes results/hard_cases.md; with ``--references`` it first computes the
references of the dear cases (two-dimensional integrals) anew into tests/hard_references.json. All cases of an effect go
through one compiled, vmapped function, in forward and reverse mode.

The error of ``diffraction = "scaled"`` and ``"zonal"`` against HP17 Eq. 33 is no matter of this table but of
results/tiers.md: here they are held to what they say they are, a table's polynomial and a truncated sum.
"""

import hashlib
import json
import math
import sys
import tomllib
from collections import defaultdict
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from pathlib import Path

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
from merlfit.fitting.compilation import use_persistent_cache
from merlfit.model import acquisition, body, convolution, diffraction, energy, fresnel, ndf, scaled, shadowing, zonal
from merlfit.model.effects import Effects
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import two_scale

try:
    from oracles import precise  # under pytest, which has tests/ on its path
except ImportError:
    from .oracles import precise

HERE = Path(__file__).parent
TABLE, REFERENCES = HERE / "hard_cases.toml", HERE / "hard_references.json"
PRECISIONS = {"": np.float64, "32": np.float32}
FLOOR = {"": 1e-280, "32": 1e-30}  # errors are relative to no less than this
LOGARITHMIC = {"beta": 0.0, "p": 0.0, "b": 0.0, "b_over_lambda": 0.0, "B": 0.0, "tau": 0.0, "c": 1.0}  # log(x - offset)
EDGES = {"k": (0, None), "sigma_s": (0, None), "eta": (1, None), "albedo": (0, 1), "exponent": (0, 1), "tau": (0, None),
         "theta_h": (0, float(np.pi / 2))}  # fmt: skip
EDGES_OF_BODIES = {**EDGES, "n": (1, None)}  # the real index of an interface
EFFECTS = tuple(x.name for x in fields(Effects))
STATIC = (*EFFECTS, "exact")
DEAR = ("convolve", "convolve_256", "zonal", "scaled_outside", "lobe_albedo", "two_scale", "two_scale_quadrature",
        "two_scale_zonal", "two_scale_exact", "two_scale_conserving")  # fmt: skip
ALWAYS = (
    "theta_h = 0, p = 5 and B beta = 2",
    "zonal of enough degrees",
    "plastic of albedo 1, retro-reflection",
    "conserving without masking: both at 89 degrees",
)  # dear ones that tests compute anew


def specular_share(theta_d, wavelength_um, b, c, sigma_s):
    """A_spec as the assembled model has it."""
    share = diffraction.renormalisation(jnp.sin(theta_d), b / wavelength_um, c)
    return jnp.exp(-diffraction.phase_variance(share * sigma_s**2, jnp.cos(theta_d), wavelength_um))


def masking_table(cos_theta, beta, p):
    """Masking where there are more directions than the table has nodes."""
    return shadowing.masking(jnp.full(shadowing.TABLE_SIZE + 1, cos_theta), beta, p)[0]


def grazing(cos_i, cos_o, exponent):
    """The acquisition's loss of two directions."""
    still = jnp.zeros_like(cos_i)
    return jnp.exp(exponent * acquisition.grazing_log_base(Geometry(still, still, cos_i, cos_o)))


def facet_albedo(theta_d, wavelength_um, b, c, sigma_s, renormalised, exact):
    """The conserving split's lobe albedo at one wavelength, of the angle's dtype, as the assembled model makes it."""
    return energy.lobe_albedo(theta_d, b, c, sigma_s, wavelength_um[None], renormalised, exact)[0].astype(theta_d.dtype)


def assembled(theta_h, theta_d, phi_d, wavelength_um, **rest):
    """The BRDF at one wavelength; ``rest`` are effects and parameters."""
    effects = Effects(**{name: rest.pop(name) for name in EFFECTS if name in rest})
    geometry = Geometry.from_half_difference(theta_h, theta_d, phi_d)
    return two_scale(rest, geometry, effects, wavelength_um[None])[0]


@cache
def scaled_oracle():
    """The oracle of ``scaled`` by the table there is."""
    return precise.scaled(scaled.table())


def scaled_lobe(theta_h, B, c, beta, p, order=None):
    """What `precise` lacks, for it knows no table."""
    return scaled_oracle()(theta_h, B, c, beta, p)


precise.BLURS["scaled"] = scaled_lobe


def convolved(order, **at):
    """The convolution itself, whatever the order it is to be had by."""
    return precise.convolve(**at)


TIERS = ("quadrature", "zonal", "scaled", "exact", "conserving")  # with accuracies of their own
MODEL = {
    "fresnel": fresnel.fresnel, "schlick": fresnel.schlick, "diffraction_colour": fresnel.diffraction_colour,
    "epd": ndf.epd, "smith_lambda": shadowing.smith_lambda, "masking": shadowing.masking,
    "masking_table": masking_table, "renormalisation": diffraction.renormalisation, "lobe": convolution.lobe,
    "specular_share": specular_share, "convolve": convolution.convolve, "convolve_256": convolution.convolve,
    "zonal": zonal.convolve, "scaled": scaled.convolve, "scaled_outside": scaled.convolve, "lobe_albedo": facet_albedo,
    "lambert": body.lambert, "plastic": body.plastic, "subsurface": body.subsurface, "grazing": grazing,
    "two_scale": assembled, **{f"two_scale_{tier}": assembled for tier in TIERS},
}  # fmt: skip
ORACLE = {
    **{name: getattr(precise, name, None) for name in MODEL}, "masking_table": precise.masking,
    "convolve": convolved, "convolve_256": convolved, "scaled": scaled_lobe,
    "scaled_outside": precise.convolve,
    **{f"two_scale_{tier}": precise.two_scale for tier in TIERS},
}  # fmt: skip


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
        """Hash of all that a reference depends on."""
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
    cases = []
    for entry in raw["case"]:
        effect, name, reason = entry.pop("effect"), entry.pop("name"), entry.pop("reason", "")
        unchecked = entry.pop("unchecked", ())
        default = dict(raw["effect"][effect])
        known = default.pop("parameters")
        tolerance = {quantity: entry.pop(quantity, limit) for quantity, limit in default.items()}
        static = {k: entry.pop(k) for k in STATIC if k in entry}
        inputs = {k: number(v) for k, v in entry.items()}
        parameters, unchecked = tuple(q for q in known if q in inputs), tuple(unchecked)
        cases.append(Case(name, effect, inputs, static, parameters, tolerance, reason, unchecked))
    return cases, raw["known_failures"], raw.get("fit", [])


@cache
def stored():
    """References of the dear cases by name and precision."""
    return json.loads(REFERENCES.read_text()) if REFERENCES.is_file() else {}


def dear(case):
    return case.effect in DEAR


def reference(case, precision):
    """Value and gradient at 30 digits: computed where that is cheap, else read.

    Raises:
        LookupError: there is no stored reference for the case as it is now.
    """
    if not dear(case):
        return case.compute(precision)
    found = stored().get(case.name)
    if found is None or found["inputs"] != case.mark():
        raise LookupError(f"{case.name}: no reference; run python -m tests.hard_cases --references")
    return mp.mpf(found["value"]), {name: mp.mpf(x) for name, x in found["gradient"].items()}


def write_references():
    """Compute the references that are missing or out of date, drop those of cases that are gone."""
    kept = {}
    for case in filter(dear, table()[0]):
        if stored().get(case.name, {}).get("inputs") == case.mark():
            kept[case.name] = stored()[case.name]
        else:
            value, gradient = case.compute("")
            text = {name: mp.nstr(x, 20) for name, x in gradient.items()}
            kept[case.name] = {"inputs": case.mark(), "value": mp.nstr(value, 20), "gradient": text}
            print(case.name, kept[case.name]["value"], flush=True)
        REFERENCES.write_text(json.dumps({**stored(), **kept}, indent=1) + "\n")  # what is done is not lost
    REFERENCES.write_text(json.dumps(kept, indent=1) + "\n")


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

        def both(moving, fixed, function=function, static=static):
            def value(moving):
                return _call(function, {**moving, **fixed}, dict(static))

            # what jacfwd and jacrev do, from one trace
            at, forward = jax.linearize(value, moving)
            still = jax.tree.map(jnp.zeros_like, moving)
            unit = {q: {**still, q: jnp.ones_like(moving[q])} for q in moving}
            (reverse,) = jax.linear_transpose(forward, moving)(jnp.ones_like(at))
            return at, {q: forward(unit[q]) for q in moving}, reverse

        run = jax.jit(jax.vmap(both), compiler_options={"xla_cpu_use_fusion_emitters": False})
        for precision, dtype in PRECISIONS.items():
            if f"value{precision}" not in cases[0].tolerance:
                continue
            arrays = {q: jnp.asarray([c.at(precision)[q] for c in cases], dtype) for q in cases[0].inputs}
            moving = {q: arrays.pop(q) for q in cases[0].parameters}
            value, *slopes = run(moving, arrays)
            for j, case in enumerate(cases):
                mine = result[case.name]
                mine.value[precision], mine.dtype[precision] = float(value[j]), value.dtype
                mine.gradient[precision] = [
                    {q: float(slope[q][j]) * case.scale(q, precision) for q in slope} for slope in slopes
                ]
    return result


def _call(function, numbers, static):
    """Custom derivative rules bind by position."""
    if function is convolution.convolve:
        return function(*(numbers[q] for q in ("theta_h", "B", "c", "beta", "p")), static["order"])
    return function(**numbers, **static)


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
                float(abs(mode[q] - slope) / max(abs(slope), steep))
                for mode in self.found.gradient[precision]
                for q, slope in ((q, gradient[q]) for q in self.case.checked)
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
    """Print the table, write it to results/; 1 where a case fails that is not known to."""
    jax.config.update("jax_enable_x64", True)
    use_persistent_cache()
    if "--references" in arguments:
        write_references()
        stored.cache_clear()
    lines, known = rows(), {entry["case"] for entry in table()[1]["entries"]}
    text = markdown(lines)
    failing = [row for row in lines if row.failures]
    unknown = [row for row in failing if row.case.name not in known]
    summary = f"{len(lines)} cases, {len(lines) - len(failing)} pass, {len(failing) - len(unknown)} known failures"
    print(text, summary, sep="\n\n")
    folder = HERE.parent / "results"
    folder.mkdir(exist_ok=True)
    (folder / "hard_cases.md").write_text(f"# Hard cases\n\n{text}\n\n{summary}\n")
    for row in unknown:
        print(f"FAILED {row.case.name}: {', '.join(row.failures)}")
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
