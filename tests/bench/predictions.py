"""Whether what one half of a measurement predicts holds what the other half says: albedo, peak, width of the lobe."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.noise import STEP
from merlfit.fitting.fit.outcome import DECIDED, NINETY
from merlfit.fitting.fit.total_scatter import USUAL
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.run import fit
from merlfit.fitting.settings.config import load
from merlfit.fitting.support.compilation import make_room, use_persistent_cache
from merlfit.fitting.support.threads import CORES
from merlfit.merl_io import inputs
from merlfit.merl_io.binary import read
from merlfit.model.geometry import Geometry
from merlfit.model.reflectance import evaluate

from ..measured import files_of
from ..measured_halves import SPLITS, parity
from ..measured_halves import half_of as half_of_scattered
from .halves import HALVES, PAIRS, half_of
from .materials import TWELVE, every, file
from .record import RECONSTRUCTIONS, Record, Target

GENUINE = "genuine measurements: RGL EPFL material database (Dupuy & Jakob 2018), CC0"
STEEP = np.radians(60.0)  # the second incidence of the peak
ANGLES = np.geomspace(1e-4, 1.2, 300)  # theta_h (rad) by which the width is found
KINDS = ("albedo", "peak", "width")
DRAWN = 2000  # sets of files


def profile(fitted, points):
    """BRDF at theta_d = 0 over `ANGLES`, and at the mirror direction of 60 degrees, (n, C, H + 1), of points (n, F)."""
    layout, theta_d = fitted.layout, np.append(np.full(len(ANGLES), 1e-3), STEEP)
    where = Geometry.from_half_difference(np.append(ANGLES, ANGLES[0]), theta_d, np.full(len(theta_d), np.pi / 2))
    wavelengths = layout.bands.wavelengths_um
    compute = jax.jit(jax.vmap(lambda v: evaluate(layout.material, v, where, wavelengths)))
    return np.asarray(compute({name: jnp.asarray(x) for name, x in layout.values(points).items()}))


def logarithms(fitted, points):
    """Of what is predicted, (n, Q): albedos at three incidences, peaks at two, and the lobe's half width, per channel.

    NaN where a lobe does not stand out of the body by as much as that.
    """
    curves = profile(fitted, points)
    peak, steep, rest = curves[..., 0], curves[..., -1], curves[..., :-1]
    below = rest < peak[..., None] / 2
    k = np.maximum(below.argmax(-1), 1)
    y, x = np.log(rest / peak[..., None] * 2), np.log(ANGLES)
    y0, y1 = (np.take_along_axis(y, place[..., None], -1)[..., 0] for place in (k - 1, k))
    width = np.where(below.any(-1), x[k - 1] + (x[k] - x[k - 1]) * y0 / (y0 - y1), np.nan)
    albedo = np.log(fitted.scatter_at(points, USUAL)).reshape(len(points), -1)
    return np.concatenate([albedo, np.log(peak), np.log(steep), width], -1)


def kinds_of(channels):
    """Which of `KINDS` each is."""
    return np.repeat(KINDS, [channels * len(USUAL), 2 * channels, channels])


def predicted(fitted):
    """Logarithms of what a fit predicts, (Q,), and what their 90 % intervals reach to either side; NaN: undecided."""
    z = np.asarray(fitted.solution.z)
    at, *moved = logarithms(fitted, np.concatenate([z[None], z + STEP * np.eye(len(z))]))
    rates = (np.stack(moved, -1) - at[:, None]) / STEP
    error = np.sqrt(np.einsum("qp,pr,qr->q", rates, fitted.noise.covariance, rates))
    return at, np.where(error < DECIDED * np.linalg.norm(rates, axis=-1), NINETY * error, np.nan)


def held(one, other):
    """Of each kind: how many intervals of one half hold the other's value, and how many there are."""
    inside, there = [], []
    for (at, reach), (value, _) in ((one, other), (other, one)):
        there.append(np.isfinite(at + reach + value))
        inside.append(there[-1] & (np.abs(at - value) <= reach))
    which = kinds_of(len(one[0]) // (len(USUAL) + 3))
    return tuple({kind: int(np.sum(np.array(x)[:, which == kind])) for kind in KINDS} for x in (inside, there))


def halves_of(path):
    """Measurement, samples and settings of either half, by split."""
    if path.suffix == ".binary":
        measurement, config = read(path), load(posterior=False)
        whole = weighted_samples(measurement, config.exponents[0], config.fit.theta_max)
        return {f"{a}, {b}": [(measurement, half_of(whole, HALVES[name]), config) for name in (a, b)] for a, b in PAIRS}
    measurement, config, found = inputs.read(path), load(posterior=False).for_scattered, {}
    for split, words in SPLITS.items():
        odd = parity(measurement, split)
        parts = [half_of_scattered(measurement, kept) for kept in (~odd, odd)]
        found[words] = [(m, weighted_samples(m, config.exponents[0], config.fit.theta_max), config) for m in parts]
    return found


def measure(path):
    """A row for each split of a file."""
    rows = []
    for split, parts in halves_of(path).items():
        fits = [fit(*part) for part in parts]
        if not all(f is not None and f.status.succeeded for f in fits):
            print(f"{path.stem}, {split}: a half has no fit", flush=True)
            continue
        row = {
            "material": path.stem.removesuffix("_rgb"), "data": "MERL" if path.suffix == ".binary" else "RGL",
            "halves": split, "N": min(f.count for f in fits),
            "kinds": ", ".join(dict.fromkeys(f.material.variant for f in fits)),
        }  # fmt: skip
        inside, there = held(*map(predicted, fits))
        rows.append(row | {kind: f"{inside[kind]} of {there[kind]}" for kind in KINDS})
    make_room()
    return rows


def counted(rows, *kinds):
    """Intervals of these kinds that hold the other half's value, and all of them, by row, (n, 2)."""
    return np.array([np.sum([[*map(int, row[kind].split(" of "))] for kind in kinds], 0) for row in rows])


def share(rows, *kinds):
    """Of all intervals of these kinds, those that hold the other half's value (%), and its standard error by files."""
    counts = counted(rows, *kinds)
    draws = np.random.default_rng(0).integers(len(rows), size=(DRAWN, len(rows)))
    found, again = counts.sum(0), counts[draws].sum(1)
    return 100 * found[0] / max(1, found[1]), float(np.std(100 * again[:, 0] / np.maximum(1, again[:, 1])))


def run(folder, out, every_one):
    """All 100 reconstructions, or twelve, and all genuine files of RGL."""
    splits = [f"{a}, {b}" for a, b in PAIRS]
    record = Record(
        "predictions", "What one half of a measurement predicts of the other", f"{RECONSTRUCTIONS}; {GENUINE}",
        ["Every file is fitted twice, as `merlfit fit --no-posterior` does it, to one half of it each. Predicted are, "
         "per channel, the directional albedo at 0, 30 and 60 degrees, the BRDF in the mirror direction at normal "
         "incidence and at 60 degrees, and the angle theta_h at which it has fallen to half at normal incidence; all "
         "of the material, without the loss of the apparatus. Counted are 90 % intervals (normal approximation, of "
         "logarithms) of one half that hold the value of the other half, from both sides. Intervals that the prior "
         "alone would make nearly as narrow, and widths of lobes that do not stand out of the body, are left out.",
         "What is asked is that they hold it in 85 to 95 %. Were model error the same in both halves, all would; were "
         "it independent, as in halves of unlike directions, 75 % would: the other half errs as well.",
         "Reconstructions (MERL): halves of the bins by phi_d, even and odd, and by theta_d, below and above 45 "
         "degrees. Genuine files (RGL): of what an isotropic model can tell apart, every second direction, or every "
         "second incidence (as `results/measured/halves.md`)."],
        {f"{split} {side}": Target(f"intervals that hold the other half's value, {split}", limit, "%", at_least=least)
         for split in [*splits, *SPLITS.values()] for side, limit, least in (("low", 85, True), ("high", 95, False))},
        folder=out,
    )  # fmt: skip
    record.resume()
    done = set(record.column("material"))
    names = [name for name in (every() if every_one else TWELVE) if name not in done]
    genuine = [path for path in files_of() if path.parent.name == "rgl" and path.stem.removesuffix("_rgb") not in done]
    with ProcessPoolExecutor(CORES, get_context("spawn"), use_persistent_cache) as pool:
        for rows in pool.map(measure, [*genuine, *(Path(file(folder, name)).resolve() for name in names)]):
            for row in rows:
                record.add(row)
    for split in [*splits, *SPLITS.values()]:
        rows = [row for row in record.rows if row["halves"] == split]
        for side in ("low", "high"):
            record.set(f"{split} {side}", share(rows, *KINDS)[0])
        found = [f"{kind} {{:.0f}} ± {{:.0f}} %".format(*share(rows, kind)) for kind in KINDS]
        record.notes.append(
            f"{split[:1].upper()}{split[1:]}, {len(rows)} files: {', '.join(found)} hold it (± by resampling of files)."
        )
    record.finish()
