"""What each tier of the diffraction lobe costs and errs by: `python -m tests.tier_errors` writes results/tiers.*.

500 synthetic parameter sets drawn between the bounds of the fit (conductors), for each of them directions drawn from
all bins of MERL's grid above the horizon, one of the three wavelengths. The reference is Eq. 27 (`exact`), once with
Q/2 on the facet and once with F in its place on both sides, which takes the frame of Q out of the comparison; and Eq.
33 at order 96, which the cheaper tiers approximate. Time: one BRDF on the whole of MERL's grid, three channels, after
compilation, median of five, in the same run; `exact` is timed on a list of directions and scaled. All bins of all sets
would take `exact` half a year on two cores: the random bins are an unbiased sample of them. With ``--times`` only the
times are taken anew.

`scaled` and `zonal` are no tiers any more (docs/physics.md): their rows stay as they were measured last.
"""

import json
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.merl_io.grid import merl_grid
from merlfit.model.geometry import Geometry
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.reflectance import factor_values, setting, shaped
from merlfit.model.two_scale import TwoScale, two_scale

from tests.bench import tiers

SEED, SETS, DIRECTIONS = 20261121, 500, 128
BRIGHT = 1e-3  # of the highest value of the lobe among the directions of its set
NOTHING = 1e-200  # 1/sr: far from the narrowest lobes nothing is left to compare
PARTS = ("lobe", "bright_lobe", "brdf")
TIERS = {name: effects for name, effects in tiers.TIERS.items() if name not in ("off", "exact")}
REFERENCES = {"Eq. 27": "exact", "Eq. 27, F for Q/2": "exact", "Eq. 33": "quadrature"}
RESULTS = Path(__file__).parents[1] / "results"
STORE = RESULTS / "tiers.json"
SHARES = np.linspace(0, 1, 201)  # of directions, for the plot
WHAT = (
    f"synthetic: {SETS} conductor parameter sets drawn between the bounds of the fit, {DIRECTIONS} directions each "
    "drawn from all bins of MERL's grid above the horizon"
)


def draws():
    """Parameters (S,) each, uniform in their own scale between their bounds, wavelengths (S,), geometry (S, N)."""
    rng = np.random.default_rng(SEED)
    values = {q.name: q.between(jnp.asarray(rng.uniform(size=SETS))) for q in TwoScale().parameters}
    grid = merl_grid()
    bins = np.argwhere(grid.above)
    h, d, p = np.moveaxis(bins[rng.integers(len(bins), size=(SETS, DIRECTIONS))], -1, 0)
    geometry = Geometry.from_half_difference(grid.theta_h[h], grid.theta_d[d], grid.phi_d[p])
    return values, rng.choice(WAVELENGTHS_UM, SETS), geometry


@partial(jax.jit, static_argnums=0)
def evaluate(effects, values, wavelength, geometry):
    """(BRDF, its diffraction lobe) at all directions of all sets, (S, N) each."""

    def one(case):
        v, wavelength, g = case
        v = {name: x[None] if name in ("n", "k") else x for name, x in v.items()}
        s = setting(g, wavelength[None])
        at = factor_values(effects, shaped(effects, v, s), s)
        diffracted = {**at, "distribution": jnp.zeros_like(at["distribution"])}
        return tuple(effects.assemble(each, s).brdf(s)[0] for each in (at, diffracted))

    return jax.lax.map(one, (values, wavelength, geometry))


def summary(error):
    """Median, 95th percentile and worst."""
    return dict(zip(("median", "p95", "worst"), np.quantile(error, [0.5, 0.95, 1.0]).tolist(), strict=True))


def grid_seconds(effects):
    """Median time of a BRDF on the whole grid, three channels."""
    grid = merl_grid()
    g = Geometry.from_half_difference(
        grid.theta_h[:, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :]
    )
    if effects.diffraction == "exact":
        g = jax.tree.map(lambda x: jnp.broadcast_to(x, g.cos_i.shape)[::9, 4::9, 4::18].ravel(), g)
    compiled = jax.jit(lambda v: two_scale(v, g, effects))
    values = {k: jnp.asarray(v) for k, v in tiers.TYPICAL.items()}
    compiled(values).block_until_ready()
    seconds = []
    for _ in range(3 if effects.diffraction == "exact" else 5):
        start = time.perf_counter()
        compiled(values).block_until_ready()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)) * grid.above.size / g.cos_i.size


