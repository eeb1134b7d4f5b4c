"""Genuine measurements fitted: `make measured`, a quarter of an hour on two idle cores; results/measured/.

Isotropic materials of RGL (Dupuy & Jakob 2018) and sintered PTFE of NIST (Germer 2017), fitted by `merlfit fit` with
its defaults; it goes on where it was stopped, unless the package has changed. Albedos of the files are sums of
f cos theta_o d omega_o by the shares of the samples, at the file's own incidences, and linear in theta_i between them;
`tests.measured_albedo` has Mitsuba's, albedos of the fits are `model/derived.py`'s.
"""

import csv
import io
import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.total_scatter import of_file
from merlfit.fitting.results.storage import read_result
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io import inputs
from merlfit.merl_io.atomic import write_atomically
from merlfit.model.albedo import directional_albedo

from .bench.processes import MERLFIT, ROOT
from .measured_albedo import TABLE as MITSUBA
from .measured_albedo import THETA_I
from .support.reconstructions import DATA

FOLDER = ROOT / "results" / "measured"
ORIGINS = {
    "rgl": "genuine measurement, RGL EPFL material database (Dupuy & Jakob 2018), CC0",
    "nist": "genuine measurement, NIST (Germer 2017, Applied Optics), US government work",
}
NOTES = FOLDER / "notes.txt"  # by hand: what was found of some files
FORMATS = (".bsdf", ".csv")
PACKAGE = ("configs", "fitting", "merl_io", "model", "scene")
NEAR = 0.03  # of the value: as near as albedos are to agree


