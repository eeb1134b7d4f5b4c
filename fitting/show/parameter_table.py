"""Parameters of results side by side, each with its interval as papers print it: a table of LaTeX or of HTML."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from markupsafe import Markup, escape

from ..results.schema import ParameterResult, Result
from ..support.numbers import number
from .style import letters

DIGITS, UNEVEN = 2, 1000.0  # of the smaller error, unless that is so many times smaller than the other one
LATEX_UNITS = {"1": "", "um": "\\textmu m", "1/sr": "sr$^{-1}$", "deg": "$^\\circ$"}
HTML_UNITS = {"1": "", "um": "µm"}
SPECIAL = str.maketrans({
    "\\": "\\textbackslash{}", "^": "\\textasciicircum{}", "~": "\\textasciitilde{}", ">": "$>$", "<": "$<$",
    **{c: f"\\{c}" for c in "#$%&_{}"},
})  # fmt: skip
ERRORS = {"RMSE": ("rmse", "1/sr"), "CIELAB distance": ("picture", "1")}


class Cell(NamedTuple):
    """A value, what to add and to subtract for the ends of its 90 % interval, and why it has none."""

    value: str
    above: str = ""
    below: str = ""
    note: str = ""


def cell(result: Result, q: ParameterResult) -> Cell:
    """A parameter: the posterior's median with its interval, or the fitted value with Laplace's; to digits that count.

    A number that the data do not decide, or that was set, has no interval, and a word that says so.
    """
    edited = result.edited_from is not None and q.name in result.edited_from.fitted
    set_ = "edited" if edited else q.fitted if q.fitted == "fixed" else "at bound" if q.at_bound != "no" else ""
    known = None if set_ else q.quantiles or q.laplace
    if known is None:
        return Cell(number(q.value, 3), note=set_ or "undecided")
    value = known.q50 if q.quantiles else q.value
    above, below = known.q95 - value, value - known.q05
    most = max(above, below)
    least = min(x for x in (above, below, abs(value)) if x > most / UNEVEN) if most > 0 else abs(value) or 1.0
    places = max(DIGITS - 1 - math.floor(math.log10(least)), 0)
    return Cell(*(f"{x:.{places}f}" for x in (value, above, max(below, 0.0))))


def rows_of(results: Sequence[Result]) -> list[tuple[ParameterResult, list[Cell | None]]]:
    """A parameter a row, in the order of the models, without the apparatus's; a result a column."""
    own = [{q.name: q for q in result.parameters if not q.parameter.startswith("grazing_")} for result in results]
    every = {name: q for each in own for name, q in each.items()}
    return [
        (q, [cell(result, each[name]) if name in each else None for result, each in zip(results, own, strict=True)])
        for name, q in every.items()
    ]


def heads(results: Sequence[Result], always: bool = False) -> list[str]:
    """What each column is of: the material, and the model where materials have several, or ``always``; else numbers."""
    names = [result.source.material + (" (edited)" if result.edited_from else "") for result in results]
    twice = {name for name, count in Counter(names).items() if count > 1}
    found = [
        f"{name}, {result.model.name}" if (always or name in twice) and result.model else name
        for name, result in zip(names, results, strict=True)
    ]
    return [name if found.count(name) == 1 else f"{name} {1 + found[:k].count(name)}" for k, name in enumerate(found)]


def notes(results: Sequence[Result]) -> list[str]:
    """What intervals and data are, in a line each."""
    sampled = [any(q.quantiles for q in result.parameters) for result in results]
    by = {
        "posterior": "medians and 90 % intervals of the posterior",
        "laplace": "fitted values, and 90 % intervals by the Laplace approximation",
    }
    said = [by["posterior" if each else "laplace"] for each in sampled]
    data = [f"data: {result.data_words}" for result in results]
    found = []
    for words in (said, data, [result.edited_words for result in results]):
        if len(set(words)) == 1:
            found += [f"{words[0][:1].upper()}{words[0][1:]}"] if words[0] else []
        else:
            found += [f"{name}: {x}" for name, x in zip(heads(results), words, strict=True) if x]
    return [f"{line}." for line in found]


