"""What a floor under the highlight's weight changes: errors of fits with several floors, 0 being Eq. 56 as printed."""

import numpy as np
from merlfit.fitting.config import parse
from merlfit.fitting.run import fit, judge
from merlfit.fitting.weights import weighted_samples
from merlfit.merl_io.binary import read

from .materials import TWELVE, file
from .processes import worker
from .record import RECONSTRUCTIONS, Record

FOUR = ("nickel", "aluminium", "white-marble", "red-plastic")
FLOORS = (0.0, 0.05, 0.1, 0.2)
COLUMNS = ("Eq. 56", "RMSE", "sMAPE")


def measure(path):
    """By floor: body, cost by the printed Eq. 56, RMSE and sMAPE."""
    measurement, found = read(path), []
    printed = weighted_samples(measurement, 0.0)
    for floor in FLOORS:
        config = parse({"fit": {"highlight": floor}, "posterior": {"enabled": False}}, "")
        samples = weighted_samples(measurement, floor)
        fitted = fit(measurement, samples, config)
        cost = judge(fitted.layout, fitted.solution, measurement, printed).solution.cost
        found.append({
            "floor": floor, "body": fitted.effects.body, "Eq. 56": cost, "RMSE": fitted.errors.rmse,
            "sMAPE": fitted.errors.smape, "status": fitted.status.name,
        })  # fmt: skip
    return found


def run(folder, out, every):
    """Twelve materials, or four."""
    record = Record(
        "highlight", "A floor under the highlight's weight", RECONSTRUCTIONS,
        ["`merlfit fit` with `fit.highlight` 0 (HP17 Eq. 56 as printed), 0.05, 0.1 and 0.2 (the default): bins within "
         "the half width of the lobe carry at least that share of each channel's weighted energy. Body chosen by each "
         "fit itself. RMSE in 1/sr and sMAPE over all valid bins with theta < 1.4; Eq. 56: cost with the printed "
         "weights, relative to their energy."],
        folder=out,
    )  # fmt: skip
    for material in TWELVE if every else FOUR:
        for row in worker("highlight", file(folder, material))[0]:
            record.add({"material": material, **row})
    for floor in FLOORS:
        middle = ", ".join(f"{name} {np.median(record.column(name, floor=floor)):.3g}" for name in COLUMNS)
        record.notes.append(f"Medians with a floor of {floor:g}: {middle}.")
    record.finish()
