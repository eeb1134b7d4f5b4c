"""What settings choose among, and the parts that compute name in their types: no jax."""

from typing import Literal

Precision = Literal["float64", "float32"]
"""In which a model is evaluated; sums are always taken in float64."""
Backend = Literal["optimistix", "scipy", "jaxopt"]
"""Solvers; others than optimistix are for cross-checks."""
