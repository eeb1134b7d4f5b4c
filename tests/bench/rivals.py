"""A fit of every registered model: seconds once compiled, and what comes out."""

import tempfile
import time
from pathlib import Path

import numpy as np
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale

from .materials import TWELVE, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target


def measure(model, *paths):
    """Fits of some files, the first of all once more to compile; seconds by the clock and of processors."""
    config, found = load(model=model, posterior=False), []
    with tempfile.TemporaryDirectory() as out:
        for path in (paths[0], *paths):
            start, cpu = time.perf_counter(), time.process_time()
            result = fit_file(path, Path(out), config)
            found.append({
                "seconds": time.perf_counter() - start, "cpu": time.process_time() - cpu,
                "rmse": result.metrics.rmse, "status": result.fit.status,
            })  # fmt: skip
    return found


def run(folder, out, every):
    """All models on twelve materials."""
    record = Record(
        "rivals", "Fits of every model", f"{RECONSTRUCTIONS}: 12 materials",
        ["`merlfit fit FILE --model MODEL --no-posterior`, defaults otherwise: all bins, from file to JSON, 12 files "
         "one after the other in one process, programs compiled; first: the first fit of that process, its programs in "
         "the cache or not as they were. RMSE: HP17 Table 2, median over the 12."],
        {"rivals": Target("slowest rival's fit, median of the materials", 2, "s"),
         "met": Target("rivals whose fit takes at most 2 s in the median", 100, "%", at_least=True)},
        folder=out,
    )  # fmt: skip
    record.resume()
    paths = [file(folder, material) for material in TWELVE]
    for model in models():
        if model in record.column("model"):
            continue
        first, *found = worker("rivals", model, *paths)[0]
        seconds = [f["seconds"] for f in found]
        record.add({
            "model": model, "seconds": float(np.median(seconds)), "longest": max(seconds),
            "processor seconds": float(np.median([f["cpu"] for f in found])), "first": first["seconds"],
            "RMSE": float(np.median([f["rmse"] for f in found])),
            "failed": sum(f["status"] == "FAILED" for f in found),
        }, found)  # fmt: skip
        rivals = [r["seconds"] for r in record.rows if r["model"] != TwoScale.name]
        if rivals:
            record.set("rivals", max(rivals))
            record.set("met", 100 * float(np.mean(np.array(rivals) <= record.targets["rivals"].limit)))
        record.write()
    record.finish()
