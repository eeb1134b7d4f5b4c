"""How much light the printed energy split gives back: `python -m tests.energy` writes results/energy.json.

Directional albedo of the whole surface at F = Q/2 = 1 (a perfect reflector), Smith masking: the light that the mirror
term and the diffraction lobe reflect together, by a product rule over half vectors, dense at the mirror direction,
refined until two rules agree. Cases that never settle are left out and counted.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model.effects import Effects
from merlfit.model.fresnel import fresnel
from merlfit.model.geometry import Geometry
from merlfit.model.two_scale import assemble, factors, setting, shaped

SETS, ANGLES_DEG = 60, (0, 40, 70, 86)
RULES = ((48, 32), (64, 48), (96, 96), (128, 192), (192, 384))  # radial and azimuthal nodes
SETTLED = 5e-3  # largest difference of two successive rules


def viewers(theta_i, width, n_radial, n_azimuth):
    """Half vectors around the normal in log-spaced rings, as viewer directions with their measure domega_o."""
    nodes, weights = np.polynomial.legendre.leggauss(n_radial)
    low, high = np.log(width * 1e-3), np.log(1e3)
    y, wy = (low + high) / 2 + (high - low) / 2 * nodes, (high - low) / 2 * weights
    theta_h = np.arctan(np.exp(y))[:, None]
    phi = (np.arange(n_azimuth) + 0.5) / n_azimuth * np.pi
    i = np.array([-np.sin(theta_i), 0, np.cos(theta_i)])
    h = np.stack(np.broadcast_arrays(np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h)), -1)
    cos_d = h @ i
    o = 2 * cos_d[..., None] * h - i
    measure = 4 * cos_d * np.sin(theta_h) ** 2 * np.cos(theta_h) * wy[:, None] * 2 * np.pi / n_azimuth
    seen = (cos_d > 0) & (o[..., 2] > 0)
    return np.broadcast_to(i, o.shape)[seen], o[seen], measure[seen]


@jax.jit
def white(values, i, o):
    """BRDF of the first channel's wavelength at F = Q/2 = 1."""
    effects = Effects()
    s = setting(Geometry.from_vectors(i, o), effects, (0.526,))
    v = shaped(values, s)
    at = {name: f.evaluate(v, s) for name, f in factors(effects).items()}
    at["mirror"] = at["mirror"] / fresnel(s.geometry.cos_d, v["n"], v["k"])
    at["hue"] = jnp.ones_like(at["hue"])
    return assemble(at, s)[0]


def albedo(values, theta_i, n_radial, n_azimuth):
    i, o, measure = viewers(theta_i, min(values["beta"], 0.05), n_radial, n_azimuth)
    size = 1 << int(np.ceil(np.log2(len(i))))  # few shapes, few compilations
    pad = size - len(i)
    i, o = (np.concatenate([x, np.repeat(x[:1], pad, 0)]) for x in (i, o))
    brdf = np.asarray(white(values, i, o))[: size - pad]
    return float(np.sum(brdf * o[: size - pad, 2] * measure))


def settle(values, theta_i):
    """Albedo by the first rule that agrees with the one before; None if none does."""
    coarse = albedo(values, theta_i, *RULES[0])
    for rule in RULES[1:]:
        fine = albedo(values, theta_i, *rule)
        if abs(fine - coarse) < SETTLED:
            return fine
        coarse = fine
    return None


def main():
    rng = np.random.default_rng(20261121)
    rows, unsettled = [], 0
    for _ in range(SETS):
        values = {
            "beta": 10 ** rng.uniform(-2, 0), "p": np.exp(rng.uniform(np.log(0.3), np.log(4))),
            "b": 10 ** rng.uniform(-0.7, 1.5), "c": 1 + np.exp(rng.uniform(np.log(0.1), np.log(3))),
            "sigma_s": 10 ** rng.uniform(-2, -0.7), "n": np.array([0.5]), "k": np.array([3.0]),
        }  # fmt: skip
        for degrees in ANGLES_DEG:
            fine = settle(values, np.radians(degrees))
            if fine is None:
                unsettled += 1
            else:
                rows.append((fine, degrees))
    found = np.array([r[0] for r in rows])
    summary = {
        "what": "directional albedo at F = Q/2 = 1, printed energy split (HP17 Eq. 25), synthetic parameter sets",
        "cases": len(rows), "unsettled_quadratures": unsettled, "largest": round(float(found.max()), 4),
        "median": round(float(np.median(found)), 4), "share_above_1.01": round(float(np.mean(found > 1.01)), 4),
        "largest_by_incidence_deg": {
            str(d): round(max(r[0] for r in rows if r[1] == d), 4) for d in ANGLES_DEG if any(r[1] == d for r in rows)
        },
    }  # fmt: skip
    print(json.dumps(summary, indent=2))
    Path("results").mkdir(exist_ok=True)
    Path("results/energy.json").write_text(json.dumps(summary, indent=2) + "\n")


if __name__ == "__main__":
    main()
