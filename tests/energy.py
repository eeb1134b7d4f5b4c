"""How much light a surface gives back: `python -m tests.energy` writes results/energy.json and results/energy.md.

Directional albedo of the whole material, by a product rule over half vectors of its own: rings cut where the viewer
sets, panels in log tan(theta_h) around the edge of the distribution of normals and where the horizon begins to cut.
Synthetic parameter sets drawn between the bounds of the fit, effects from a list in which every choice of every switch
occurs.
"""

import json
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.model.effects import KINDS
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import TwoScale, two_scale

from tests.support.compiled import drawn

SEED = 20261121
WAVELENGTH_UM = 0.526
INCIDENCES_DEG = (0.5, 20.0, 40.0, 60.0, 75.0, 83.0, 87.0, 89.0)
RADII, AZIMUTHS = 24, 12  # Gauss nodes of a panel (of eleven), of half a ring
SETS = 1000  # parameter sets in all
EXCESS = 1e-3  # that is allowed
BRIGHTEST = {"albedo": np.array([1.0]), "n": np.array([0.02]), "k": np.array([15.0])}  # within the bounds of the fit
EXACT = {"incidences_deg": (20.0, 87.0), "radii": 16, "azimuths": 8}  # two sets and a coarse rule: minutes each
RESULTS = Path(__file__).parents[1] / "results"
STORE = RESULTS / "energy.json"

FULL = TwoScale(split="conserving")


def under(body, **changes):
    """The conserving split over a body with the index that is usual over it; `replace` would keep that of FULL."""
    return replace(FULL, index="usual", body=body, **changes)


EFFECT_SETS = [
    *(replace(FULL, index=index, body=body) for index, body in KINDS),
    *(replace(FULL, index=index, body=body, diffraction="lobe") for index, body in KINDS),
    *(under(body, diffraction="off") for body in ("lambert", "plastic")),
    *(replace(FULL, index=index, body=body, masking="none") for index, body in KINDS),
    under("lambert", masking="height_correlated"),
    *(under(body, fresnel="schlick", colour="fresnel") for body in ("none", "subsurface")),
    *(under(body, renormalised=False) for body in ("none", "plastic")),
    *(under(body, diffraction="exact") for body in ("none", "plastic")),
]


def half_vectors(theta_i, beta, p, largest_B, radii=RADII, azimuths=AZIMUTHS):
    """Geometry and measure cos_o domega_o, (A, R, P), for light at the angles theta_i (A,)."""
    theta_i = np.asarray(theta_i)[:, None]
    edge = np.log(beta) + min(np.log(34 + 3 / p) / (2 * p), 3.0)
    low, high = min(np.log(beta), -np.log1p(largest_B)) - 6, np.log(np.tan(np.radians(89.99)))
    inner = np.log(beta) - 1
    marks = [low, (low + inner) / 2, inner, np.log(beta), edge, edge + 1.5, high - 2.5, high]
    cut = np.log(np.tan((np.pi / 2 - theta_i) / 2))  # where rings begin to cross the viewer's horizon
    marks = np.broadcast_to(np.clip(marks, low, high), (len(theta_i), len(marks)))
    gone = np.log(np.tan((np.pi / 2 + theta_i) / 2))  # where they are below it with all their viewers
    rings = [cut, np.minimum(cut + 0.3, (cut + gone) / 2), np.maximum(gone - 0.3, (cut + gone) / 2), gone]
    marks = np.sort(np.concatenate([marks, *(np.clip(x, low, high) for x in rings)], 1), 1)
    u, w = np.polynomial.legendre.leggauss(radii)
    width = np.diff(marks, axis=1)[..., None]
    y = (marks[:, :-1, None] + width * (u + 1) / 2).reshape(len(theta_i), -1)
    dy = (width * w / 2).reshape(len(theta_i), -1)
    theta_h = np.arctan(np.exp(y))
    sets = np.arccos(np.clip(-1 / np.tan(theta_i) / np.tan(2 * theta_h), -1, 1))
    u, w = np.polynomial.legendre.leggauss(azimuths)
    phi = sets[..., None] * (u + 1) / 2
    theta_h, theta_i = theta_h[..., None], theta_i[..., None]
    cos_d = np.cos(theta_i) * np.cos(theta_h) + np.sin(theta_i) * np.sin(theta_h) * np.cos(phi)
    cos_o = 2 * cos_d * np.cos(theta_h) - np.cos(theta_i)
    measure = np.maximum(cos_o, 0) * 4 * cos_d * np.sin(theta_h) ** 2 * np.cos(theta_h) * dy[..., None]
    measure = measure * 2 * sets[..., None] * w / 2
    cos_i = np.broadcast_to(np.cos(theta_i), cos_d.shape)
    arrays = (theta_h, np.arccos(np.clip(cos_d, 0, 1)), cos_i, cos_o, np.where(cos_o > 0, measure, 0))
    *angles, measure = (jnp.asarray(x) for x in arrays)
    return Geometry(*angles), measure


