"""How often fits of sums of two arrive: the measure of `convergence`, of what ``--model auto`` takes."""

import numpy as np

from .convergence import LONGER, SAME, STARTS, compared, measure_of
from .materials import file
from .processes import worker
from .record import RECONSTRUCTIONS, Record, Target

ARRIVED = 95.0
SUMS = {  # by the model, index, body and diffraction that `auto` finds
    "nylon": ("epd+two-scale", "real", "lambert", "off"),
    "red-phenolic": ("epd+two-scale", "real", "plastic", "off"),
    "alumina-oxide": ("coat(epd)+two-scale", "real", "lambert", "quadrature"),
    "silver-metallic-paint": ("coat(epd)+two-scale", "complex", "lambert", "off"),
    "dark-red-paint": ("epd+two-scale", "real", "lambert", "quadrature"),
    "aluminium": ("epd+two-scale", "complex", "none", "quadrature"),
}


def measure(path, model, index, body, diffraction, starts):
    """Runs of one sum."""
    return measure_of(path, starts, {"diffraction": diffraction}, model=model, index=index, body=body)


def run(folder, out, every):
    """Six materials, or two."""
    record = Record(
        "sums", "Fits of sums that arrive", RECONSTRUCTIONS,
        [f"As in [convergence](convergence.md), of sums of two lobes: {STARTS} runs a material whose first starting "
         "point is drawn from the whole prior of all shared parameters. Arrived: what is minimised is within "
         f"{SAME:.1%} of the lowest of these runs, of the run from the data and of a longer search with fit.starts = "
         f"{LONGER}; within 5 %: hardly worse.",
         "Excess: of the median and of the worst run over the best. From the data, longer search: their excess."],
        {"all": Target("runs of sums that arrive, of all materials", ARRIVED, "%", at_least=True),
         "near": Target("the same within 5 %", ARRIVED, "%", at_least=True)},
        folder=out,
    )  # fmt: skip
    record.resume()
    for material in list(SUMS)[: None if every else 2]:
        if material in record.column("material"):
            continue
        seen = worker(record.section, file(folder, material), *SUMS[material], STARTS)[0]
        model, index, body, diffraction = SUMS[material]
        record.add({
            "material": material, "model": model, "index, body": f"{index} {body}", "diffraction": diffraction,
            **compared(seen, [("within 5 %", 0.05)]),
        }, seen)  # fmt: skip
        record.set("all", np.mean(record.column("arrived %")))
        record.set("near", np.mean(record.column("within 5 %")))
    record.finish()
