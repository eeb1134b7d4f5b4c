"""What settings choose among, and the parts that compute name in their types: no jax."""

from typing import Any, Literal

Precision = Literal["float64", "float32"]
"""In which a model is evaluated; sums are always taken in float64."""
Backend = Literal["trust-region", "scipy", "jaxopt"]
"""Solvers; others than our trust region are for cross-checks."""
THETA_MAX = 1.4  # rad: HP15 Eq. 31 and HP17 Table 2 leave out directions closer to the horizon
EXPONENT = 1.4  # exponent of the compressive weight, HP17 after Eq. 58
Exponent = float | Literal["log"]
Weights = Literal["compressive", "log", "none", "adaptive"]
WEIGHT_SCHEDULES: dict[Weights, tuple[Exponent, ...]] = {
    "compressive": (EXPONENT,), "log": (EXPONENT, "log"), "none": (0.0,),
    "adaptive": (EXPONENT, 1.0, 0.7, 0.4, 0.0),
}  # fmt: skip
"""Weights that a fit is made with, one after the other, each from where the one before it ended: the search for the
lowest minimum and the choice of a body are those of the first. ``adaptive`` keeps the one with the nearest picture.
``none`` searches for itself: on some metals and plastics compressive weights do not lead to its lowest minimum."""
Device = Any  # one of `jax.devices()`, which has no type of its own
