"""What accuracy costs: every preset, a rival and `auto` beside the default, drawn as error against time."""

import json
import os
import statistics
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load
from merlfit.model.effects import PRESETS

from .materials import TWELVE, file
from .processes import MERLFIT, watch, worker
from .record import RECONSTRUCTIONS, Record, Target

STARTED = "nickel"  # of which new processes are started
STARTS = 3
DEFAULT = "hp17"
WAYS = {name: {"preset": name} for name in PRESETS if name != "reference"}  # which no fit takes
WAYS |= {"ggx": {"model": "ggx"}, "auto": {"model": "auto"}}
OTHERS = ("ggx", "auto")  # no presets
LEAST_SHOWN = 0.5  # CIELAB
WORDS = {DEFAULT: "default: two scales", "ggx": "GGX, a rival", "auto": "--model auto", "free": "free weight"}
NEXT_TO = {  # points from the mark to its word, and on which side the mark is
    "preview": (-8, -12, "right"), "fast": (-8, 5, "right"), "microfacet": (4, -16, "left"), DEFAULT: (10, -14, "left"),
    "free": (4, -15, "left"),
}  # fmt: skip


def measure(settings, first, *paths):
    """Fits of some files by settings (JSON), after one that loads programs; seconds and errors of each."""
    config, found = load(**json.loads(settings), posterior=False), []
    with tempfile.TemporaryDirectory() as out:
        for path in (first, *paths):
            start = time.perf_counter()
            result = fit_file(path, Path(out), config)
            m = result.metrics
            found.append({
                "seconds": time.perf_counter() - start, "model": f"{result.model.name} {result.model.material.variant}",
                "cost": result.fit.cost, "rmse": m.rmse, "smape": m.smape, "picture": m.picture, "lamp": m.lamp,
                "room": m.environment, "status": result.fit.status,
            })  # fmt: skip
    return found[1:]


def started(path, settings):
    """Seconds from the shell to the result in a new process: with programs kept, median; and with none."""
    options = [word for name, value in settings.items() for word in (f"--{name}", value)]
    with tempfile.TemporaryDirectory() as cache, patch.dict(os.environ, {"MERLFIT_CACHE_DIR": cache}):
        runs = []
        for k in range(STARTS + 1):
            command = [MERLFIT, "fit", str(path), *options, "--no-posterior", "-o", f"{cache}/{k}"]
            runs.append(watch(command, codes=(0, 1)).seconds)
        return statistics.median(runs[1:]), runs[0]


def drawn(rows, path):
    """Error against seconds from the shell; the line ends where the very first run does."""
    figure = Figure(figsize=(7.2, 3.6), dpi=150, layout="constrained")
    axis = figure.subplots()
    for row in rows:
        way, own = row["way"], row["way"] == DEFAULT
        colour = "#D55E00" if own else "#009E73" if way in OTHERS else "#0072B2"
        axis.plot(
            [row["new process s"], row["very first s"]], [row["CIELAB"]] * 2, color=colour, linewidth=1, alpha=0.5
        )
        axis.plot(row["very first s"], row["CIELAB"], "|", color=colour, markersize=9)
        axis.plot(row["new process s"], row["CIELAB"], "*" if own else "o", color=colour, markersize=17 if own else 8)
        right, up, side = NEXT_TO.get(way, (8, 5, "left"))
        axis.annotate(
            WORDS.get(way, way), (row["new process s"], row["CIELAB"]), (right, up), textcoords="offset points",
            horizontalalignment=side, color=colour, weight="bold" if own else "normal",
        )  # fmt: skip
    axis.set(
        xscale="log", ylim=(LEAST_SHOWN, 1.1 * max(row["CIELAB"] for row in rows)),
        xlabel="seconds from the shell to the result of one file; the line ends at those of the very first time",
        ylabel="CIELAB distance of spheres",
        title="What accuracy costs: 12 neural reconstructions, medians",
    )  # fmt: skip
    axis.set_xticks([5, 10, 20, 50, 100, 200])
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    figure.savefig(path)


def run(folder, out, every):
    """The default first, to which the others are compared."""
    record = Record(
        "presets", "What accuracy costs: presets and rivals", f"{RECONSTRUCTIONS}: 12 materials",
        ["![error against time](presets.png)",
         "`merlfit fit FILE --preset PRESET --no-posterior`, or `--model MODEL`; medians of the materials. Seconds: of "
         "a fit in one process that has its programs; times the default: median of the ratios to hp17, the same run of "
         f"this section. New process: from the shell to the result of {STARTED}, median of {STARTS} with programs "
         "kept; very first: the same with none. CIELAB: distance of all pixels of spheres of file and fit, in a room "
         "and under a lamp, and of lit ones under either; off: materials whose lit pixels under the lamp are off by "
         "more than 2."],
        {"conserving": Target("conserving, times as long as the default", 3, "times"),
         "fast": Target("fast, times as long as the default", 1, "times"),
         "warm": Target("from the shell to the result, five kinds, programs kept", 5, "s"),
         "first": Target("the same, the very first time", 25, "s")},
        folder=out,
    )  # fmt: skip
    record.resume()
    paths, default = {material: file(folder, material) for material in TWELVE}, None
    for way, settings in WAYS.items():
        held = [row for row in record.rows if row["way"] == way]
        if held:
            found = held[0]["details"]
        else:
            found = dict(
                zip(TWELVE, worker("presets", json.dumps(settings), paths[STARTED], *paths.values())[0], strict=True)
            )
        seconds = np.array([each["seconds"] for each in found.values()])
        default = seconds if default is None else default
        ratio = float(np.median(seconds / default))
        if not held:
            warm, first = started(paths[STARTED], settings)
            middle = {name: float(np.median([each[name] for each in found.values()])) for name in
                      ("picture", "lamp", "room", "smape", "rmse", "cost")}  # fmt: skip
            record.add({
                "way": way, "seconds": float(np.median(seconds)), "times the default": ratio, "new process s": warm,
                "very first s": first, "CIELAB": middle.pop("picture"), **middle,
                "off": sum(each["lamp"] > 2 for each in found.values()),
            }, found)  # fmt: skip
        if way == DEFAULT:
            record.set("warm", record.rows[0]["new process s"])
            record.set("first", record.rows[0]["very first s"])
        if way in record.targets:
            record.set(way, ratio)
    drawn(record.rows, out / "presets.png")
    record.finish()