def as_latex(results: Sequence[Result]) -> str:
    """A tabular with the rules of booktabs, to be put into a document; words below it say what it holds."""

    def said(x: Cell | None) -> str:
        if x is None:
            return "--"
        digits, _, power = x.value.partition("e")
        value = f"{digits} \\times 10^{{{int(power)}}}" if power else digits
        ends = f"^{{+{x.above}}}_{{-{x.below}}}" if x.above else ""
        return f"${value}{ends}$" + (f" ({x.note})" if x.note else "")

    lines = [f"\\begin{{tabular}}{{l{'r' * len(results)}l}}", "\\toprule"]
    names = [name.translate(SPECIAL) for name in heads(results)]
    lines += [" & ".join(["parameter", *names, "unit"]) + " \\\\", "\\midrule"]
    for q, cells in rows_of(results):
        name = f"${q.symbol}$" + ("" if q.channel is None else f" {q.channel.translate(SPECIAL)}")
        lines.append(" & ".join([name, *map(said, cells), LATEX_UNITS.get(q.unit, q.unit)]) + " \\\\")
    lines.append("\\midrule")
    for words, (key, unit) in ERRORS.items():
        found = [getattr(result.metrics, key) for result in results]
        values = ["--" if x is None else f"${number(x, 3)}$" for x in found]
        lines.append(" & ".join([words, *values, LATEX_UNITS[unit]]) + " \\\\")
    lines.append("\\bottomrule")
    below = f"\\multicolumn{{{len(results) + 2}}}{{l}}{{\\footnotesize "
    lines += [f"{below}{x.translate(SPECIAL)}}} \\\\" for x in notes(results)]
    return "\n".join([*lines, "\\end{tabular}"]) + "\n"


def as_html(results: Sequence[Result]) -> str:
    """A table, as a part of a page."""

    def said(x: Cell | None) -> Markup:
        if x is None:
            return Markup("–")
        ends = Markup(ENDS).format(x.above, x.below) if x.above else ""
        return Markup("{}{}{}").format(x.value, ends, f" ({x.note})" if x.note else "")

    head = Markup("").join(Markup('<th scope="col">{}</th>').format(x) for x in ["parameter", *heads(results), "unit"])
    body = []
    for q, cells in rows_of(results):
        symbol = re.sub(r"_(\w+)", r"<sub>\1</sub>", str(escape(letters(q.symbol))))
        name = Markup(symbol) + (f" {q.channel}" if q.channel else "")
        values = Markup("").join(Markup("<td>{}</td>").format(said(x)) for x in cells)
        body.append(Markup('<tr><th scope="row" title="{}">{}</th>{}<td>{}</td></tr>').format(
            f"{q.name}: {q.meaning}", name, values, HTML_UNITS.get(q.unit, q.unit)))  # fmt: skip
    for words, (key, unit) in ERRORS.items():
        values = Markup("").join(Markup("<td>{}</td>").format(number(getattr(r.metrics, key), 3)) for r in results)
        row = Markup('<tr><th scope="row">{}</th>{}<td>{}</td></tr>')
        body.append(row.format(words, values, HTML_UNITS.get(unit, unit)))
    said_of = Markup("").join(Markup("<p>{}</p>").format(x) for x in notes(results))
    rows = Markup("\n").join(body)
    return f'<table class="merlfit"><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>\n{said_of}\n'


ENDS = (
    '<span style="display:inline-block;vertical-align:middle;font-size:75%;line-height:1.1;text-align:left;'
    'padding-left:.2em">+{}<br>−{}</span>'
)


def page(results: Sequence[Result]) -> str:
    """`as_html` as a page of its own."""
    style = "body{font-family:sans-serif}td{text-align:right;padding:.1em .8em}th{text-align:left;padding-right:1em}"
    title = escape(", ".join(heads(results)))
    head = '<!doctype html><meta charset="utf-8"><meta name="generator" content="merlfit">'
    return f"{head}<title>{title}</title><style>{style}</style>\n{as_html(results)}"
