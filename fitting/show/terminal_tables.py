"""Results as tables for a terminal; rich draws them, plain text when the output is not one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ...model.reflectance import Reflectance
from ...model.two_scale import TwoScale
from ..fit.identifiability import in_words
from ..fit.outcome import explains
from ..results.schema import Accuracy, Model, ParameterResult, Quantiles, Result
from ..support.numbers import counted, distance, number, unit
from ..support.tables import table

LAPLACE = "by the Laplace approximation"
SCATTER_OF = {"file": "file's values", "stated": "stated in the file"}  # beside that of the fit


@dataclass(frozen=True)
class Outcome:
    """One file of a batch: its result, or the one line that says why there is none."""

    path: Path
    result: Result | None
    error: str | None = None
    bad_input: bool = False


def summary_table(outcomes: Sequence[Outcome]) -> Table:
    """One row a file of a batch."""
    title = "Fits (RMSE in 1/sr; lamp, env: CIELAB distance of spheres there; peak: fitted over measured)"
    left = ("material", "model", "status", "chain")
    heads = (*left[:3], "RMSE", "sMAPE", "lamp", "env", "peak", "chain", "s")
    return table(title, heads, left, map(_summary_row, outcomes))


def _summary_row(o: Outcome) -> Sequence[str]:
    if (r := o.result) is None:
        return o.path.stem, "-", "bad input" if o.bad_input else "failed", *"-------"  # why: on stderr
    chain = "-" if r.posterior is None else "ok" if r.posterior.sufficient else r.posterior.message.split(":")[0]
    return (
        r.source.material, r.model.material.variant if r.model else "-", r.fit.status,
        number(r.metrics.rmse, 3), number(r.metrics.smape, 3), distance(r.metrics.lamp),
        distance(r.metrics.environment), number(r.metrics.highlight, 2), chain, f"{r.seconds['total']:.1f}",
    )  # fmt: skip


def _not_the_lowest(result: Result) -> str:
    """Why a kind was taken whose score is not the lowest, if that is so."""
    if result.model is None:
        return ""
    taken = result.model.material.variant
    own = next((c for c in result.fit.candidates if (c.model, c.variant) == (result.model.name, taken)), None)
    if own is not None and own.picture is not None and own.model != TwoScale.name:
        simple = [c.picture for c in result.fit.candidates if c.model == TwoScale.name and c.picture is not None]
        return f"; taken: {taken}, whose spheres are {distance(own.picture)} off, a single surface's " + (
            f"{distance(min(simple))} at the least" if simple else "-"
        )
    compared = {c.variant: c for c in result.fit.candidates if c.score is not None}
    scores = {variant: c.score or 0.0 for variant, c in compared.items()}
    if taken not in scores or scores[taken] == min(scores.values()):
        return ""
    lowest = compared[min(scores, key=lambda variant: scores[variant])]
    if not explains(lowest):
        return f"; taken: {taken}, as {lowest.variant} leaves too much of the file unexplained"
    if not lowest.of_matter:
        return f"; taken: {taken}, as no matter has the constants of {lowest.variant}"
    if (lowest.model, "film" in lowest.variant) != (result.model.name, "film" in taken):
        return f"; taken: {taken}, as {lowest.variant} is too little better in cost or picture for what it has more"
    return f"; taken: {taken}, the simplest of those that describe the file about as well as the lowest"


def interval(found: Quantiles | None) -> str:
    """A 90 % interval; a dash where there is none."""
    return "-" if found is None else f"{number(found.q05)} .. {number(found.q95)}"


def median(q: ParameterResult) -> str:
    """Median of the posterior; a dash without one."""
    return number(q.quantiles.q50) if q.quantiles else "-"


def parameter_table(result: Result) -> Table:
    """Parameters with one kind of interval, their bounds, and what they mean.

    Of the posterior where there is one, by the Laplace approximation where there is none: side by side the narrower
    one would be believed.
    """
    sampled = any(q.quantiles for q in result.parameters)
    said = f"fitted parameters; 90 % intervals {'of the posterior' if sampled else LAPLACE}"
    before = result.edited_from.fitted if result.edited_from else {}
    if result.edited_from is not None:
        said = said.replace("fitted parameters", "edited parameters") + " of the fit that they are from"
    middle, left = ["median"] if sampled else [], ("parameter", "unit", "meaning")
    heads = ("parameter", "value", *middle, "5 .. 95 %", "unit", "bounds", "meaning")
    drawn = table(f"{result.source.material}: {said}", heads, left)
    for q in result.parameters:
        at = "" if q.at_bound == "no" else f"{q.at_bound} {number(q.lower if q.at_bound == 'lower' else q.upper)}"
        bounds = f"[{number(q.lower)}, {number(q.upper)}]{f' at {at}' if at else ''}"
        bounds = {"free": bounds, "fixed": "fixed", "tied": f"{bounds}, tied"}[q.fitted]
        if q.name in before:
            bounds = f"edited, was {number(before[q.name])}"
        found = [median(q), interval(q.quantiles)] if sampled else [interval(q.laplace)]
        drawn.add_row(q.name, number(q.value), *found, unit(q.unit), bounds, q.meaning)
    return drawn


def beside_table(result: Result, given: Mapping[str, float], shares: Mapping[str, float]) -> Table:
    """Values from elsewhere, such as printed ones, beside the fit's intervals.

    Args:
        given: by name of the number. shares: of the posterior that is below each, where it was sampled.
    """
    known, sampled = {q.name: q for q in result.parameters}, any(q.quantiles for q in result.parameters)
    said = f"90 % intervals {'of the posterior' if sampled else LAPLACE}, each whatever the others are"
    heads = ("parameter", "given", "median" if sampled else "value", "5 .. 95 %", "unit", "given is")
    drawn = table(f"{result.source.material}: given values beside the fit's; {said}", heads, ("parameter", "given is"))
    for name, value in given.items():
        q = known[name]
        ends = q.quantiles if sampled else q.laplace
        where = "-" if ends is None else "inside" if ends.q05 <= value <= ends.q95 else "outside"
        where = "fixed" if q.fitted == "fixed" else where
        if name in shares:
            where += f", above {shares[name]:.1%} of the posterior"
        middle = median(q) if sampled else number(q.value)
        drawn.add_row(name, number(value), middle, interval(ends), unit(q.unit), where)
    return drawn


def material_words(material: Reflectance) -> str:
    """What a material is, for people."""
    if not isinstance(material, TwoScale):
        return str(material)
    interface = {"complex": "conductor", "real": "dielectric", "film": "thin film"}[material.index]
    return f"{material.name}, {interface}" + ("" if material.body == "none" else f" over {material.body}")


def fitted_line(m: Model) -> str:
    """What was fitted: model, what of its settings matters, and the loss of the apparatus."""
    a, said = m.acquisition, [material_words(m.material)]
    if isinstance(m.material, TwoScale):
        said += [f"diffraction by {m.material.diffraction}", f"energy split {m.material.split}"]
    if m.measured.loses:
        exponents = [f"{number(k, 3)} of {lobe} light" for lobe, k in a.exponents.items()]
        said.append(f"grazing exponent {' and '.join(exponents)} ({a.grazing_loss})")
    return ", ".join(said)


VALID_OF = {"MERL": "bins", "table": "values of a table of scattered directions"}


def print_result(console: Console, result: Result) -> None:
    """Everything a person asks first of one result."""
    s, f = result.source, result.fit
    grid = s.format == "MERL"
    what = VALID_OF.get(s.format, f"the values of the {s.format} file")
    console.print(f"{s.material}: {s.path}, {s.fraction_valid:.1%} of {what} valid")
    console.print(f"data: {result.data_words}")
    if result.model is None:
        console.print(f"{f.status}: {f.message}")
        return
    if s.fraction_uncertain is not None:
        console.print(f"uncertainties: {result.uncertainty_words}")
    console.print(fitted_line(result.model))
    console.print(parameter_table(result))
    console.print(f"{f.status}: {f.message}")
    if result.edited_from is not None:
        return
    console.print(
        f"cost {number(f.cost)} (share of the weighted energy), RMSE {number(result.metrics.rmse)} 1/sr, "
        f"sMAPE {number(result.metrics.smape, 3)}, {counted(f.bins, 'bin' if grid else 'sample')}, "
        f"{counted(f.steps, 'step')} on the last grid"
    )
    e = result.metrics
    lit = f"CIELAB distance of lit pixels {distance(e.lamp)} under a lamp, {distance(e.environment)} in a room"
    uncovered = "none, the samples cover too little of what a sphere shows"
    picture = uncovered if e.picture is None and not grid else f"{lit}; of all pixels {distance(e.picture)}"
    console.print(
        f"picture: {picture}; highlight {number(e.highlight, 3)} times the file's; "
        f"cube-root error {number(e.cube_root, 3)}, log error {number(e.log, 3)}"
    )
    if result.tis:
        console.print(scatter_table(result))
        if grid and result.model.measured.loses:
            console.print("the fit's is of the material; the file's lacks what its apparatus loses at grazing angles")
    for caution in f.cautions:
        console.print(f"caution: {caution}")
    if len(f.candidates) > 1:
        console.print(
            "models compared on the coarse grid, with their scores (lower is better): "
            + ", ".join(f"{c.variant} {number(c.score, 3)}" for c in f.candidates)
            + _not_the_lowest(result)
        )
    if result.identifiability is not None:
        for line in in_words(result.identifiability):
            console.print(line)
    if result.accuracy is not None:
        console.print(accuracy_line(result.accuracy))
    if result.posterior is None:
        console.print("posterior: not sampled")
        return
    if result.derived:
        console.print(derived_table(result))
    p = result.posterior
    least = min((x or 0.0 for x in p.effective_size), default=0.0)
    console.print(
        f"posterior: {p.message}; {p.walkers} walkers, acceptance {p.acceptance:.2f}. {p.draws} draws are weighted by "
        f"the likelihood of all data; the smallest effective sample size is {number(least, 3)}. The residuals are "
        f"correlated: they count as {number(p.effective_bins, 3)} independent ones"
    )


def pictures_table(written: Mapping[Path, str]) -> Table:
    """Files of pictures in a folder, and what each shows."""
    title = f"pictures in {next(iter(written)).parent}, as wide as a column of a paper (8.5 cm)"
    heads = ("wrote", "what it shows")
    return table(title, heads, heads, ((path.name, words) for path, words in written.items()))


def derived_table(result: Result) -> Table:
    """Derived quantities with intervals."""
    title = "derived quantities of the material (without the loss of the apparatus)"
    return table(title, ("quantity", "value", "5 .. 95 %", "unit", "meaning"), ("quantity", "unit", "meaning"), (
        (q.name, number(q.value), interval(q.quantiles), unit(q.unit), q.meaning) for q in result.derived
    ))  # fmt: skip


def scatter_table(result: Result) -> Table:
    """Total integrated scatter by incidence, with one kind of interval; the file's where there is one."""
    sampled = any(q.quantiles for q in result.tis)
    said = f"90 % intervals {'of the posterior' if sampled else LAPLACE}"
    more = [name for name in ("file", "stated") if any(getattr(q, name) is not None for q in result.tis)]
    drawn = table(
        f"total integrated scatter (TIS), the share of the light that comes back; {said}",
        ("light at", "channel", "fit", "5 .. 95 %", *(SCATTER_OF[name] for name in more)), ("channel",),
    )  # fmt: skip
    for q in result.tis:
        found = interval(q.quantiles if sampled else q.laplace)
        beside = [number(getattr(q, name)) for name in more]
        drawn.add_row(f"{number(q.theta_i_deg)} deg", q.channel, number(q.value), found, *beside)
    return drawn


def accuracy_line(found: Accuracy) -> str:
    """What a fit that was asked for an accuracy or a time came to."""
    if found.estimated is None and found.asked is None:
        return "accuracy: not estimated, which would have taken longer than the time that was asked for"
    said = f"accuracy: within {number(found.estimated, 2)} of the reference fit, "
    said += "a floor: what 95 % of the calibration's fits keep to" if found.floor else "as estimated"
    if found.settings != found.tried[0].settings:
        said += f"; carried on with {found.settings}, because {found.tried[0].settings} only came "
        said += f"within {number(found.tried[0].estimated, 2)}"
    if found.met is not None:
        said += f"; {number(found.asked)} was asked for, " + ("which is met" if found.met else "which is NOT met")
    return said
