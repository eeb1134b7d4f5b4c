"""What ``merlfit demo`` fits: a synthetic material whose parameters are known, and how near the fit comes to them."""

import filecmp
from pathlib import Path

import numpy as np
from rich.table import Table
from scipy.ndimage import gaussian_filter

from ...merl_io.atomic import WriteError, unfinished
from ...merl_io.bands import MERL
from ...merl_io.binary import write
from ...merl_io.source import is_regular
from ...model.two_scale import TwoScale, two_scale
from ..pipeline.synthesis import tabulate
from ..results.schema import Result
from ..settings.config import Config, parse
from ..show.terminal_tables import interval
from ..support.numbers import number, unit
from ..support.tables import table

NAME = "synthetic-red-plastic"  # none of MERL's names: no measurement of that name is in the way
EFFECTS = TwoScale("lambert", index="real")
TRUTH = {
    "beta": 0.06, "p": 0.9, "b": 2.0, "c": 2.2, "sigma_s": 0.04,
    "eta": np.array([1.50, 1.51, 1.52]), "albedo": np.array([0.45, 0.08, 0.06]),
}  # fmt: skip
ERROR = 0.05  # standard deviation of the logarithm of a value
BLUR = 1.0, 4.0, 16.0  # bins along theta_h, theta_d, phi_d over which errors are alike: a measurement's are smooth
ALIKE = 0.8  # correlation of the errors of two channels
ORIGIN = "synthetic"
SAID = (
    f"a red plastic, computed from known parameters of the two-scale model, with smooth errors of {ERROR:.0%} like "
    "those of measurements. The fit is told that it is a plastic, but not its parameters; it should find them again"
)


def settings(seed: int | None = None) -> Config:
    """Settings of the fit: no apparatus took light from a synthetic material; one kind of material is compared."""
    kind = {"index": EFFECTS.index, "body": EFFECTS.body}
    return parse(
        {"seed": seed or 0, "input": {"origin": ORIGIN}, "effects": kind, "acquisition": {"grazing_loss": "off"}},
        "demo",
    )


def values() -> np.ndarray:
    """BRDF with errors on MERL's grid, (3, 90, 90, 180), 1/sr; the same in every call."""
    clean = tabulate(lambda g: two_scale(TRUTH, g, EFFECTS))
    rng = np.random.default_rng(20261123)
    fields = np.array([gaussian_filter(rng.standard_normal(clean.shape[1:]), BLUR, mode="wrap") for _ in range(4)])
    fields /= fields.std((1, 2, 3), keepdims=True)
    return clean * np.exp(ERROR * (np.sqrt(ALIKE) * fields[3] + np.sqrt(1 - ALIKE) * fields[:3]))


def make(folder: Path, force: bool = False) -> Path:
    """The demo's MERL file, made in the folder; one that an earlier demo made there is replaced.

    Args:
        force: replace any other file of its name, too.

    Raises:
        WriteError: another file has its name. merlfit.MerlError: it cannot be written.
    """
    path = folder / f"{NAME}.binary"
    made = unfinished(folder).with_suffix(path.suffix)
    try:
        write(made, values())
        if path.exists() and not force and not (is_regular(path) and filecmp.cmp(path, made, shallow=False)):
            raise WriteError(f"{path}: is there already and was not made by this demo; --force overwrites it")
        made.replace(path)
    finally:
        made.unlink(missing_ok=True)
    return path


def truth_table(result: Result) -> Table:
    """What the parameters are and what the fit found."""
    heads = ("parameter", "true", "fitted", "5 .. 95 %", "unit")
    return table("the demo's material: true and fitted parameters", heads, ("parameter", "unit"), (
        (q.name, number(x), number(q.value), interval(q.quantiles), unit(q.unit))
        for q, x in zip(result.parameters, _true(result), strict=True)
    ))  # fmt: skip


def verdict(result: Result) -> str:
    """How many of the true values lie in their intervals, in a sentence."""
    within = [
        q.quantiles.q05 <= x <= q.quantiles.q95
        for q, x in zip(result.parameters, _true(result), strict=True)
        if q.quantiles
    ]
    if not within:
        return "there are no intervals, because the posterior is not good enough for them"
    return f"{sum(within)} of {len(within)} true values lie in their 90 % intervals; about 9 of 10 should"


def _true(result: Result) -> list[float]:
    """True value of every entry."""
    return [float(np.ravel(TRUTH[q.parameter])[MERL.names.index(q.channel or "R")]) for q in result.parameters]