@partial(jax.jit, static_argnums=0)
def _albedo(effects, values, geometry, measure):
    return jnp.sum(two_scale(values, geometry, effects, (WAVELENGTH_UM,))[0] * measure, (-2, -1))


def albedo(effects, values, incidences_deg=INCIDENCES_DEG, radii=RADII, azimuths=AZIMUTHS):
    """Directional albedo at some incidences, (A,); to 1e-4."""
    B = 2 * values.get("b", 1.0) / WAVELENGTH_UM
    rule = half_vectors(np.radians(incidences_deg), values["beta"], values["p"], B, radii, azimuths)
    return np.asarray(_albedo(effects, values, *rule))


def draw(rng, effects):
    """One parameter set between the bounds (uniform in each parameter's own scale), for one wavelength."""
    return drawn(rng, effects, channels=1)


def sets_of(effects, count, rng):
    """Parameter sets; every other body is white, every other metal a mirror."""
    sets = [draw(rng, effects) for _ in range(count)]
    for values in sets[1::2]:
        values |= {name: x for name, x in BRIGHTEST.items() if name in values}
    return sets


def row_of(effects, sets):
    """Largest directional albedos with either split."""
    rule = EXACT if effects.diffraction == "exact" else {}
    incidences = rule.get("incidences_deg", INCIDENCES_DEG)
    conserving = np.array([albedo(effects, values, **rule) for values in sets])
    printed = np.array([albedo(replace(effects, split="printed"), values, **rule) for values in sets])
    default = asdict(FULL)
    changed = ", ".join(f"{name} {x}" for name, x in asdict(effects).items() if x != default[name])
    by_incidence = printed.max(0).round(4).tolist()
    return {
        "effects": changed or "default, conductor", "sets": len(sets), "conserving_largest": float(conserving.max()),
        "printed_largest": float(printed.max()),
        "printed_above_1.001": float(np.mean(printed.max(1) > 1 + EXCESS)),
        "printed_largest_by_incidence": dict(zip(map(str, incidences), by_incidence, strict=True)),
    }  # fmt: skip


def main(arguments):
    """All rows, or those of the given numbers anew; every row's sets are the same either way."""
    use_persistent_cache()
    rng = np.random.default_rng(SEED)
    rows = json.loads(STORE.read_text())["rows"] if arguments else []
    fast = sum(effects.diffraction != "exact" for effects in EFFECT_SETS)
    for number, effects in enumerate(EFFECT_SETS):
        sets = sets_of(effects, 2 if effects.diffraction == "exact" else SETS // fast + 1, rng)
        if arguments and str(number) not in arguments:
            continue
        rows[number : number + 1] = [row_of(effects, sets)]
        print(number, rows[number], flush=True)
        write(rows)
    over = [r["effects"] for r in rows if r["conserving_largest"] > 1 + EXCESS]
    if over:
        sys.exit(f"the conserving split gives back more than {1 + EXCESS:g}: {'; '.join(over)}")


def write(rows):
    what = (
        f"directional albedo at {WAVELENGTH_UM} um, {sum(r['sets'] for r in rows)} synthetic parameter sets between "
        "the bounds of the fit, every other one with a body of albedo 1 or, without a body, with n = 0.02, k = 15"
    )
    STORE.write_text(json.dumps({"what": what, "rows": rows}, indent=1) + "\n")
    lines = [
        f"{len(rows)} of {len(EFFECT_SETS)} effect sets. Largest {what}. Made by `python -m tests.energy`.", "",
        "| effects | sets | incidences (degrees) | conserving: largest | printed: largest "
        f"| printed: share of sets above {1 + EXCESS:g} |",
        "|---|---|---|---|---|---|",
        *(f"| {r['effects']} | {r['sets']} | {' '.join(f'{float(x):g}' for x in r['printed_largest_by_incidence'])} "
          f"| {r['conserving_largest']:.4f} | {r['printed_largest']:.3f} | {r['printed_above_1.001']:.0%} |"
          for r in rows),
        f"| all | {sum(r['sets'] for r in rows)} | | {max(r['conserving_largest'] for r in rows):.4f} | "
        f"{max(r['printed_largest'] for r in rows):.3f} | "
        f"{np.average([r['printed_above_1.001'] for r in rows], weights=[r['sets'] for r in rows]):.0%} |",
    ]  # fmt: skip
    RESULTS.joinpath("energy.md").write_text("\n".join(["# Energy of all sets of effects", "", *lines]) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
