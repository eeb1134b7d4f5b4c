"""Where zonal harmonics fail: `python -m tests.zonal_failure` writes results/zonal.json. Two minutes.

Random lobes as in the statement to be reproduced (beta 0.003..1, p 0.2..5, c 1.03..5, B = 2u 0.1..200, log-uniform, c
in c - 1): the truncated sum against the quadrature at order 96, first at the paper's order 100, then by order and by
sharpness. Sharpness is told in two ways: order times half width, the angle (rad) at which (S * D) has fallen to half
its largest value; and order / B, of which the width of D is no part.
"""

import json
from functools import partial
from itertools import pairwise
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model import convolution, zonal

RESULTS = Path(__file__).parents[1] / "results"
SEED = 20261121
DRAWS, SETS = 20, 100
ORDERS = (25, 50, 100, 200)
ANGLES = ((np.arange(90) + 0.5) / 90) ** 2 * np.pi / 2  # MERL's half angles
FINE = np.geomspace(1e-4, np.pi / 2, 200)  # on which the half width is found
EDGES = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 12.0, 16.0, np.inf)  # of the bins of sharpness
VISIBLE = 1e-3  # of the peak: relative errors are also given where the lobe is above this


def draw(rng, count):
    """Random (theta_h, B, c, beta, p), one row a lobe."""
    u = rng.uniform(size=(count, 5))
    return np.stack(
        [1.4 * u[:, 0], 0.1 * 2000 ** u[:, 1], 1 + 0.03 * (4 / 0.03) ** u[:, 2], 0.003 * (1 / 0.003) ** u[:, 3],
         0.2 * 25 ** u[:, 4]], 1
    )  # fmt: skip


@partial(jax.jit, static_argnums=(2, 3))
def curves(lobes, angles, order, tier=convolution.convolve):
    """(S * D) of every lobe (rows) at these angles."""
    return jax.lax.map(lambda lobe: tier(angles, *lobe[1:], order), lobes)


def half_width(values):
    """Angle at which values on FINE fall to half of the largest, log-linear between neighbours."""
    below = np.arange(len(FINE)) > np.argmax(values)
    k = int(np.argmax(below & (values < values.max() / 2)))
    if k == 0:
        return np.pi / 2  # never: as wide as the hemisphere
    share = np.log(values[k - 1] / (values.max() / 2)) / np.log(values[k - 1] / values[k])
    return float(FINE[k - 1] * (FINE[k] / FINE[k - 1]) ** share)


def quantiles(x):
    return {"median": float(np.median(x)), "p95": float(np.quantile(x, 0.95)), "max": float(np.max(x))}


def failure(lobes, points, truth, found, peak):
    """Order 100 as the statement has it: the spread over draws of 100 lobes of the two errors it gives."""
    relative = np.abs(points[1] / points[0] - 1)
    absolute = np.abs(points[1] - points[0]) / peak
    whole, by_draw = np.abs(found - truth).max(1) / peak, (-1, SETS)
    return {
        "one angle a lobe": {
            "worst error in units of the peak, by draw": sorted(absolute.reshape(by_draw).max(1).tolist()),
            "95th percentile of the relative error, by draw": sorted(
                np.quantile(relative.reshape(by_draw), 0.95, axis=1).tolist()
            ),
        },
        "MERL's half angles": {
            "worst error in units of the peak, by draw": sorted(whole.reshape(by_draw).max(1).tolist()),
            "95th percentile of the relative error, by draw": sorted(
                np.quantile(np.abs(found / truth - 1).reshape(len(lobes) // SETS, -1), 0.95, axis=1).tolist()
            ),
            "share of negative values": float(np.mean(found < 0)),
            "share of lobes wrong by more than 1 % of the peak": float(np.mean(whole > 0.01)),
        },
    }


def by_sharpness(sharpness, truth, found, peak):
    """Errors in bins of sharpness."""
    rows = []
    for low, high in pairwise(EDGES):
        here = (sharpness >= low) & (sharpness < high)
        if not here.any():
            continue
        t, f, top = truth[here], found[here], peak[here, None]
        rows.append({
            "from": low, "to": high if np.isfinite(high) else None, "lobes": int(here.sum()),
            "error in units of the peak": quantiles((np.abs(f - t) / top).max(1)),
            "relative error where visible": quantiles(np.abs(f / t - 1)[t > VISIBLE * top]),
            "relative error": quantiles(np.abs(f / t - 1)), "share of negative values": float(np.mean(f < 0)),
        })  # fmt: skip
    return rows


def measure(draws=DRAWS, orders=ORDERS):
    lobes = draw(np.random.default_rng(SEED), draws * SETS)
    exact = np.asarray(curves(lobes, FINE, 48))
    widths, peak = np.array([half_width(v) for v in exact]), exact.max(1)
    truth = np.asarray(curves(lobes, ANGLES, 96))
    found = {order: np.asarray(curves(lobes, ANGLES, order, zonal.convolve)) for order in {*orders, 100}}
    each = jax.vmap(lambda x: jnp.stack([convolution.convolve(*x, 96), zonal.convolve(*x, 100)]))
    points = np.asarray(jax.jit(each)(lobes)).T
    return {
        "lobes": len(lobes), "seed": SEED,
        "order 100": failure(lobes, points, truth, found[100], peak),
        "by order times half width": {o: by_sharpness(o * widths, truth, found[o], peak) for o in orders},
        "by order / B": {o: by_sharpness(o / lobes[:, 1], truth, found[o], peak) for o in orders},
    }  # fmt: skip


if __name__ == "__main__":
    result = measure()
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "zonal.json").write_text(json.dumps(result, indent=1) + "\n")
    for kind in ("by order times half width", "by order / B"):
        print(
            kind,
            "lobes; median, 95th percentile and worst error: of the peak; relative where visible; negative",
            sep=", ",
        )
        for order, rows in result[kind].items():
            for row in rows:
                peak, relative = (
                    "{median:8.1e} {p95:8.1e} {max:8.1e}".format(**row[k])
                    for k in ("error in units of the peak", "relative error where visible")
                )
                print(f"{order:4d} {row['from']:5g} {row['lobes']:5d}  {peak}  {relative}"
                      f"  {row['share of negative values']:.2f}")  # fmt: skip
