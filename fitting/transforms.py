"""Between the bounded parameters of a material and the free coordinates in which they are fitted.

A parameter in [lower, upper] is placed at a position u in [0, 1], linear or logarithmic as its declaration says, and
z = logit(u) is free, for solvers. A prior uniform in u is the logistic density u (1 - u) in z.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ..model.effects import Effects
from ..model.parameters import CHANNELS, Parameter, parameters

INSIDE = 1e-6  # starting points are moved this far inside their bounds


@dataclass(frozen=True)
class Layout:
    """Where each parameter sits in the flat vector: shared ones first, then per-channel ones, channel by channel.

    Attributes:
        parameters: the declarations, shared before per-channel. channels: names of the colour channels.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...] = CHANNELS

    def _width(self, parameter: Parameter) -> int:
        return len(self.channels) if parameter.per_channel else 1

    @property
    def slices(self) -> dict[str, slice]:
        """Slice of the flat vector by parameter name."""
        ends = np.cumsum([self._width(q) for q in self.parameters])
        return {q.name: slice(int(e) - self._width(q), int(e)) for q, e in zip(self.parameters, ends, strict=True)}

    @property
    def size(self) -> int:
        """Length of the flat vector."""
        return sum(self._width(q) for q in self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every entry, ``beta`` or ``n_R``."""
        return tuple(
            name
            for q in self.parameters
            for name in ([f"{q.name}_{ch}" for ch in self.channels] if q.per_channel else [q.name])
        )

    @property
    def entries(self) -> tuple[Parameter, ...]:
        """Declaration of every entry."""
        return tuple(q for q in self.parameters for _ in range(self._width(q)))

    @partial(jax.jit, static_argnums=0)
    def values(self, z: Array) -> dict[str, Array]:
        """Physical values by name: scalars, and ``(C,)`` for parameters per channel."""
        where = self.slices
        return {
            q.name: from_free(q, z[where[q.name]] if q.per_channel else z[where[q.name]][0]) for q in self.parameters
        }

    def free(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        """Free coordinates of physical values; values on or beyond a bound are moved just inside."""
        return np.concatenate([np.atleast_1d(to_free(q, np.asarray(values[q.name]))) for q in self.parameters])

    def position(self, z: ArrayLike) -> np.ndarray:
        """Position of every entry between its bounds, in [0, 1]."""
        return 1 / (1 + np.exp(-np.clip(np.asarray(z), -700, 700)))


@cache
def layout_of(effects: Effects) -> Layout:
    """The flat vector of everything that these effects leave to be fitted."""
    return Layout(parameters(effects))


def from_free(parameter: Parameter, z: Array) -> Array:
    """Physical value at free coordinate z."""
    return parameter.between(jax.nn.sigmoid(z))


def to_free(parameter: Parameter, value: np.ndarray) -> np.ndarray:
    """Free coordinate of a physical value."""
    lower, upper = parameter.lower - parameter.offset, parameter.upper - parameter.offset
    shifted = np.clip(value - parameter.offset, lower, upper)
    if parameter.scale == "linear":
        u = (shifted - lower) / (upper - lower)
    else:
        u = np.log(shifted / lower) / np.log(upper / lower)
    u = np.clip(u, INSIDE, 1 - INSIDE)
    return np.log(u) - np.log1p(-u)
