"""Every rival on all 100 materials of MERL: `python -m tests.merl100_rivals [compressive|none]`; hours on two cores.

Goes on where it was stopped, and several may run side by side, each with a share of the materials: `--share 1/2`. The
two-scale model's rows are those of `tests.merl100`. Every material is read once for all models. The two kinds of
weights must not run at the same time. Tables: results/merl100/rivals_WEIGHTS.{csv,md,html,png}.
"""

import json
import os
import time
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from merlfit.fitting.fit.error_metrics import Errors
from merlfit.fitting.fit.published_errors import assess_published, sources_of
from merlfit.fitting.fit.selection import bic
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.comparison import FIT, Row, config_of, published_row
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.settings.config import load
from merlfit.fitting.show.comparison_table import write_tables
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.atomic import write_atomically
from merlfit.merl_io.binary import read
from merlfit.model.registry import models

from .bench.materials import every, file
from .bench.record import RECONSTRUCTIONS
from .merl100 import FITS, FOLDER

FIRST = ("epd", "sgd", "smooth", "he")  # those that HP17 compares itself with
NAMES = [*FIRST, *(name for name in models() if name not in (*FIRST, "two-scale"))]
PARTS = FOLDER / "rivals"  # a JSON a material
FIGURES = ("rmse", "smape", "cube_root", "log", "highlight", "picture")


def kept(fitted, seconds):
    """What is kept of one fit."""
    return {
        "variant": fitted.material.variant, "status": fitted.status.name, "weights": fitted.exponent,
        "cost": fitted.solution.cost, "effective_bins": fitted.count, "seconds": seconds,
        "values": dict(zip(fitted.layout.names, fitted.values.tolist(), strict=True)),
        **{name: getattr(fitted.errors, name) for name in FIGURES},
    }  # fmt: skip


def fitted_of(measurement, samples, name, weights):
    """One model fitted as `merlfit compare` does it."""
    start, config = time.perf_counter(), config_of(load(posterior=False, weights=weights), name)
    return kept(fit(measurement, samples, config), time.perf_counter() - start)


def measure(material, weights, names):
    """All that is missing of one material."""
    target = PARTS / f"{material}.json"
    rows = json.loads(target.read_text()) if target.is_file() else {}
    done = rows.setdefault(weights, {})
    missing = [name for name in names if name not in done]
    with_sets = "published" not in done and set(names) == set(NAMES)
    if not (missing or with_sets):
        return
    with TemporaryDirectory() as made:
        measurement = read(file(os.environ.get("MERL_RECONSTRUCTIONS", made), material))
    config = load(posterior=False, weights=weights)
    samples = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
    for name in missing:
        done[name] = fitted_of(measurement, samples, name, weights)
        keep(target, rows)
        r = done[name]
        print(
            f"{weights} {material} {name}: RMSE {r['rmse']:.3g} dE {r['picture']:.3g} {r['seconds']:.1f} s", flush=True
        )
    if with_sets:
        done["published"] = {
            source: {**{k: getattr(found, k) for k in FIGURES}, "cost": cost}
            for source in sources_of(material) for found, cost in [assess_published(source, measurement, samples)]
        }  # fmt: skip
    keep(target, rows)


def keep(target, rows):
    """What is known of a material."""
    text = json.dumps(rows, indent=1) + "\n"
    PARTS.mkdir(parents=True, exist_ok=True)
    write_atomically(target, lambda opened: opened.write(text.encode()))


def rows_of(weights, names):
    """Rows of the materials that all of these models were fitted to, the two-scale model first."""
    ours = {row["material"]: row[weights] for row in json.loads(FITS.read_text()) if weights in row}
    found = []
    for path in sorted(PARTS.glob("*.json")):
        done, material = json.loads(path.read_text()).get(weights, {}), path.stem
        if material not in ours or not set(names) <= set(done):
            continue
        one = ours[material]
        every_fit = {
            "two-scale": {**one, "variant": f"{one['index']} {one['body']}", "values": one["parameters"]},
            **{name: done[name] for name in names},
        }
        count = min((r["cost"], r["effective_bins"]) for r in every_fit.values())[1]
        for name, r in every_fit.items():
            errors = Errors(**{k: r[k] if r[k] is not None else float("nan") for k in FIGURES})
            numbers = len(r["values"])
            found.append(Row(
                material, False, name, r["variant"], FIT, r["weights"], r["status"], numbers, errors, r["cost"],
                bic(r["cost"], numbers, count), r["seconds"], r["values"],
            ))  # fmt: skip
        for source, r in done.get("published", {}).items():
            errors = Errors(**{k: r[k] for k in FIGURES})
            found.append(published_row(material, source, False, errors, r["cost"]))
    return found


def main(
    weights: Annotated[str, typer.Argument(help="compressive or none.")] = "compressive",
    share: Annotated[str, typer.Option(help="Which share of the materials, 1/2 or 2/2.")] = "1/1",
    names: Annotated[str, typer.Option(help="Models, with commas between.")] = ",".join(NAMES),
) -> None:
    """Fit what is missing, and write the tables of what is there."""
    use_persistent_cache()
    part, of = map(int, share.split("/"))
    for material in every()[part - 1 :: of]:
        measure(material, weights, names.split(","))
    if rows := rows_of(weights, names.split(",")):
        count = len({row.material for row in rows})
        said = "no" if weights == "none" else weights
        title = f"The two-scale model and its rivals on {count} materials, {said} weights"
        write_tables(rows, FOLDER, f"rivals_{weights}", title, f"{RECONSTRUCTIONS}; nothing here is of a genuine file")


if __name__ == "__main__":
    typer.run(main)
