"""What ``merlfit cost`` measured, as tables and in a paragraph."""

from io import StringIO
from itertools import pairwise
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from ...merl_io.atomic import write_text
from ..settings.choice import Choice, default_choice
from ..support.numbers import number
from .frontier import Frontier, Percentiles, Point, pareto

MARK = "*"
NOTICED = 0.9  # of an error: less is a step that gains something
SAID = {
    "diffraction": "{}", "order": "order {}", "grid": "the {} grid", "azimuths": "{} azimuths", "precision": "{}",
    "starts": "{} starts",
}  # fmt: skip


def tables(frontier: Frontier) -> list[Table]:
    """Tiers as they are evaluated, and fits."""
    return [tier_table(frontier), point_table(frontier)]


def _table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(title=title)
    for head in left + right:
        table.add_column(head, justify="left" if head in left else "right")
    return table


def _cells(found: Percentiles | None) -> list[str]:
    return [number(x, 2) for x in ((None,) * 3 if found is None else (found.median, found.p95, found.worst))]


def tier_table(frontier: Frontier) -> Table:
    """Errors and times of the tiers of the diffraction lobe."""
    table = _table(
        f"Evaluation, ns for three channels; errors of the BRDF against exact ({frontier.directions})", ("tier",),
        ("error: median", "95 %", "worst", "a direction (ns)", "with gradient", "a bin of a fit (ns)", "with gradient ",
         "compile (s)", "with gradient  "),
    )  # fmt: skip
    for t in frontier.tiers:
        speeds = (t.value_ns, t.gradient_ns, t.fit_value_ns, t.fit_gradient_ns, *t.compile_seconds)
        mark = MARK if t.name == default_tier() else ""
        table.add_row(t.name + mark, *_cells(t.error), *(number(x, 3) for x in speeds))
    return table


def point_table(frontier: Frontier) -> Table:
    """Errors, times and memory of fits."""
    table = _table(
        f"Fits of {frontier.data}: distance from the reference fit; promised: the larger of it and its estimate",
        ("settings",),
        ("error: median", "95 %", "worst", "promised, 95 %", "failed", "other body", "parameters, median (std. err.)",
         "RMSE, median (1/sr)", "fit (s): median", "95 % ", "estimate (s)", "memory (MB)"),
    )  # fmt: skip
    for q in frontier.points:
        mark = MARK if q.choice == default_choice() else ""
        table.add_row(
            f"{q.choice}{mark}", *_cells(q.error), number(q.promised.p95, 2), f"{q.failed:.0%}", f"{q.other_body:.0%}",
            number(q.parameters and q.parameters.median, 2), number(q.rmse.median, 3), number(q.seconds.median, 3),
            number(q.seconds.p95, 3), number(q.estimate_seconds.median, 2), number(q.megabytes, 4),
        )  # fmt: skip
    return table


def default_tier() -> str:
    """Name of the tier that fits take by default."""
    return f"{default_choice().diffraction} {default_choice().order}"


def front(frontier: Frontier) -> list[Point]:
    """Fits than which none is both as fast and as accurate, fastest first; each noticeably better than the last."""
    points = frontier.points
    ordered = [points[i] for i in pareto([q.seconds.median for q in points], [q.error.p95 for q in points])]
    steps = ordered[:1]
    for q in ordered[1:]:
        if q.error.p95 < NOTICED * steps[-1].error.p95:
            steps.append(q)
    return steps


def gains(frontier: Frontier) -> str:
    """What is gained at each step along the front, in a paragraph."""
    steps = front(frontier)
    first = steps[0]
    said = [
        f"The cheapest fit ({first.choice}) takes {first.seconds.median:.2g} s and is within {first.error.p95:.2g} of "
        "the reference fit for 95 % of the materials."
    ]
    for before, after in pairwise(steps):
        reached, seconds = after.error.p95, after.seconds.median
        gain = "the reference itself"
        if reached:
            gain = f"{before.error.p95 / reached:.2g} times as accurate ({reached:.2g})"
        price = f"{seconds / before.seconds.median:.2g} times the time ({seconds:.2g} s)"
        said.append(f"{changes(before.choice, after.choice)}: {gain} in {price}.")
    default = next((q for q in frontier.points if q.choice == default_choice()), None)
    if default is not None:
        said.append(
            f"The defaults ({default.choice}) are within {default.error.p95:.2g}, half of them within "
            f"{default.error.median:.2g}, in {default.seconds.median:.2g} s."
        )
    return " ".join(said)


def changes(before: Choice, after: Choice) -> str:
    """In which settings two choices differ."""
    old, new = before.model_dump(), after.model_dump()
    if old["diffraction"] != "quadrature":
        old.pop("order")  # which has no effect there
    words = [f"{SAID[key].format(new[key])} instead of {old[key]}" for key in old if old[key] != new[key]]
    return " and ".join(words).capitalize()


def write_markdown(frontier: Frontier, path: Path) -> None:
    """Tables and paragraph as Markdown."""
    text = StringIO()
    console = Console(file=text, width=300)
    for table in tables(frontier):
        console.print(f"\n**{table.title}**\n", markup=False, soft_wrap=True)
        table.title, table.box = None, box.MARKDOWN
        console.print(table)
    console.print(f"\n{MARK} the defaults. {gains(frontier)}", markup=False, soft_wrap=True)
    console.print(
        f"\nMeasured by `merlfit cost` on {frontier.machine}, {frontier.taken}; seconds are those of one file from "
        "reading to the metrics, all five kinds of material, once compiled and without posterior; the estimate of the "
        "error, for `--accuracy` and `--time`, comes on top.", markup=False, soft_wrap=True,
    )  # fmt: skip
    write_text(
        path,
        "# What accuracy costs in time\n\n"
        + "\n".join(line.rstrip() for line in text.getvalue().strip().splitlines())
        + "\n",
    )
