"""Several models on several materials as tables (CSV, Markdown, HTML) and as the sorted errors of HP17 Fig. 11."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from markdown_it import MarkdownIt
from matplotlib.figure import Figure
from rich.table import Table

from ...merl_io.atomic import write_text
from ...model.two_scale import TwoScale
from ..fit.error_metrics import Errors
from ..fit.outcome import POOR
from ..fit.selection import ALIKE, SEEN, VISIBLE, least, lost
from ..fit.tabulated import Tabulated
from ..pipeline.comparison import FIT, Row
from ..pipeline.stacking import ScatterOfSeveral
from ..posterior.importance import LARGEST_K
from ..support.numbers import counted, distance, median, number
from ..support.tables import as_csv, as_markdown, table
from .style import own_style, plain, save

LIT = {"lamp": "dE lamp", "environment": "dE room"}
"""CIELAB distance of lit pixels; the dE of `FIGURES` is that of all pixels under both lights."""
FIGURES = {
    "rmse": "RMSE (1/sr)", "smape": "sMAPE", "cube_root": "cube-root error", "log": "log error",
    "picture": "dE", "highlight": "peak",
}  # fmt: skip
SORTED = ("rmse", "smape")  # errors of the figure
COLOURS = 8  # models that it names
NAME = "comparison"  # of the files of a comparison
RANKED = ("rmse", "smape", "cube_root", "log", "picture", "highlight")
"""Errors by which models are ranked; of the peak, how far it is from 1 as a factor."""
GROUPS = {
    "metallic paints": ("metallic-paint", "color-changing-paint", "pearl-paint", "two-layer"),
    "fabrics": ("fabric", "felt", "velvet"),
    "woods": ("cherry", "oak", "maple", "walnut", "fruitwood", "ipswich", "pine", "natural-209"),
    "plastics": (
        "plastic", "phenolic", "acrylic", "delrin", "teflon", "pvc", "nylon", "polyethylene", "polyurethane", "rubber",
        "neoprene",
    ),
    "metals": (
        "chrome", "nickel", "brass", "alumin", "steel", "ss440", "tungsten", "bronze", "hematite", "oxidized",
    ),
    "paints": ("paint",),
}  # fmt: skip
"""Words in the names of MERL's materials, by group, the first group that has one counting."""
WHAT = (
    "RMSE: root of the mean squared error weighted by cos^2 theta_i over directions of the light and the viewer (HP15 "
    "Eq. 31, HP17 Table 2, normalised to a mean); sMAPE: mean of |m - p| / (m + p); cube-root and log error: root mean "
    "squares of differences of cube roots and of log(1 + x) of BRDF times cos theta_i; dE: mean CIELAB distance of "
    "spheres under a lamp and under an environment (D65) over all pixels, dE lamp and dE room: under one of "
    "them over lit pixels; peak: brightest value at theta_h = 0 over the file's"
)
CRITERION = (
    "BIC: N log J + P log N of the cost J with the effective count N of the best fit and the P numbers of the model, "
    "the apparatus's among them"
)


def group_of(material: str) -> str:
    """What a material of MERL is by its name, as HP17 5.1.4 groups them; ``others`` where the name does not tell."""
    return next((group for group, words in GROUPS.items() if any(word in material for word in words)), "others")


def label(row: Row) -> str:
    """Name of a column or line: the model, and where its parameters are from."""
    return row.model if row.origin == FIT else f"{row.origin} (published)"