def commit():
    """The last one that changed the package, with a mark if its files differ from it."""

    def git(*command):
        said = ["git", *command, "--", *PACKAGE]
        return subprocess.run(said, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()

    return git("log", "-1", "--format=%h") + ("-changed" if git("status", "--porcelain") else "")


def files_of(names=()):
    """Files that are fitted, and what each is; those that are named, or all."""
    return {
        path: origin
        for folder, origin in ORIGINS.items()
        for path in sorted((DATA / "measured" / folder).iterdir())
        if path.suffix in FORMATS and (not names or path.stem in names)
    }


def fits(out, names):
    """Fit what has no result there yet: the results by their file, None where it was stopped before."""
    files = files_of(names)
    for origin in ORIGINS.values():
        some = [str(path) for path, own in files.items() if own == origin]
        if some:
            command = [MERLFIT, "fit", *some, "-o", str(out), "--no-posterior", "--resume", "--origin", origin]
            subprocess.run(command, check=False)
    return read(out, files)


def read(out, files):
    """The results of files that have one, None of the others."""
    kept = {path: out / f"{path.stem}.json" for path in files}
    return {path: read_result(there) if there.is_file() else None for path, there in kept.items()}


def kinds():
    """Index and body that the files of the committed table were given, by material."""
    rows = json.loads((FOLDER / "fits.json").read_text())["fits"]
    return {row["material"]: (row["index"], row["body"]) for row in rows}


def of_the_file(path):
    """Albedo (C, A) at THETA_I by the shares."""
    found = inputs.read(path)
    theta = np.unique(found.theta_i)
    return np.stack([np.interp(np.radians(THETA_I), theta, channel) for channel in of_file(found, theta)])


def of_the_fit(result):
    """Albedo (C, A) at THETA_I of the material, without the apparatus."""
    values = {name: jnp.asarray(x) for name, x in result.values().items()}
    angles = jnp.radians(jnp.asarray(THETA_I, float))
    compiled = jax.jit(directional_albedo, static_argnums=(0, 3))
    return np.asarray(compiled(result.model.measured.material, values, angles, tuple(result.model.wavelengths_um)))


def row(path, result, mitsuba):
    """What the tables say of one file."""
    found = {"material": path.stem.removesuffix("_rgb"), "of": path.parent.name, "albedo": {}}
    if path.suffix == ".bsdf":
        there = [mitsuba[path.stem][str(theta_i)]["sampled"] for theta_i in THETA_I]
        found["albedo"] = {"file": of_the_file(path).T.tolist(), "mitsuba": there}
    if result is None:
        return found
    if result.fit.succeeded:
        found["albedo"]["fit"] = of_the_fit(result).T.tolist()
    settings = result.model.settings if result.model else {}
    optical = [q for q in result.parameters if q.parameter in ("eta", "n", "k")]
    return found | {
        "status": result.fit.status, "index": settings.get("index"), "body": settings.get("body"),
        "constants": {q.name: [q.value, q.laplace and [q.laplace.q05, q.laplace.q95]] for q in optical},
        "cost": result.fit.cost, "cost_per_channel": result.fit.cost_per_channel, "smape": result.metrics.smape,
        "lamp": result.metrics.lamp, "environment": result.metrics.environment,
        "seconds": result.seconds["total"], "cautions": list(result.fit.cautions),
    }  # fmt: skip


def far(row):
    """(angle, channel, difference) where the file's albedo and Mitsuba's differ by more than they should."""
    ours, there = (np.array(row["albedo"][name]) for name in ("file", "mitsuba"))
    apart = ours - there
    some = zip(*np.nonzero(np.abs(apart) > NEAR * np.abs(there)), strict=True)
    return [(THETA_I[a], "RGB"[c], apart[a, c]) for a, c in some]


def constants(row):
    """Index in words, with 90 % intervals where the data decide."""
    found = {}
    for name, (value, ends) in row["constants"].items():
        shown = f"{value:.3g}" + (f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else "")
        found.setdefault(name.partition("_")[0], []).append(shown)
    return "; ".join(f"{name} {', '.join(each)}" for name, each in found.items()) or "-"


def triple(values):
    return " / ".join(f"{x:.3f}" for x in values)


def brightest(row):
    """The largest albedo of the fit, with its angle."""
    if "fit" not in row["albedo"]:
        return "-"
    found = np.array(row["albedo"]["fit"])
    angle, _ = np.unravel_index(np.argmax(found), found.shape)
    return f"{found.max():.3f} at {THETA_I[angle]}°" + (" **too bright**" if found.max() > 1 else "")


def fitted(rows):
    return [r for r in rows if "status" in r]


def fitted_table(rows):
    head = (
        "material | of | status | index, body | constants | cost | by channel | sMAPE | lamp, room | largest albedo | s"
    )
    yield f"| {head} |\n|{'---|' * len(head.split(' | '))}"
    for r in fitted(rows):
        seen = "-" if r["lamp"] is None else f"{r['lamp']:.1f}, {r['environment']:.1f}"
        numbers = [f"{r['cost']:.3g}", triple(r["cost_per_channel"]), f"{r['smape']:.3f}", seen]
        numbers = numbers if r["body"] else ["-"] * 4
        cells = [r["material"], r["of"], r["status"], f"{r['index']} {r['body']}", constants(r), *numbers]
        yield f"| {' | '.join([*cells, brightest(r), format(r['seconds'], '.0f')])} |"


def albedo_table(rows):
    head = "material | θ_i | file, by Mitsuba | file, by the shares | fit | apart by more than 3 %"
    yield f"| {head} |\n|{'---|' * len(head.split(' | '))}"
    for r in (r for r in rows if "file" in r["albedo"]):
        apart = far(r)
        for k, theta_i in enumerate(THETA_I):
            each = [triple(r["albedo"][name][k]) if name in r["albedo"] else "-" for name in ("mitsuba", "file", "fit")]
            said = ", ".join(f"{c} {x:+.4f}" for angle, c, x in apart if angle == theta_i)
            yield f"| {r['material']} | {theta_i}° | {' | '.join(each)} | {said} |"


PAGE = """# Genuine measurements

`make measured`: {count} of {every} files fitted with the defaults of commit {at}, without a posterior. {ends}

**Genuine measurements**, not reconstructions and not synthetic: isotropic materials of the RGL EPFL material database
(Dupuy & Jakob 2018, doi:10.1145/3272127.3275059; RGB files, CC0), and sintered PTFE of NIST (Germer 2017, Applied
Optics; 351, 532, 633 and 1064 nm; US government work). Seconds are of a machine of two cores that had other work.
Behind a constant is its 90 % interval by the Laplace approximation, if it is at no bound and the data decide. Cost is
relative to the weighted energy of the measurement. Lamp and room: CIELAB distance of the lit pixels of spheres, of the
file as interpolated between its samples and of the fit, where the samples cover what a sphere shows. Largest albedo is
that of the fitted material at 10, 28, 45, 60 and 75 degrees.

[Spheres](spheres.md) of files and fits, beside Mitsuba's; posteriors of [halves of the directions](halves.md).

{fits}

{notes}
## Albedos

Directional albedo, R / G / B: of the file by importance sampling of Mitsuba's plugin `measured`, which clamps nothing
(standard errors below 0.3 %, a quadrature of its `eval` agrees: [all numbers](mitsuba_albedo.json)); of the file by the
shares of merlfit's samples; of the fit. Between the file's incidences Mitsuba interpolates values and warp, the second
column albedos.

At 75 degrees the shares see up to 5 % more. The file's last incidence, 78 to 85 degrees, holds zeros below the horizon,
where no node was measured (at the other incidences the first of these nodes are filled in). Mitsuba interpolates
towards the zeros between the last measured nodes and the horizon; the shares let the measured nodes stand for all. With
the zeros counted, albedos at the files' last incidences agree to 1e-3. Other differences are of channels near zero,
whose values of both signs cancel.

{albedos}
"""


def page(rows, at):
    """README.md of the folder."""
    statuses = [r["status"] for r in fitted(rows)]
    ends = "".join(f"{statuses.count(s)} {s}. " for s in sorted(set(statuses))).strip()
    fits, albedos = "\n".join(fitted_table(rows)), "\n".join(albedo_table(rows))
    notes = NOTES.read_text()
    return PAGE.format(count=len(statuses), every=len(rows), at=at, ends=ends, fits=fits, notes=notes, albedos=albedos)


def table(rows):
    """The first table as CSV."""
    text = io.StringIO()
    names = ["material", "of", "status", "index", "body", "cost", "smape", "seconds"]
    to = csv.DictWriter(text, [*names, "constants", "largest_albedo"], extrasaction="ignore", lineterminator="\n")
    to.writeheader()
    for r in fitted(rows):
        largest = np.max(r["albedo"]["fit"]) if "fit" in r["albedo"] else ""
        to.writerow(r | {"constants": constants(r), "largest_albedo": largest})
    return text.getvalue()


def main(names=()):
    """Fit, then write the tables; of the files that are named, into out/ only."""
    at = commit()
    out = ROOT / "out" / "measured" / at
    write(fits(out, names), at, out / "tables" if names else FOLDER)


def write(results, at, folder):
    """The tables of results by their file."""
    use_persistent_cache()
    mitsuba = json.loads(MITSUBA.read_text())
    rows = [row(path, result, mitsuba) for path, result in results.items()]
    folder.mkdir(parents=True, exist_ok=True)
    kept = json.dumps({"commit": at, "fits": rows}, indent=1) + "\n"
    for name, text in (("README.md", page(rows, at)), ("fits.csv", table(rows)), ("fits.json", kept)):
        write_atomically(folder / name, lambda target, text=text: target.write(text.encode()))
    print(folder)


if __name__ == "__main__":
    main(sys.argv[1:])
