"""Richer models beside the default: `python -m tests.richer_models OUT` writes results/richer_models.md and .csv.

All 100 neural reconstructions of MERL and the genuine RGB files of RGL, by `merlfit fit --no-posterior`: the default,
and `--model auto`; of those in `LISTED` also the free split and HP15. An hour of two cores. It goes on where it was
stopped. `--written` fits nothing: rows that OUT has no fit for stay as they are, with the commit that they are of.
"""

import csv
import io
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from merlfit.fitting.results.storage import read_result
from merlfit.merl_io.source import MerlError

from .bench.materials import TWELVE, every
from .bench.processes import MERLFIT, ROOT
from .measured import ORIGINS, commit
from .support.reconstructions import DATA, ORIGIN, make

PAGE = ROOT / "results" / "richer_models.md"
WAYS = {"default": (), "auto": ("--model", "auto"), "free": ("--preset", "free"), "HP15": ("--model", "hp15")}
MEANING = {
    "default": "`merlfit fit` without options",
    "auto": "`--model auto`: coats, surfaces, films and gratings over the two-scale model, where that looks better",
    "free": "`--preset free`: a weight of the diffracted light per channel",
    "HP15": "`--model hp15`",
}
FOR_ALL = ("default", "auto")
LISTED = (
    "silver-metallic-paint", "gold-metallic-paint", "silver-metallic-paint2", *sorted(TWELVE), "cc_green_malachite",
    "cc_nothern_aurora", "cg_sunflower", "chm_mint", "chm_orange", "irid_flake_paint1", "irid_flake_paint2",
    "vch_golden_yellow", "vch_silk_blue", "aurora_white", "satin_purple",
)  # fmt: skip
WORST, FAR = 10, 2.0  # files named; CIELAB distance that does not look like its file
KEYS = (
    "file", "way", "status", "model", "numbers", "cost", "smape", "highlight", "picture", "lamp", "room", "seconds",
    "commit",
)  # fmt: skip
TYPES = {"numbers": int, **dict.fromkeys(("file", "way", "status", "model", "commit"), str)}  # others: float
HEAD = """# Richer models beside the default

Made by `python -m tests.richer_models`:

{ways}

Cost is relative to the weighted energy of the file; picture: mean CIELAB distance over all pixels of spheres under a
lamp and in a room, lamp and room: of lit pixels alone; highlight: fitted over measured peak; numbers: what was free.
Seconds are those of two cores, compilation included where programs were not yet kept. [All rows](richer_models.csv).
"""


def stems_of(origin):
    """Files of one kind of data, by the names of their results."""
    return every() if origin == ORIGIN else sorted(p.stem for p in (DATA / "measured" / "rgl").glob("*_rgb.bsdf"))


def path_of(out, origin, stem):
    """A file, made in the folder if it is a reconstruction that is not there."""
    if origin != ORIGIN:
        return DATA / "measured" / "rgl" / f"{stem}.bsdf"
    path = out / f"{stem}.binary"
    return path if path.is_file() else make(out, stem)


def fit(out):
    """Fit what has no result there."""
    for way, options in WAYS.items():
        for origin in (ORIGIN, ORIGINS["rgl"]):
            stems = [stem for stem in stems_of(origin) if way in FOR_ALL or stem.removesuffix("_rgb") in LISTED]
            paths = [path_of(out, origin, stem) for stem in stems]
            command = [MERLFIT, "fit", *map(str, paths), "-o", str(out / way), "--no-posterior", "--resume", *options]
            subprocess.run([*command, "--jobs", "2", "--origin", origin], check=False)


def written():
    """Rows of the committed table, by file and way."""
    with PAGE.with_suffix(".csv").open(newline="") as text:
        rows = [{key: TYPES.get(key, float)(x) if x else None for key, x in r.items()} for r in csv.DictReader(text)]
    return {(r["file"], r["way"]): r for r in rows}


def commits_of(rows):
    """Which commits the fits of some rows are of, in words."""
    found = {way: sorted({r["commit"] for r in rows if r["way"] == way}) for way in WAYS}
    if len(set().union(*found.values())) == 1:
        return f"Commit {rows[0]['commit']}."
    each = [f"{way} {' and '.join(some)}" for way, some in found.items() if some]
    return f"Commits: {', '.join(each)}."


