"""Results as tables for a terminal; rich draws them, plain text when the output is not one."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...merl_io.binary import BRIGHTEST, OUTLIER, said
from ...merl_io.check import FileReport, ScatteredReport
from ...model.registry import models
from ..assess.identifiability import in_words
from ..results.schema import Accuracy, DerivedResult, Model, ParameterResult, Result

WIDE = 110  # columns, from which on a table has room for sentences


@dataclass(frozen=True)
class Outcome:
    """One file of a batch: its result, or the one line that says why there is none."""

    path: Path
    result: Result | None
    error: str | None = None
    bad_input: bool = False


def number(x: float | None, digits: int = 4) -> str:
    """A number with a few significant digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "-"
    return f"{x:.{digits}g}"


def check_table(reports: Sequence[FileReport]) -> Table:
    """What `merlfit check` prints."""
    table = Table(
        title=f"MERL files (bins: of theta_h, theta_d and phi_d; inf: infinite, or above {BRIGHTEST:g}/sr; "
        f"outliers: over {OUTLIER:g} times as bright as their neighbours; max: largest value, 1/sr; genuine: by SHA-1)",
        title_justify="left",
    )
    left = ("file", "genuine MERL")
    numbers = ("valid", "negative", "NaN", "inf", "outliers", "max R", "max G", "max B")
    for head in ("file", "bins", *numbers, "genuine MERL"):
        table.add_column(
            head, justify="left" if head in left else "right", overflow="fold" if head in left else "ellipsis"
        )
    for r in reports:
        table.add_row(
            str(r.path), said(r.dims), f"{r.fraction_valid:.1%}",
            str(r.negative), str(r.nan), str(r.inf), str(r.outliers),
            *(number(x) for x in r.largest), f"yes: {r.genuine}" if r.genuine else "no",
        )  # fmt: skip
    return table


def scattered_table(reports: Sequence[ScatteredReport]) -> Table:
    """What `merlfit check` prints of files of scattered directions."""
    table = Table(
        title="files of scattered directions (angles: least and largest, degrees; max: largest value, 1/sr)",
        title_justify="left",
    )
    for head in ("file", "format", "samples", "channels", "valid", "theta_i", "theta_o", "theta_h", "max"):
        table.add_column(head, justify="left" if head in ("file", "channels") else "right", overflow="fold")
    for r in reports:
        first, last, count = r.channels
        many = f"{count} of {count + r.left_out}" if r.left_out else str(count)
        channels = f"{many}: {first} to {last}" if count > 1 else first
        angles = (f"{low:.1f} {high:.1f}" for low, high in (r.theta_i, r.theta_o, r.theta_h))
        row = (str(r.path), r.format, str(r.samples), channels, f"{r.fraction_valid:.1%}")
        table.add_row(*row, *angles, number(r.largest))
    return table


def summary_table(outcomes: Sequence[Outcome]) -> Table:
    """One row a file of a batch."""
    table = Table(
        title="Fits (RMSE in 1/sr; dE: mean CIELAB distance of spheres; peak: fitted over measured highlight)",
        title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0),
    )  # fmt: skip
    numbers = ("RMSE", "sMAPE", "dE", "peak", "s")
    for head in ("material", "model", "status", *numbers[:-1], "chain", "s"):
        least = 20 if head == "material" else 9 if head == "status" else None  # the longest of MERL's names
        justify = "right" if head in numbers else "left"
        table.add_column(head, justify=justify, overflow="fold", min_width=least)
    for o in outcomes:
        if o.result is None:
            table.add_row(o.path.stem, "-", f"failed: {o.error}", *"------")
            continue
        r = o.result
        chain = "-" if r.posterior is None else "ok" if r.posterior.sufficient else r.posterior.message.split(":")[0]
        table.add_row(
            r.source.material, r.model.material.variant if r.model else "-", r.fit.status,
            number(r.metrics.rmse, 3), number(r.metrics.smape, 3), number(r.metrics.picture, 2),
            number(r.metrics.highlight, 2), chain, f"{r.seconds['total']:.1f}",
        )  # fmt: skip
    return table


def models_table() -> Table:
    """What `merlfit models` prints."""
    table = Table(
        title="reflectance models; RGB: one value per channel; numbers: over three channels. `merlfit fit` fits the "
        "two-scale model, in the variants that --body and --index name, or another one by --model NAME; `merlfit "
        "compare` fits several",
        title_justify="left", box=box.SIMPLE_HEAD,
    )  # fmt: skip
    for head in ("model", "parameter", "unit", "meaning"):
        table.add_column(head, overflow="fold", min_width=9 if head == "parameter" else None)
    for name, kind in models().items():
        variants = kind.variants()
        counts = sorted({sum(3 if q.per_channel else 1 for q in model.parameters) for model in variants})
        numbers = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else str(counts[0])
        table.add_row(name, f"{numbers} numbers", "", f"body {', '.join(kind.bodies)}; {kind.citation}")
        for q in {q.name: q for model in variants for q in model.parameters}.values():
            unit = "-" if q.unit == "1" else q.unit
            table.add_row("", f"{q.name} (RGB)" if q.per_channel else q.name, unit, q.meaning)
    return table


