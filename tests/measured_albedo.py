"""Directional albedos of RGL's files as Mitsuba has them: `python -m tests.measured_albedo`, minutes on one core.

Of genuine measurements (Dupuy & Jakob 2018, CC0), by two ways through Mitsuba's plugin `measured`, which returns the
file's values as they are, negative ones too: means of the weights of its importance sampling, over scrambled Sobol'
points, with a standard error; and a midpoint rule over its `eval` that knows nothing of its density. They differ where
the density vanishes and the values do not. At theta_i between two of the file's, Mitsuba interpolates; the table has
the file's own, too, at which it does not.
"""

import json
import sys
from pathlib import Path

import numpy as np
from merlfit.merl_io.atomic import write_atomically
from merlfit.merl_io.tensor import tensors
from scipy.stats import qmc

from .support.reconstructions import DATA

TABLE = Path(__file__).parents[1] / "results" / "measured" / "mitsuba_albedo.json"
THETA_I = (10, 28, 45, 60, 75)  # degrees
SCRAMBLES, POINTS = 8, 12  # independent sets, of 2^12 points each
HALVES = (384, 256)  # of the midpoint rule: along sqrt(theta_m), along phi_m


def light(mitsuba, theta_i):
    """A point of the surface lit from theta_i (degrees), azimuth 0."""
    at = mitsuba.SurfaceInteraction3f()
    theta = np.radians(theta_i)
    at.wi = mitsuba.Vector3f(float(np.sin(theta)), 0.0, float(np.cos(theta)))
    return at


def sampled(mitsuba, bsdf, theta_i):
    """Albedo by importance sampling, and its standard error."""
    at, context, means = light(mitsuba, theta_i), mitsuba.BSDFContext(), []
    for seed in range(SCRAMBLES):
        points = qmc.Sobol(2, rng=seed).random_base2(POINTS).tolist()
        means.append(np.mean([bsdf.sample(context, at, 0.5, point)[1] for point in points], axis=0))
    return np.mean(means, axis=0), np.std(means, axis=0, ddof=1) / np.sqrt(SCRAMBLES)


def integrated(mitsuba, bsdf, theta_i):
    """Albedo by a midpoint rule, and what it would be with negative values as 0.

    Over facets' normals m: d omega_o = 4 cos theta_d sin theta_m d theta_m d phi_m, and theta_m = u^2 pi / 2.
    """
    at, context = light(mitsuba, theta_i), mitsuba.BSDFContext()
    u, turn = ((np.arange(n) + 0.5) / n for n in HALVES)
    theta, phi = u[:, None] ** 2 * np.pi / 2, 2 * np.pi * turn
    m = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    i = np.array(at.wi, dtype=float)
    cosine = m @ i
    o = 2 * cosine[..., None] * m - i
    area = 4 * cosine * np.sin(theta) * (np.pi * u[:, None]) * (2 * np.pi) / np.prod(HALVES)
    seen = (cosine > 0) & (o[..., 2] > 0)
    values = np.array([bsdf.eval(context, at, mitsuba.Vector3f(*each)) for each in o[seen].tolist()])
    return area[seen] @ values, area[seen] @ np.maximum(values, 0.0)


def own(path):
    """Incidences of a file (degrees) that light comes from."""
    theta = np.degrees(tensors(path, path.read_bytes()).array("theta_i", "float32", 1).astype(float))
    return [round(float(x), 3) for x in theta if x < 89.9]


def albedos(mitsuba, path):
    """Of one file, by the angle."""
    bsdf, found = mitsuba.load_dict({"type": "measured", "filename": str(path)}), {}
    for theta_i in sorted({*THETA_I, *own(path)}):
        mean, error = sampled(mitsuba, bsdf, theta_i)
        quadrature, clamped = integrated(mitsuba, bsdf, theta_i)
        row = {"sampled": mean, "error": error, "quadrature": quadrature, "clamped": clamped}
        found[str(theta_i)] = {name: [round(float(x), 6) for x in value] for name, value in row.items()}
    return found


def main(names=()):
    """Measure the files that are named, or all."""
    import mitsuba  # slow to import, and not everywhere

    mitsuba.set_variant("scalar_rgb")
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(TABLE.read_text()) if TABLE.is_file() else {}
    for path in sorted((DATA / "measured" / "rgl").glob("*.bsdf")):
        if not names or path.stem in names:
            rows[path.stem] = albedos(mitsuba, path)
            text = json.dumps(rows, indent=1, sort_keys=True) + "\n"
            write_atomically(TABLE, lambda target, text=text: target.write(text.encode()))
            print(path.stem, rows[path.stem], flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
