"""Every preset that a fit takes, beside the default: seconds, what a new process waits for, and what comes out."""

import tempfile
import time
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load
from merlfit.model.effects import PRESETS

from .materials import file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target

MATERIALS = ("nickel", "gray-plastic", "red-fabric")
REPEATS = 2
FITTED = [name for name in PRESETS if name != "reference"]  # which no fit takes


def measure(preset, *paths):
    """Fits of some files, the first of all once more to compile; seconds, errors and kind of each."""
    config, found = load(preset=preset, posterior=False), []
    with tempfile.TemporaryDirectory() as out:
        for path in (paths[0], *(p for p in paths for _ in range(REPEATS))):
            start = time.perf_counter()
            result = fit_file(path, Path(out), config)
            found.append({
                "seconds": time.perf_counter() - start, "kind": result.model.material.variant,
                "cost": result.fit.cost, "rmse": result.metrics.rmse, "smape": result.metrics.smape,
                "status": result.fit.status,
            })  # fmt: skip
    return found


def run(folder, out, every):
    """The default first, to which the others are compared."""
    record = Record(
        "presets", "Presets", f"{RECONSTRUCTIONS}: {', '.join(MATERIALS)}",
        [f"`merlfit fit FILE --preset PRESET --no-posterior`, seconds: median of {REPEATS} fits of each file in one "
         "process, programs compiled; first: the first fit of that process, its programs in the cache or not as they "
         "were. Times the default: median over the files of the ratio to hp17, the same run of this section."],
        {"conserving": Target("conserving, times as long as the default", 5, "times"),
         "fast": Target("fast, times as long as the default", 1, "times")},
        folder=out,
    )  # fmt: skip
    paths, default = [file(folder, material) for material in MATERIALS], None
    for preset in FITTED:
        found = worker("presets", preset, *paths)[0]
        seconds = np.median(np.reshape([f["seconds"] for f in found[1:]], (len(paths), REPEATS)), 1)
        default = seconds if default is None else default
        ratio = float(np.median(seconds / default))
        for material, each, again in zip(MATERIALS, found[1::REPEATS], seconds.tolist(), strict=True):
            record.add({
                "preset": preset, "material": material, "seconds": again, "first": found[0]["seconds"],
                "times the default": ratio, **{k: each[k] for k in ("kind", "cost", "rmse", "smape", "status")},
            }, found)  # fmt: skip
        if preset in record.targets:
            record.set(preset, ratio)
    record.finish()