def by_label(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Rows of each model and of each published table."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(label(row), []).append(row)
    return found


def figure_of(row: Row, name: str) -> float:
    """One of :data:`FIGURES` as the smaller the better: of the peak its distance from 1 as a factor."""
    x = getattr(row.errors, name)
    return x if name != "highlight" else float(np.exp(abs(math.log(x)))) if x > 0 else float("inf")


def winners(rows: Sequence[Row], name: str) -> dict[str, tuple[str, float]]:
    """For every material the model with the lowest error, and how many times the second best one has it.

    Materials of which no row has this error are left out: some files have too few directions for a picture.
    """
    found = {}
    for material in dict.fromkeys(row.material for row in rows):
        own = sorted(
            (r for r in rows if r.material == material and not np.isnan(figure_of(r, name))),
            key=lambda r: figure_of(r, name),
        )
        if not own:
            continue
        best, second = [*(figure_of(row, name) for row in own), float("nan")][:2]
        found[material] = label(own[0]), second / best if best > 0 else float("inf")
    return found


def table_of(rows: Sequence[Row]) -> Table:
    """What `merlfit compare` prints: medians by model, and on how many materials each is the best."""
    several = len({row.material for row in rows}) > 1
    title = (
        f"{'medians over the materials' if several else rows[0].material} (dE: CIELAB distance of spheres, of "
        f"all pixels, and of lit ones by lamp and room; peak: fitted over measured highlight"
        f"{'; best: materials with the lowest RMSE, dE' if several else ''})"
    )
    more = ["best"] if several else []
    heads = ("model", "numbers", "RMSE", "sMAPE", "dE", "lamp", "room", "peak", "BIC", "s", *more)
    found = table(title, heads, heads[:1])
    best = [winners(rows, name) for name in ("rmse", "picture")]
    for name, own in by_label(rows).items():
        count = " ".join(str(sum(winner == name for winner, _ in each.values())) for each in best)
        found.add_row(
            name if several or own[0].variant == own[0].model or own[0].origin != FIT else f"{name} ({own[0].variant})",
            number(median(r.numbers for r in own)), *(shown(f, median(getattr(r.errors, f) for r in own))
            for f in ("rmse", "smape", "picture", *LIT, "highlight")),
            number(median(r.bic for r in own)), number(median(r.seconds for r in own), 3),
            *([count] if several else []),
        )  # fmt: skip
    return found


def shown(name: str, x: float) -> str:
    """An error as tables have it."""
    return distance(x) if name in ("picture", *LIT) else number(x, 3)


def verdict(rows: Sequence[Row]) -> str:
    """Which model is the least that explains one material, in a paragraph."""
    fitted = [row for row in rows if row.origin == FIT and np.isfinite(row.cost)]
    if not fitted:
        return "no model could be fitted"
    figures = zip(*((r.bic, r.errors.picture, r.errors.highlight, r.numbers) for r in fitted), strict=True)
    chosen = fitted[least(*figures)]
    seen = np.isfinite(chosen.errors.picture)  # a file may have too few directions for a picture
    nearest = min(fitted, key=lambda r: r.errors.picture) if seen else chosen
    lowest = min(fitted, key=lambda r: r.bic)

    def loses(row: Row) -> str:
        """Why another is chosen, if that is why."""
        peak = row.errors.highlight
        one = lost(peak) and not lost(chosen.errors.highlight)
        return f"but it loses the highlight, which is {number(peak, 2)} times the file's" if one else ""

    least_said = (
        "the least model that explains it is"
        if explains(chosen)
        else f"{'none of these models explains it; the best is' if len(fitted) > 1 else 'it is not explained by'}"
    )
    said = (
        f"{chosen.material}: {least_said} {named(chosen)}, with {chosen.numbers} numbers: "
        + (f"its spheres differ from the file's by {distance(chosen.errors.picture)} (CIELAB), " if seen else "")
        + f"its RMSE is {number(chosen.errors.rmse, 3)}/sr."
    )
    if chosen is not nearest:
        why = ", " + loses(nearest) if loses(nearest) else f": less than {SEEN:g} nearer, which is just noticeable"
        said += f" The nearest picture is that of {named(nearest)}, off by {distance(nearest.errors.picture)} with "
        said += f"{nearest.numbers} numbers{why}."
    if chosen is not lowest:
        less = chosen.bic - lowest.bic
        if loses(lowest):
            why = loses(lowest)
        elif less <= ALIKE and lowest.numbers >= chosen.numbers:
            why = f"less than {ALIKE:g} is no strong evidence"
        else:
            why = f"but its picture is off by {distance(lowest.errors.picture)}"
        said += f" The lowest BIC is that of {named(lowest)}, {number(less, 2)} lower: {why}."
    for default in (row for row in fitted if row.model == TwoScale.name and row not in (chosen, lowest)):
        if (more := default.bic - chosen.bic) > ALIKE:
            said += f" The default model, {named(default)}, has a BIC {number(more, 3)} higher."
    if lost(peak := chosen.errors.highlight):
        said += f" Its highlight is {number(peak, 2)} times the file's: try "
        said += f"`merlfit fit --weights {'adaptive' if seen else 'none'}`."
    return said


def beside_table(rows: Sequence[Row], table: Tabulated, errors: Errors) -> str:
    """How far the lowest cost of some fits of one file is from that of tables, and their pictures, in a sentence."""
    lowest = min((row for row in rows if row.origin == FIT), key=lambda r: np.nan_to_num(r.cost, nan=np.inf))

    def left(cost: float, picture: float) -> str:
        return f"{number(100 * cost, 2)} % of the weighted energy" + (
            f" (spheres {distance(picture)} off)" if np.isfinite(picture) else ""
        )

    return (
        f" Tables of theta_h and theta_d and of theta_i and theta_o, {table.numbers:,} numbers that explain "
        f"nothing, leave {left(table.cost, errors.picture)}, {named(lowest)} "
        f"{left(lowest.cost, lowest.errors.picture)}."
    )


def explains(row: Row) -> bool:
    """Whether a fit looks like its file, and leaves little of its energy."""
    pictures = (row.errors.picture, row.errors.lamp, row.errors.environment)
    return not any(x > VISIBLE for x in pictures) and row.cost <= POOR


def named(row: Row) -> str:
    """The model, and which variant of it."""
    variant = row.variant.removeprefix(row.model).strip()
    return f"{row.model} ({variant})" if variant else row.model


def compared_in(folder: Path, name: str = NAME) -> list[Path]:
    """Files of `write_tables`."""
    return [folder / f"{name}.{ending}" for ending in ("csv", "md", "html", "png")]


def write_tables(rows: Sequence[Row], folder: Path, name: str, title: str, data: str) -> list[Path]:
    """``NAME.csv``, ``NAME.md``, ``NAME.html`` and ``NAME.png``.

    Args:
        data: what the data are, in a sentence.

    Raises:
        merlfit.merl_io.atomic.WriteError: one cannot be written.
    """
    written = compared_in(folder, name)
    text = markdown(rows, title, data, written[3].name)
    page = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    write_text(written[0], _csv(rows))
    write_text(written[1], text)
    write_text(written[2], PAGE.format(title=escape(title), page=page))
    save(sorted_errors(rows, f"{title}\ndata: {data}"), written[3])
    return written


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="merlfit"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 80rem; padding: 0 1rem;
  color: #222; background: #fff }}
table {{ border-collapse: collapse; display: block; overflow-x: auto; margin: 1rem 0 }}
th, td {{ padding: .25rem .6rem; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap }}
th:first-child, td:first-child {{ text-align: left }} img {{ max-width: 100% }}
@media (prefers-color-scheme: dark) {{ body {{ color: #ddd; background: #181818 }} th, td {{ border-color: #444 }}
  img {{ background: #fff }} }}
</style></head><body>
{page}
</body></html>
"""


def _csv(rows: Sequence[Row]) -> str:
    lines = [{"group": group_of(row.material), **row.flat()} for row in rows]
    for line in lines:
        line["values"] = json.dumps({name: float(f"{x:.6g}") for name, x in line["values"].items()})
    return as_csv(list(lines[0]), lines)


def markdown(rows: Sequence[Row], title: str, data: str, picture: str) -> str:
    """The whole comparison: medians, who wins where by how much, groups, every material."""
    labels = by_label(rows)
    materials = list(dict.fromkeys(row.material for row in rows))
    lines = [
        f"# {title}",
        "",
        f"Data: {data}. Errors over each file's own bins of (theta_h, theta_d, phi_d), or its samples, both "
        f"directions at theta < fit.theta_max. {WHAT}. {CRITERION}.",
    ]

    def section(title: str, said: str, heads: Sequence[str], table: Iterable[Sequence[object]]) -> None:
        lines.extend(["", f"## {title}", *(["", said] if said else []), "", as_markdown(heads, table)])

    section("Medians", "", ["model", "materials", "numbers", *FIGURES.values(), "BIC", "s"], (
        [name, len(own), number(median(r.numbers for r in own)),
         *(number(median(getattr(r.errors, f) for r in own), 3) for f in FIGURES),
         number(median(r.bic for r in own)), number(median(r.seconds for r in own), 2)]
        for name, own in labels.items()
    ))  # fmt: skip
    wins = {name: winners(rows, name) for name in RANKED}
    section(
        "Who wins where",
        "Materials on which a model has the lowest error of all; in brackets by what factor the second best has more, "
        "in the median over these.",
        ["model", *(FIGURES[name] for name in RANKED)],
        ([name, *(_won(wins[f], name) for f in RANKED)] for name in labels),
    )

    def grouped(title: str, said: str, of: Mapping[str, str]) -> None:
        groups = sorted(set(of.values()))
        if len(groups) < 2:
            return
        counts = Counter(of.values())
        columns = (
            [median(r.errors.rmse for r in own if of.get(r.material) == g) for own in labels.values()] for g in groups
        )
        heads = ["model", *(f"{g} ({counts[g]})" for g in groups)]
        section(title, said, heads, zip(labels, *map(_lowest_bold, columns), strict=True))

    lowest = "Median RMSE (1/sr), the lowest in bold."
    grouped(
        "By kind of material",
        f"By the material's name, as in HP17 5.1.4. {lowest}",
        {m: group_of(m) for m in materials},
    )
    kinds = {row.material: row.variant for row in rows if row.model == "two-scale"}
    grouped("By the interface and body that the two-scale model found", lowest, kinds)
    names, bodies = sorted({group_of(m) for m in kinds}), sorted(set(kinds.values()))
    if len(names) > 1 and len(bodies) > 1:
        both = Counter((group_of(m), body) for m, body in kinds.items())
        section(
            "Kinds of material, and what the two-scale model found", "Materials of each, as in HP17 5.1.4.",
            ["kind", *bodies], ([name, *(both[name, body] for body in bodies)] for name in names),
        )  # fmt: skip
    lines += ["", f"![sorted errors]({picture})"]
    found = {(name, row.material): row.errors.rmse for name, own in labels.items() for row in own}
    section(
        "Every material: RMSE (1/sr)", "The lowest of each material in bold.", ["material", *labels],
        ([m, *_lowest_bold([found.get((name, m)) for name in labels])] for m in materials),
    )  # fmt: skip
    return "\n".join(lines) + "\n"


def _lowest_bold(errors: Sequence[float | None]) -> list[str]:
    """Numbers as text, the lowest in bold."""
    low = min((x for x in errors if x is not None and np.isfinite(x)), default=None)
    return [f"**{number(x, 3)}**" if x is not None and x == low else number(x, 3) for x in errors]


def _won(winners_: dict[str, tuple[str, float]], name: str) -> str:
    by = [factor for winner, factor in winners_.values() if winner == name]
    return f"{len(by)} ({number(median(by), 3)})" if by else "0"


@own_style()
def sorted_errors(rows: Sequence[Row], title: str) -> Figure:
    """HP17 Fig. 11: errors of every model, each sorted by itself; bars where there is one material."""
    labels = by_label(rows)
    several = max(map(len, labels.values())) > 1
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    told = _nearest(labels)
    for axis, name in zip(figure.subplots(1, 2), SORTED, strict=True):
        for each, own in labels.items():
            found = np.sort([getattr(row.errors, name) for row in own])
            fitted = own[0].origin == FIT
            if not several:
                axis.barh(plain(each), found, color="C0" if fitted else "C7")
                continue
            look: dict[str, Any] = {"color": "0.75", "linewidth": 0.8, "zorder": 1}
            if each in told:
                look = {"color": f"C{told.index(each)}", "linewidth": 2.4 if each == "two-scale" else 1.4}
                look["label"] = plain(each)
            axis.plot(np.linspace(0, 100, len(found)), found, "-" if fitted else ":", **look)
        if several:
            axis.set(yscale="log", xlabel="materials, each model sorted by itself (%)", ylabel=FIGURES[name])
        else:
            axis.invert_yaxis()
            axis.set(xlabel=FIGURES[name])
        axis.grid(alpha=0.3)
    if several:
        if len(told) < len(labels):
            figure.axes[0].plot([], [], color="0.75", linewidth=0.8, label=f"{len(labels) - len(told)} others")
        figure.axes[0].legend(fontsize=8, loc="upper left")
    figure.suptitle(plain(title), fontsize=11)
    return figure


def _nearest(labels: Mapping[str, Sequence[Row]]) -> list[str]:
    """The two-scale model, if it is there, and the models of least errors in the median, as many as colours tell."""

    def least(name: str) -> list[str]:
        of_each = {each: median(getattr(row.errors, name) for row in own) for each, own in labels.items()}
        return sorted(labels, key=lambda each: (math.isnan(of_each[each]), of_each[each]))

    turns = zip(*map(least, SORTED), strict=True)
    first = [name for name in ("two-scale",) if name in labels]
    return list(dict.fromkeys([*first, *(name for each in turns for name in each)]))[:COLOURS]


def several_table(found: ScatterOfSeveral, channels: Sequence[str]) -> Table:
    """Total integrated scatter by incidence as each model's posterior has it, and as all together."""
    drawn = table(
        "total integrated scatter (TIS): medians and 90 % intervals of posteriors, and of all by their weights",
        ("light at", "channel", "together", *(f"{name} ({weight:.0%})" for name, weight in found.weights.items())),
        ("channel",),
    )

    def said(ends: np.ndarray) -> str:
        low, middle, high = map(number, ends.tolist())
        return f"{middle} ({low} .. {high})"

    for k, theta in enumerate(np.degrees(found.theta_i)):
        for c, channel in enumerate(channels):
            each = [said(x[:, c, k]) for x in (found.together, *found.own.values())]
            drawn.add_row(f"{number(theta)} deg", channel, *each)
    return drawn


def several_words(found: ScatterOfSeveral) -> str:
    """How the weights were come by, and whether they can be trusted."""
    doubtful = [name for name, k in found.pareto_k.items() if k > LARGEST_K]
    return (
        "weights: of the mixture of posteriors that predicts best what is left out of the data (stacking, Yao et al. "
        f"2018), {counted(found.pieces, 'piece')} in turn; N is {number(found.count, 3)}"
        + (f"; uncertain of {', '.join(doubtful)}: Pareto k is above {LARGEST_K} for a piece" if doubtful else "")
    )