def interval(q: ParameterResult | DerivedResult) -> str:
    """The 90 % interval, or the reason why there is none."""
    if q.quantiles is None:
        return "-"
    return f"{number(q.quantiles.q05)} .. {number(q.quantiles.q95)}"


def parameter_table(result: Result, width: int) -> Table:
    """Parameters with intervals; what they mean only where the terminal has room for it."""
    heads = ["parameter", "value", "std. error", "5 .. 95 %", "unit", "bounds", *(["meaning"] if width >= WIDE else [])]
    table = Table(title=f"{result.source.material}: fitted parameters", title_justify="left", box=box.SIMPLE_HEAD)
    for head in heads:
        left = head in ("parameter", "unit", "meaning")
        table.add_column(head, justify="left" if left else "right", overflow="fold")
    for q in result.parameters:
        bounds = f"[{number(q.lower)}, {number(q.upper)}]" + (f" at {q.at_bound}" if q.at_bound != "no" else "")
        unit = "-" if q.unit == "1" else q.unit
        row = (q.name, number(q.value), number(q.standard_error, 2), interval(q), unit, bounds, q.meaning)
        table.add_row(*row[: len(heads)])
    return table


def fitted_line(m: Model) -> str:
    """What was fitted: model, what of its settings matters, and the loss of the apparatus."""
    a, said = m.acquisition, [m.material.words, *m.material.details]
    if m.measured.loses:
        exponents = [f"{number(k, 3)} of {lobe} light" for lobe, k in a.exponents.items()]
        said.append(f"grazing exponent {' and '.join(exponents)} ({a.grazing_loss})")
    return ", ".join(said)


VALID_OF = {
    "MERL": "bins", "table": "values of a table of scattered directions", "RGL": "the values of an RGL file",
}  # fmt: skip


def print_result(console: Console, result: Result) -> None:
    """Everything a person asks first of one result."""
    s, f = result.source, result.fit
    grid = s.format == "MERL"
    what = VALID_OF[s.format]
    console.print(f"{s.material}: {s.path}, {s.fraction_valid:.1%} of {what} valid")
    console.print(f"data: {result.data_words}", markup=False)
    if result.model is None:
        console.print(f"{f.status}: {f.message}")
        return
    console.print(fitted_line(result.model))
    console.print(parameter_table(result, console.width))
    console.print(f"{f.status}: {f.message}")
    console.print(
        f"cost {number(f.cost)} (share of the weighted energy), RMSE {number(result.metrics.rmse)} 1/sr, "
        f"sMAPE {number(result.metrics.smape, 3)}, {f.bins} {'bins' if grid else 'samples'}, "
        f"{f.steps} steps on the last grid"
    )
    e = result.metrics
    picture = f"mean CIELAB distance {number(e.picture, 3)}" if grid else "none of scattered directions"
    console.print(
        f"picture: {picture}; highlight {number(e.highlight, 3)} times the file's; "
        f"cube-root error {number(e.cube_root, 3)}, log error {number(e.log, 3)}"
    )
    for caution in f.cautions:
        console.print(f"caution: {caution}")
    if len(f.candidates) > 1:
        console.print(
            "models compared on the coarse grid, with their scores (the lowest is best): "
            + ", ".join(f"{c.variant} {number(c.score, 3)}" for c in f.candidates)
        )
    if result.identifiability is not None:
        for line in in_words(result.identifiability):
            console.print(line)
    if result.accuracy is not None:
        console.print(accuracy_line(result.accuracy))
    if result.posterior is None:
        console.print("posterior: not sampled" + ("" if grid else ": none of scattered directions is"))
        return
    if result.derived:
        console.print(derived_table(result))
    p = result.posterior
    least = min((x or 0.0 for x in p.effective_size), default=0.0)
    console.print(
        f"posterior: {p.message}; {p.walkers} walkers, acceptance {p.acceptance:.2f}. {p.draws} draws are weighted by "
        f"the likelihood of all bins; the smallest effective sample size is {number(least, 3)}. The residuals are "
        f"correlated: they count as {number(p.effective_bins, 3)} independent ones",
        markup=False,
    )


def pictures_table(written: Mapping[Path, str]) -> Table:
    """Files of pictures, and what each shows."""
    table = Table(title="pictures, as wide as a column of a paper (8.5 cm)", title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("wrote", overflow="fold")
    table.add_column("what it shows", overflow="fold", max_width=48)
    for path, words in written.items():
        table.add_row(escape(str(path)), words)
    return table


def derived_table(result: Result) -> Table:
    """Derived quantities with intervals."""
    table = Table(title="derived quantities of the material (without the loss of the apparatus)", title_justify="left")
    for head in ("quantity", "value", "5 .. 95 %", "unit", "meaning"):
        table.add_column(head, justify="right" if head in ("value", "5 .. 95 %") else "left")
    for q in result.derived:
        table.add_row(q.name, number(q.value), interval(q), "-" if q.unit == "1" else q.unit, q.meaning)
    return table


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