def row(stem, way, out, at):
    """What the table says of one fit, made by commit `at`; None where there is no result."""
    try:
        r = read_result(out / way / f"{stem}.json")
    except MerlError:
        return None
    m, free = r.metrics, sum(q.fitted == "free" for q in r.parameters)
    name = "-" if r.model is None else f"{r.model.name} {r.model.material.variant}"
    values = (
        stem.removesuffix("_rgb"), way, r.fit.status, name, free, r.fit.cost, m.smape, m.highlight, m.picture,
        m.lamp, m.environment, r.seconds["total"], at,
    )  # fmt: skip
    return dict(zip(KEYS, values, strict=True))


def summary(rows):
    """Lines that compare the ways that all files are fitted in, on those that have a fit in each."""
    fitted = [{r["file"] for r in rows if r["way"] == way} for way in FOR_ALL]
    rows = [r for r in rows if all(r["file"] in some for some in fitted)]
    if not rows:
        return ["No file has a fit in each way."]
    lines = ["| | " + " | ".join(FOR_ALL) + " |", "|---|" + "---|" * len(FOR_ALL)]

    def line(what, of):
        lines.append(f"| {what} | " + " | ".join(of([r for r in rows if r["way"] == way]) for way in FOR_ALL) + " |")

    def middle(key, digits):
        return lambda own: f"{np.median([r[key] for r in own if r[key] is not None]):.{digits}f}"

    line("files", lambda own: str(len(own)))
    for key, digits in (("cost", 4), ("smape", 3), ("picture", 2), ("lamp", 2), ("room", 2), ("numbers", 0)):
        line(f"median {key}", middle(key, digits))
    for key in ("picture", "lamp", "room"):
        line(f"{key} above {FAR:g}", lambda own, key=key: str(sum((r[key] or 0) > FAR for r in own)))
    kept = lambda own: str(sum(r["highlight"] is not None and 0.5 <= r["highlight"] <= 2 for r in own))  # noqa: E731
    line("highlight within a factor of two", kept)
    line("UNEXPLAINED", lambda own: str(sum(r["status"] == "UNEXPLAINED" for r in own)))
    line("at a bound", lambda own: str(sum(r["status"] == "AT_BOUND" for r in own)))
    line(
        "models",
        lambda own: ", ".join(f"{n} {m}" for m, n in Counter(r["model"].split()[0] for r in own).most_common()),
    )
    return lines


def listed(rows):
    """A table of rows."""
    heads = ("file", "fit", "status", "model", "numbers", "cost", "sMAPE", "highlight", "picture", "lamp, room", "s")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]

    def number(x, form):
        return "-" if x is None else format(x, form)

    for r in rows:
        both = f"{number(r['lamp'], '.1f')}, {number(r['room'], '.1f')}"
        cells = (
            r["file"], r["way"], r["status"], r["model"], str(r["numbers"]), number(r["cost"], ".4f"),
            number(r["smape"], ".3f"), number(r["highlight"], ".2f"), number(r["picture"], ".2f"), both,
            number(r["seconds"], ".0f"),
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def write(out, at):
    """The page and the table of all rows, of what there is."""
    lines, every_row, kept = [], [], written()
    for origin in (ORIGIN, ORIGINS["rgl"]):
        both = [(stem, way) for stem in stems_of(origin) for way in WAYS]
        found = [row(stem, way, out, at) or kept.get((stem.removesuffix("_rgb"), way)) for stem, way in both]
        rows = [r for r in found if r is not None]
        worst = sorted((r for r in rows if r["way"] == "auto"), key=lambda r: -(r["picture"] or 0))[:WORST]
        lines += [f"## {origin[0].upper()}{origin[1:]}", "", commits_of(rows), "", *summary(rows), ""]
        lines += [f"The {WORST} whose pictures are worst by `auto`:", "", *listed(worst), ""]
        lines += ["Some files by all that was fitted:", "", *listed([r for r in rows if r["file"] in LISTED]), ""]
        every_row += rows
    used = {r["way"] for r in every_row}
    head = HEAD.format(ways="\n".join(f"- **{way}**, {MEANING[way]}" for way in WAYS if way in used))
    PAGE.write_text("\n".join([head, *lines]).rstrip() + "\n")
    table = io.StringIO()
    writer = csv.DictWriter(table, KEYS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: f"{x:.6g}" if isinstance(x, float) else x for key, x in r.items()} for r in every_row)
    PAGE.with_suffix(".csv").write_text(table.getvalue())


if __name__ == "__main__":
    if "--written" not in sys.argv:
        fit(Path(sys.argv[1]))
    write(Path(sys.argv[1]), commit())
