"""Whether plans keep their word: 30 random scenes, planned, rendered and compared on every pixel.

``python -m tests.scene_bounds`` writes results/scenes.md and .json; synthetic materials of random parameters.
"""

import json
import sys
from pathlib import Path

import jax
import numpy as np
from merlfit.fitting.cost.calibration import truth
from merlfit.fitting.support.compilation import use_persistent_cache
from merlfit.scene import effects
from merlfit.scene.description import Scene
from merlfit.scene.effects import Given, allowed, off_by, plan
from merlfit.scene.render import Film, pictures, stage
from merlfit.scene.surface import drawn

OUT = Path(__file__).parents[1] / "results"
SCENES, SHARE = 30, 0.999


def random_scene(rng):
    """One to three spheres, one or two lamps, a studio or both, a camera around them; and names of materials."""
    spheres = int(rng.integers(1, 4))
    names = [f"m{k}" for k in range(spheres)]
    kind = rng.integers(3)
    lights = {}
    if kind != 1:
        lights["lamp"] = [
            {"towards": (rng.normal(), rng.normal() + 0.5, 1.0), "irradiance": float(rng.uniform(0.05, 4)),
             "radius_deg": float(rng.uniform(0.2, 10))}
            for _ in range(rng.integers(1, 3))
        ]  # fmt: skip
    if kind != 0:
        lights["environment"] = {"kind": "studio", "strength": float(rng.uniform(0.3, 1.5))}
    turn = rng.uniform(-0.8, 0.8)
    scene = Scene.model_validate({
        "camera": {
            "position": (7 * np.sin(turn), rng.uniform(-1, 2), 7 * np.cos(turn)), "field_of_view_deg": 35,
            "width": 192, "height": 192,
        },
        "sphere": [
            {"centre": (2.1 * (k - (spheres - 1) / 2), 0, 0), "radius": float(rng.uniform(0.6, 1)), "material": name}
            for k, name in enumerate(names)
        ],
        "materials": {name: {"model": "two-scale"} for name in names}, "samples": 32,
        "tolerance": {"cielab": float(rng.choice([0.5, 1.0, 2.0]))}, "seed": int(rng.integers(1000)), **lights,
    })  # fmt: skip
    return scene, names


def judged(seed):
    """One scene's row."""
    rng = np.random.default_rng(seed)
    scene, names = random_scene(rng)
    given = []
    for k, name in enumerate(names):
        model, values = truth(seed * 10 + k)
        given.append(Given(name, model.material, values))
    film = Film(scene, stage(scene))
    plans = [plan(scene, film, each, k) for k, each in enumerate(given)]
    whole, same = pictures(
        film, [drawn(each.finest()) for each in given], [[g.of(p.chosen)] for g, p in zip(given, plans, strict=True)]
    )
    away = off_by(whole, same, scene.tolerance).ravel()
    seen = np.unique(np.concatenate([film.pixels(k) for k in range(len(given))]))
    return {
        "seed": seed, "materials": len(names), "tolerance": allowed(scene.tolerance), "pixels": len(seen),
        "planned": max(p.off_by for p in plans), "found": float(np.quantile(away[seen], SHARE)),
        "largest": float(away[seen].max()), "dropped": sum(not row.kept for p in plans for row in p.rows),
        "effects": sum(len(p.rows) for p in plans),
    }  # fmt: skip


def main():
    use_persistent_cache()
    effects.PIXELS = 1536  # fewer than a sphere covers: chance has a part in every plan
    count, rows = int(sys.argv[1]) if len(sys.argv) > 1 else SCENES, []
    for seed in range(count):
        rows.append(judged(seed))
        print(rows[-1], flush=True)
        jax.clear_caches()  # programs of many scenes take more mappings of memory than a process may have
    kept = sum(row["found"] <= row["tolerance"] for row in rows)
    head = (
        "# Plans of random scenes\n\nSynthetic materials of random parameters. `found`: CIELAB difference to all "
        f"effects that {100 * SHARE:g} % of the pixels keep to. Within the tolerance: {kept} of {len(rows)}.\n"
        "`python -m tests.scene_bounds`\n\n"
        "| scene | materials | effects dropped | tolerance | planned | found | largest |\n"
        "|---|---|---|---|---|---|---|\n"
    )
    lines = [
        f"| {r['seed']} | {r['materials']} | {r['dropped']} of {r['effects']} | {r['tolerance']:g} "
        f"| {r['planned']:.3f} | {r['found']:.3f} | {r['largest']:.3f} |\n"
        for r in rows
    ]
    (OUT / "scenes.md").write_text(head + "".join(lines))
    (OUT / "scenes.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{kept} of {len(rows)}")


if __name__ == "__main__":
    main()
