"""Posteriors of two halves of a genuine measurement: `python -m tests.measured_halves`, hours; results/measured/.

It goes on where it was stopped. RGL's isotropic files hold the value of a direction twice, on either side of the plane
of incidence; with these in different halves both would be fits of the same numbers. So what an isotropic model cannot
tell apart stays together (`scattered.alike`), and of the directions that then remain, in order of theta_i, theta_o and
azimuth, every other one is in a half. Model error, which neighbours share, is the same in both; that of halves by
incidence is not.
"""

from dataclasses import replace

import numpy as np
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io import inputs
from merlfit.merl_io.scattered import alike

from .bench.halves import apart, intervals
from .bench.record import Record, Target
from .measured import FOLDER, files_of, kinds

TEN = (
    "ilm_l3_37_matte_rgb", "paper_white_rgb", "leaf_maple_rgb", "vch_golden_yellow_rgb", "vch_silk_blue_rgb",
    "satin_purple_rgb", "irid_flake_paint2_rgb", "cardboard_rgb", "colodur_azure_4e_rgb", "ptfe_regular",
)  # fmt: skip
NEAR = 3  # decimals, in radians: incidences no further apart are one
SPLITS = {"directions": "even and odd directions", "incidences": "even and odd incidences"}


def parity(measurement, split):
    """Which of two halves a sample is in: False or True, (N,)."""
    m = measurement
    incidence = np.unique(np.round(m.theta_i, NEAR), return_inverse=True)[1]
    return (alike(m.theta_i, m.theta_o, m.phi) if split == "directions" else incidence) % 2 == 1


def half_of(measurement, kept):
    """Some of the samples."""
    chosen = {name: getattr(measurement, name)[..., kept] for name in ("theta_i", "theta_o", "phi", "values", "share")}
    return replace(measurement, **chosen, solid_angle=None, between=None)


def halves(path, split, kind):
    """Intervals of both halves, with the index and body that the whole file was given."""
    index, body = kind
    config = load(index=index, body=body).for_scattered
    measurement = inputs.read(path)
    odd, found = parity(measurement, split), {}
    for name, kept in (("even", ~odd), ("odd", odd)):
        half = half_of(measurement, kept)
        samples = weighted_samples(half, config.exponents[0], config.fit.theta_max)
        found[name] = intervals(half, samples, config)
    return found


def row(path, split, kind, found):
    """What the table says of one file."""
    disjoint, parameters = apart(found["even"], found["odd"]), found["even"]["parameters"]
    return {
        "material": path.stem.removesuffix("_rgb"), "of": path.parent.name, "index, body": " ".join(kind),
        "halves": split, "parameters": len(parameters),
        "overlap": None if disjoint is None else len(parameters) - len(disjoint),
        "apart": "no intervals" if disjoint is None else ", ".join(disjoint), "N even": found["even"]["count"],
        "N odd": found["odd"]["count"],
    }  # fmt: skip


def share(rows):
    """Of all parameters that have intervals from both halves, those whose intervals overlap (%)."""
    some = [r for r in rows if r["overlap"] is not None]
    return 100 * sum(r["overlap"] for r in some) / sum(r["parameters"] for r in some) if some else float("nan")


def main():
    """Ten files, split in two ways."""
    use_persistent_cache()
    record = Record(
        "halves", "Posteriors of two halves of a measurement",
        "genuine measurements: RGL EPFL material database (Dupuy & Jakob 2018), CC0, and NIST (Germer 2017), US "
        "government work",
        ["Each half is fitted and sampled by itself, with the index and the body that `merlfit fit` chose for the "
         "whole file. A parameter of every channel counts; two intervals of 90 % overlap if they have a point in "
         "common, which of exact and independent ones 98 % do. N: effective samples of the residuals.",
         "RGL's isotropic files hold every direction's value twice, on either side of the plane of incidence, so these "
         "stay together, as all azimuths do at normal incidence. Halves by directions: of what remains every second "
         "one, in order of theta_i, theta_o and azimuth. What neighbours have in common, model error above all, both "
         "halves see, so that these say little more than that noise and sampler do no harm. Halves by incidences: "
         "every second theta_i of the file, so that each half has to say what the light from between does."],
        {split: Target(f"intervals that overlap, {words}", 80, "%", at_least=True) for split, words in SPLITS.items()},
        folder=FOLDER, command="python -m tests.measured_halves",
    )  # fmt: skip
    record.resume()
    paths, chosen = {path.stem: path for path in files_of(TEN)}, kinds()
    done = {(r["material"], r["halves"]) for r in record.rows}
    for split in SPLITS:
        for name in TEN:
            path, kind = paths[name], chosen[name.removesuffix("_rgb")]
            if (name.removesuffix("_rgb"), split) not in done:
                found = halves(path, split, kind)
                record.add(row(path, split, kind, found), found)
            record.set(split, share([r for r in record.rows if r["halves"] == split]))
    record.finish()


if __name__ == "__main__":
    main()