def measure():
    """Errors of every tier against every reference, with the quantiles that the plot shows."""
    values, wavelength, geometry = draws()
    kept = json.loads(STORE.read_text())
    rows = kept["errors"]
    for reference, tier in REFERENCES.items():
        colour = "fresnel" if "F for" in reference else "rayleigh_rice"
        target = TwoScale().changed(diffraction=tier, colour=colour, order=96)
        whole, lobe = (np.asarray(x) for x in evaluate(target, values, wavelength, geometry))
        seen = lobe > NOTHING
        bright = (lobe > BRIGHT * np.max(lobe, 1, keepdims=True))[seen]
        for name, effects in TIERS.items():
            found, found_lobe = (
                np.asarray(x) for x in evaluate(replace(effects, colour=colour), values, wavelength, geometry)
            )
            in_lobe = np.abs(found_lobe - lobe)[seen] / lobe[seen]
            rows.setdefault(name, {})[reference] = {
                "lobe": summary(in_lobe),
                "bright_lobe": summary(in_lobe[bright]),
                "brdf": summary(np.abs(found - whole)[seen] / whole[seen]),
                "lobe_quantiles": [float(f"{x:.3g}") for x in np.quantile(in_lobe, SHARES)],
            }
            print(reference, name, {part: rows[name][reference][part] for part in PARTS}, flush=True)
        STORE.write_text(json.dumps({**kept, "what": WHAT}, indent=1) + "\n")
    return rows


def main(arguments):
    use_persistent_cache()
    rows = json.loads(STORE.read_text())["errors"] if "--times" in arguments else measure()
    timed = {**TIERS, "exact": TwoScale(diffraction="exact"), "conserving": TwoScale(split="conserving")}
    before = json.loads(STORE.read_text())["grid_seconds"]
    write(rows, {**before, **{name: grid_seconds(effects) for name, effects in timed.items()}})


def write(rows, seconds):
    STORE.write_text(json.dumps({"what": WHAT, "errors": rows, "grid_seconds": seconds}, indent=1) + "\n")
    lines = [
        f"Relative errors of the tiers of the diffraction lobe. Data: {WHAT} (Eq. 27 in all of them would take half a "
        f"year), without those where the lobe is below {NOTHING:g}; it is bright above {BRIGHT:g} of its highest value "
        "among them. Made by `python -m tests.tier_errors`. `scaled` and `zonal` are no tiers any more "
        "([why](../docs/physics.md#the-convolution)): their rows are as they were measured last.", "",
    ]  # fmt: skip
    for reference in REFERENCES:
        lines += [
            f"**Against {reference}**" + (" at order 96" if reference == "Eq. 33" else ""), "",
            "| tier | lobe: median | 95 % | worst | where it is bright: median | 95 % | worst "
            "| whole BRDF: median | 95 % | worst | time on MERL's grid |",
            "|---|" + "---|" * 10,
        ]  # fmt: skip
        for name in rows:
            cells = [rows[name][reference][part][k] for part in PARTS for k in ("median", "p95", "worst")]
            lines.append(f"| {name} | " + " | ".join(f"{x:.2g}" for x in cells) + f" | {seconds[name]:.3g} s |")
        lines.append("")
    lines.append(
        f"`exact` itself would take {seconds['exact']:.0f} s on MERL's grid (measured on a list, scaled); "
        f"quadrature 32 with the split `conserving` takes {seconds['conserving']:.3g} s."
    )
    (RESULTS / "tiers.md").write_text("\n".join(["# Tiers of the diffraction lobe", "", *lines]) + "\n")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(15, 4.8), sharey=True, layout="constrained")
    for axis, reference in zip(axes, REFERENCES, strict=True):
        for name in rows:
            error = np.maximum(rows[name][reference]["lobe_quantiles"], 1e-9)
            axis.plot(error, SHARES, label=f"{name} ({seconds[name]:.2g} s)")
        axis.set(xscale="log", xlim=(1e-7, 1e2), title=f"against {reference}", xlabel="relative error of the lobe")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of directions with less error")
    axes[0].legend(fontsize=8)
    figure.suptitle(f"Tiers of the diffraction lobe (time: whole MERL grid, 3 channels)\n{WHAT}", fontsize=10)
    figure.savefig(RESULTS / "tiers.png", dpi=110)


if __name__ == "__main__":
    main(sys.argv[1:])
